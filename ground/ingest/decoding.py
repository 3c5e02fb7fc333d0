"""A downlink to frames: the ground half of the packet interface."""

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain, pairwise
from typing import Final

from ground.ingest.assembly import FrameParts, assemble, with_tracks
from ground.ingest.packets import Packet, StreamFaults, read_packets
from ground.ingest.records import MemoryLimit, decode_record
from ground.ingest.report import ApidReport, IngestReport
from sboc_e2e.icd import layout
from sboc_e2e.icd.downlink import DownlinkFrame, Housekeeping
from sboc_e2e.icd.errors import ContractError, PluginError, UserError
from sboc_e2e.icd.flags import FrameFlag
from sboc_e2e.icd.layout import Apid
from sboc_e2e.icd.steps import Decoder

FAILURES_LISTED = 1000
"""A limit of memory for a damaged stream; `n_decode_failures` counts them all."""
COUNT_MODULUS = 1 << 14
"""The packet sequence count has 14 bits (CCSDS 133.0-B-2, packet primary header)."""
NUMBERS = 1 << 32
"""Frame numbers there are."""

ALWAYS_SENT: Final = frozenset({Apid.STARS, Apid.BACKGROUND, Apid.THUMBNAIL})
"""Kinds that every frame has unless its header says that something did not fit into the budget."""


@dataclass(kw_only=True)
class _FramePackets:
    """Intact packets of one frame by kind, item and segment."""

    by_place: dict[tuple[int, int, int], Packet] = field(default_factory=dict)


def decode_downlink(
    downlink: bytes, decoders: Sequence[Decoder], *, run_id: int | None = None
) -> tuple[tuple[DownlinkFrame, ...], IngestReport]:
    """Frames of one run (the one with most packets unless named), by frame number, and the loss report.

    Packets may come in any order, more than once, damaged, or mixed with other runs; every intact one is used.
    """
    table = decoder_table(decoders)
    faults = StreamFaults()
    by_run: dict[int, list[Packet]] = defaultdict(list)
    for packet in read_packets(downlink, faults):
        by_run[packet.run_id].append(packet)
    if run_id is None and by_run:
        run_id = max(sorted(by_run), key=lambda run: len(by_run[run]))
    packets = by_run.get(run_id, []) if run_id is not None else []
    frames, tallies, conflicts = _sorted_into_frames(packets)
    failures: list[str] = []
    memory = MemoryLimit.for_stream(len(downlink))
    renumbered = _renumbered(frames)
    keys = {key[0]: key for key in sorted(frames, reverse=True)} | renumbered
    parts = [_decoded(number, key[1], frames[key], table, memory, failures) for number, key in sorted(keys.items())]
    with_tracks(parts, failures)
    built, unusable = assemble(parts, memory, failures, ambiguous={number for number, _ in renumbered.values()})
    complete, incomplete, missing_segments = _completeness(parts)
    return built, IngestReport(
        run_id=run_id if packets else None,
        n_bytes=len(downlink),
        apids=tallies,
        foreign_runs={run: len(group) for run, group in sorted(by_run.items()) if run != run_id},
        corrupted=faults.corrupted,
        truncated=faults.truncated,
        garbage_bytes=faults.garbage_bytes,
        other_contract=faults.other_contract,
        conflicts=conflicts,
        frames_complete=complete,
        frames_incomplete=incomplete,
        frames_missing=_gaps(sorted({number for number, _ in frames})),
        frames_unusable=unusable,
        renumbered=renumbered,
        missing_segments=missing_segments,
        decode_failures=tuple(failures[:FAILURES_LISTED]),
        n_decode_failures=len(failures),
        work_shed=dict(sum((Counter(f.housekeeping.shed) for f in built if f.housekeeping is not None), Counter())),
    )


def decoder_table(decoders: Sequence[Decoder]) -> dict[int, Decoder]:
    """Decoders by codec number."""
    numbers = Counter(decoder.number for decoder in decoders)
    twice = sorted(number for number, times in numbers.items() if times > 1)
    if twice:
        raise UserError(f"ground.decoder: more than one decoder for codec number {twice[0]}")
    return {decoder.number: decoder for decoder in decoders}


def _sorted_into_frames(
    packets: Sequence[Packet],
) -> tuple[dict[tuple[int, int], _FramePackets], dict[str, ApidReport], int]:
    """Packets by (frame number, start time); reports by kind; number of packets that contradict another one with the same
    place."""
    frames: dict[tuple[int, int], _FramePackets] = defaultdict(_FramePackets)
    received: Counter[int] = Counter()
    duplicates: Counter[int] = Counter()
    n_bytes: Counter[int] = Counter()
    conflicts = 0
    for packet in packets:
        received[packet.apid] += 1
        n_bytes[packet.apid] += layout.HEADER_BYTES + len(packet.payload) + layout.CRC.size
        places = frames[packet.frame, packet.t_start_tai_ns].by_place
        place = (packet.apid, packet.item, packet.segment)
        known = places.get(place)
        if known is None:
            places[place] = packet
        elif known == packet:
            duplicates[packet.apid] += 1
        else:
            conflicts += 1
            # The packet that was made first on board wins; if that is unknown, the content decides. The order of arrival never
            # matters.
            if (packet.count, packet.payload) < (known.count, known.payload):
                places[place] = packet
    kept: dict[int, list[tuple[int, int, int]]] = defaultdict(list)
    for (number, t_start), frame in sorted(frames.items()):
        for packet in frame.by_place.values():
            kept[packet.apid].append((number, t_start, packet.count))
    reports = {}
    for apid in Apid:
        missing = missing_counts(kept[apid])
        reports[apid.name.lower()] = ApidReport(
            received=received[apid],
            duplicates=duplicates[apid],
            missing=missing,
            n_missing=sum(last - first + 1 for first, last in missing),
            bytes=n_bytes[apid],
        )
    return dict(frames), reports, conflicts


