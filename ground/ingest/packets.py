"""Space packets in a stream of bytes that may be damaged anywhere.

A packet is accepted when its headers are as ICD.md says and its checksum holds. Otherwise the search continues
one byte further, at the next place that looks like a packet. Garbage then costs only the bytes that it overwrote.
"""

import binascii
import struct
from collections.abc import Iterator
from dataclasses import dataclass

from sboc_e2e.icd import layout
from sboc_e2e.icd.tai import NS_PER_S
from sboc_e2e.icd.version import CONTRACT_MAJOR

TELEMETRY_WITH_SECONDARY_HEADER = 0x0800
"""Upper five bits of a primary header: version 0, type 0 (telemetry), secondary header flag 1 (CCSDS 133.0-B-2)."""
UNSEGMENTED = 0xC000
"""Sequence flags 11: the packet holds all of its user data (CCSDS 133.0-B-2)."""
APIDS = frozenset(int(apid) for apid in layout.Apid)
PREAMBLE_OFFSET = layout.PRIMARY.size
TIME_OFFSET = PREAMBLE_OFFSET + len(layout.CUC_PREAMBLE)
ITEM_OFFSET = TIME_OFFSET + layout.CUC_TIME.size
LONGEST_EXPOSURE_NS = 2**53
"""104 days: a double still holds every nanosecond. More is damage that the checksum did not show."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Packet:
    """An intact packet."""

    apid: int
    count: int
    run_id: int
    frame: int
    t_start_tai_ns: int
    exposure_ns: int
    line_time_ns: int
    item: int
    segment: int
    n_segments: int
    payload: bytes


@dataclass(kw_only=True, slots=True)
class StreamFaults:
    """What was wrong with a stream of bytes."""

    corrupted: int = 0
    truncated: int = 0
    garbage_bytes: int = 0
    other_contract: int = 0


def read_packets(stream: bytes, faults: StreamFaults) -> Iterator[Packet]:
    """Intact packets of a stream in order; `faults` is filled on the way.

    corrupted : places with a packet's headers whose checksum does not hold; truncated : the stream ends within a packet;
    garbage_bytes : bytes that belong to no intact packet.
    """
    position, end = 0, len(stream)
    while position < end:
        start = _next_candidate(stream, position)
        faults.garbage_bytes += start - position
        if start == end:
            return
        length = struct.unpack_from(">H", stream, start + 4)[0] + layout.PRIMARY.size + 1
        if start + length > end:
            faults.truncated += 1
        elif _checksum_holds(stream, start, length):
            position = start + length
            packet = _parse(stream, start, length)
            if packet is None:
                faults.other_contract += 1
            else:
                yield packet
            continue
        else:
            faults.corrupted += 1
        faults.garbage_bytes += 1
        position = start + 1


def _next_candidate(stream: bytes, position: int) -> int:
    """Where the next headers that may be a packet's begin; the stream's end if there are none."""
    while True:
        mark = stream.find(layout.CUC_PREAMBLE, position + PREAMBLE_OFFSET)
        if mark < 0:
            return len(stream)
        start = mark - PREAMBLE_OFFSET
        first, second, length = layout.PRIMARY.unpack_from(stream, start)
        plausible = (
            first & 0xF800 == TELEMETRY_WITH_SECONDARY_HEADER
            and first & 0x07FF in APIDS
            and second & UNSEGMENTED == UNSEGMENTED
            and layout.HEADER_BYTES + layout.CRC.size <= length + layout.PRIMARY.size + 1 <= layout.MAX_PACKET_BYTES
        )
        if plausible:
            return start
        position = start + 1


def _checksum_holds(stream: bytes, start: int, length: int) -> bool:
    """Whether the last two bytes are the CRC of the rest; the CRC over both is then zero."""
    return binascii.crc_hqx(memoryview(stream)[start : start + length], layout.CRC_START) == 0


def _parse(stream: bytes, start: int, length: int) -> Packet | None:
    """Fields of an intact packet; None if it has another major version of the contract or fields out of range."""
    first, second, _ = layout.PRIMARY.unpack_from(stream, start)
    seconds, fraction = layout.CUC_TIME.unpack_from(stream, start + TIME_OFFSET)
    major, _, run_id, frame, exposure_ns, line_time_ns, item, segment, n_segments = layout.ITEM.unpack_from(
        stream, start + ITEM_OFFSET
    )
    sensible = segment < n_segments and exposure_ns <= LONGEST_EXPOSURE_NS and line_time_ns > -(2**31)
    if major != CONTRACT_MAJOR or not sensible:
        return None
    return Packet(
        apid=first & 0x07FF,
        count=second & 0x3FFF,
        run_id=run_id,
        frame=frame,
        t_start_tai_ns=seconds * NS_PER_S + (fraction * NS_PER_S + (1 << 31)) // (1 << 32),
        exposure_ns=exposure_ns,
        line_time_ns=line_time_ns,
        item=item,
        segment=segment,
        n_segments=n_segments,
        payload=bytes(stream[start + layout.HEADER_BYTES : start + length - layout.CRC.size]),
    )
