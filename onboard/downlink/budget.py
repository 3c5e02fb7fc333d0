"""Bit budget of the downlink: an allowance in bytes that grows with time and is spent in order of priority."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from onboard.downlink.packets import PacketWriter
from sboc_e2e.icd import layout
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.signals import Detection
from sboc_e2e.icd.tai import NS_PER_S

SUSPICIOUS = StreakFlag.STATIC | StreakFlag.COSMIC_LIKE | StreakFlag.SPIKE_LIKE

LENGTHS_PX = (4.0, 20.0, 100.0, 500.0)  # points end at 4 px, star-like trails at 20 px, and so on by factors of five
FIELD_PARTS = 3
"""Limits of the kinds of detections by length, and parts of the field along each axis, that have quotas of regions."""


@dataclass(frozen=True, kw_only=True)
class Allowance:
    """Bytes that may still be sent; never more than the rate gives in `burst_s`, or in an exposure that has really passed.

    A rate of 0 is no limit.
    """

    rate_bytes_s: float
    burst_s: float
    credit_bytes: float = 0.0

    def after(self, elapsed_s: float, exposure_s: float = 0.0) -> "Allowance":
        """The allowance some time later, before a frame of that exposure; a clock that jumps grants no more than a burst."""
        if self.rate_bytes_s == 0.0:
            return replace(self, credit_bytes=math.inf)
        granted = self.credit_bytes + self.rate_bytes_s * max(elapsed_s, 0.0)
        return replace(self, credit_bytes=min(granted, self.rate_bytes_s * max(self.burst_s, min(exposure_s, elapsed_s))))

    def spend(self, n_bytes: int) -> "Allowance":
        """The allowance after sending. It may become negative when mandatory packets did not fit."""
        return replace(self, credit_bytes=self.credit_bytes - n_bytes)


def elapsed_s(header: FrameHeader, previous: FrameHeader | None) -> float:
    """Time for which the downlink budget has grown: since the frame before, or one exposure."""
    if previous is None:
        return max(header.exposure_ns, 1) / NS_PER_S
    return (header.t_start_tai_ns - previous.t_start_tai_ns) / NS_PER_S


def priority(detections: Sequence[Detection]) -> NDArray[np.intp]:
    """Order in which detections are sent: real-looking before suspicious, then by S/N."""
    suspicion = [
        2 * bool(d.flags & StreakFlag.STATIC) + bool(d.flags & StreakFlag.COSMIC_LIKE) + bool(d.flags & StreakFlag.SPIKE_LIKE)
        for d in detections
    ]
    snr = [-d.snr for d in detections]
    return np.lexsort((snr, suspicion)) if detections else np.zeros(0, dtype=np.intp)


def kind_of_place(detection: Detection, shape: tuple[int, int]) -> tuple[int, int]:
    """The quota of a detection: its kind by length, trails that cross the frame apart, and its part of the field."""
    flags, length = detection.flags, detection.length_px
    both = StreakFlag.EDGE0 | StreakFlag.EDGE1
    crosses = flags & both == both
    kind = len(LENGTHS_PX) + 1 if crosses else sum(length > limit for limit in LENGTHS_PX)
    row, col = 0.5 * (detection.row0 + detection.row1), 0.5 * (detection.col0 + detection.col1)
    part = [min(FIELD_PARTS - 1, max(0, int(FIELD_PARTS * x / n))) for x, n in zip((row, col), shape, strict=True)]
    return kind, part[0] * FIELD_PARTS + part[1]


def taking_turns(ordered: Sequence[Detection], shape: tuple[int, int]) -> list[Detection]:
    """Detections, best first, so that every second place goes to the best of each kind and part of the field in turn.

    One bright corner, or many long trails, then leave room for a faint, short or passing object elsewhere.
    """
    groups = [kind_of_place(d, shape) for d in ordered]
    number: dict[tuple[int, int], int] = {}
    turn = []
    for group in groups:
        number[group] = number.get(group, -1) + 1
        turn.append(number[group])
    in_turn = iter(sorted(range(len(ordered)), key=lambda k: (turn[k], k)))
    best = iter(range(len(ordered)))
    taken: dict[int, None] = {}
    while len(taken) < len(ordered):
        source = best if len(taken) % 2 == 0 else in_turn
        taken[next(k for k in source if k not in taken)] = None
    return [ordered[k] for k in taken]


def within_limits(
    detections: Sequence[Detection], shape: tuple[int, int], *, most: int, most_cosmic_like: int
) -> list[Detection]:
    """The detections that may be sent in a frame, in their order, within the limits of all and of particle hits.

    Real-looking ones take turns by kind and part of the field; suspicious ones follow by `priority`.
    """
    ordered = [detections[k] for k in priority(detections)]
    hits = [d for d in ordered if d.flags & StreakFlag.COSMIC_LIKE]
    over = {id(d) for d in hits[most_cosmic_like:]}
    real = taking_turns([d for d in ordered if not d.flags & SUSPICIOUS], shape)
    return (real + [d for d in ordered if d.flags & SUSPICIOUS and id(d) not in over])[:most]


def packet_bytes(payloads: Sequence[bytes]) -> int:
    """Bytes on the link of some payloads with their headers and checksums."""
    return sum(layout.HEADER_BYTES + layout.CRC.size + len(payload) for payload in payloads)


@dataclass(kw_only=True)
class Outbox:
    """Packets of one frame on their way out, within an allowance."""

    writer: PacketWriter
    allowance: Allowance
    header: FrameHeader
    bytes_dropped: int = 0
    sent: dict[int, list[bytes]] = field(default_factory=dict)

    def reserve(self, n_bytes: int) -> None:
        """Subtract the bytes of a mandatory packet from the allowance."""
        self.allowance = self.allowance.spend(n_bytes)

    def fits(self, payloads: Sequence[bytes]) -> bool:
        """Whether these payloads fit into the rest of the allowance."""
        return packet_bytes(payloads) <= self.allowance.credit_bytes

    def offer(self, apid: layout.Apid, payloads: Sequence[bytes], *, item: int = 0) -> bool:
        """Send the payloads if all fit; otherwise count them as dropped."""
        if not self.fits(payloads):
            self.bytes_dropped += packet_bytes(payloads)
            return False
        self.reserve(packet_bytes(payloads))
        self.send(apid, payloads, item=item)
        return True

    def send(self, apid: layout.Apid, payloads: Sequence[bytes], *, item: int = 0) -> None:
        """Send payloads whose bytes are reserved or on top of the budget."""
        packets, self.writer = self.writer.write(apid, self.header, payloads, item=item)
        self.sent.setdefault(int(apid), []).extend(packets)

    def joined(self) -> bytes:
        """All packets by APID, the header first."""
        return b"".join(packet for apid in sorted(self.sent) for packet in self.sent[apid])

    def bytes_by_apid(self) -> dict[int, int]:
        """Bytes sent of each APID."""
        return {apid: sum(map(len, self.sent[apid])) for apid in sorted(self.sent)}