def _renumbered(frames: Iterable[tuple[int, int]]) -> dict[int, tuple[int, int]]:
    """New numbers for frames (number, start time) whose number an earlier frame has. They follow the last number, by time."""
    later: list[tuple[int, int]] = []
    numbers: set[int] = set()
    for number, t_start in sorted(frames):
        if number in numbers:
            later.append((t_start, number))
        numbers.add(number)
    last = max(numbers, default=0)
    free = (number for number in chain(range(last + 1, NUMBERS), range(last)) if number not in numbers)
    return {own: (number, t_start) for own, (t_start, number) in zip(free, sorted(later), strict=False)}


def missing_counts(places: Sequence[tuple[int, int, int]]) -> tuple[tuple[int, int], ...]:
    """Ranges of absent sequence counts, from (frame, start time, 14-bit count) of what arrived.

    Counts are unwrapped frame by frame: within a frame around its first packet, between frames forward by less than one
    period. The first packet that arrived is the origin, with its own count.
    """
    by_frame: dict[tuple[int, int], list[int]] = defaultdict(list)
    for number, t_start, count in places:
        by_frame[number, t_start].append(count)
    seen: set[int] = set()
    reached: int | None = None
    for key in sorted(by_frame):
        counts = by_frame[key]
        first = _first_of_run(counts)
        if reached is None:
            base = first
        else:
            base = reached + 1 + (first - reached - 1) % COUNT_MODULUS
        unwrapped = [base + (count - first) % COUNT_MODULUS for count in counts]
        seen.update(unwrapped)
        reached = max(unwrapped)
    ordered = sorted(seen)
    return tuple((a + 1, b - 1) for a, b in pairwise(ordered) if b > a + 1)


def _first_of_run(counts: Sequence[int]) -> int:
    """The count a frame's packets begin with: the one after the largest circular gap."""
    ordered = sorted(set(counts))
    gaps = [(ordered[k] - ordered[k - 1]) % COUNT_MODULUS or COUNT_MODULUS for k in range(len(ordered))]
    return ordered[gaps.index(max(gaps))]


def _decoded(
    number: int,
    t_start: int,
    packets: _FramePackets,
    decoders: Mapping[int, Decoder],
    memory: MemoryLimit,
    failures: list[str],
) -> FrameParts:
    """Records of one frame; what cannot be decoded is listed and left out."""
    places = sorted(packets.by_place)
    any_packet = packets.by_place[places[0]]
    parts = FrameParts(
        frame=number, t_start_tai_ns=t_start, exposure_ns=any_packet.exposure_ns, line_time_ns=any_packet.line_time_ns
    )
    expected: Counter[tuple[int, int]] = Counter()
    arrived: Counter[tuple[int, int]] = Counter()
    for place in places:
        packet = packets.by_place[place]
        group = (packet.apid, packet.item)
        expected[group] = max(expected[group], packet.n_segments)
        if packet.apid == Apid.ROI:
            parts.n_strips[packet.item] = expected[group]
        try:
            parts.add(packet, decode_record(packet, decoders, memory))
            arrived[group] += 1
        except ContractError as error:
            failures.append(f"frame {number} {Apid(packet.apid).name} item {packet.item} segment {packet.segment}: {error}")
        except PluginError as error:
            raise PluginError(f"{error} (frame {number})") from error
    for group, n_segments in expected.items():
        if arrived[group] < n_segments:
            kind = Apid(group[0]).name.lower()
            parts.missing[kind] = parts.missing.get(kind, 0) + n_segments - arrived[group]
    if parts.header is None:
        parts.missing.setdefault("header", 1)
    else:
        _note_lost_items(parts, parts.header.housekeeping, {apid for apid, _ in expected})
    return parts


def _note_lost_items(parts: FrameParts, sent: Housekeeping, arrived: set[int]) -> None:
    """Note items that the header says were sent and that did not arrive; at least one packet for a list or an image."""
    if sent.n_rois_sent > len(parts.n_strips):
        parts.missing["roi"] = parts.missing.get("roi", 0) + sent.n_rois_sent - len(parts.n_strips)
    lost = {Apid.STARS} if sent.n_stars_sent > sum(map(len, parts.stars)) else set()
    if not sent.flags & FrameFlag.BUDGET_CUT:
        lost |= ALWAYS_SENT - arrived
    for apid in lost:
        parts.missing.setdefault(apid.name.lower(), 1)


def _completeness(
    parts: Sequence[FrameParts],
) -> tuple[tuple[int, ...], tuple[int, ...], dict[int, dict[str, int]]]:
    """Complete frames, incomplete frames, and the packets that these lack."""
    lacking = {part.frame: dict(sorted(part.missing.items())) for part in parts if part.missing}
    complete = tuple(part.frame for part in parts if not part.missing)
    return complete, tuple(sorted(lacking)), lacking


def _gaps(numbers: Sequence[int]) -> tuple[tuple[int, int], ...]:
    """Ranges (first, last) absent between the first and the last of sorted numbers."""
    return tuple((a + 1, b - 1) for a, b in pairwise(numbers) if b > a + 1)
