"""Ingest of a damaged downlink: everything intact is used, everything missing is listed, nothing depends on order."""

import json
import random
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ground.ingest import decode_downlink
from ground.ingest.codecs import PlanesDecoder, RawDecoder
from ground.ingest.decoding import missing_counts
from onboard.downlink.codec import PlanesCodec
from onboard.options import DownlinkOptions
from sboc_e2e.icd import layout
from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.errors import PluginError, UserError
from sboc_e2e.icd.flags import FrameFlag
from sboc_e2e.icd.layout import Apid
from tests.onboard import small_run

DECODERS = (PlanesDecoder(),)
APID_OFFSET, FRAME_OFFSET, SEGMENT_OFFSET = 0, 22, 40


@pytest.fixture(scope="module")
def packets() -> list[bytes]:
    """Packets of a run of four frames."""
    return split(small_run.short_run(4).downlink)


def split(downlink: bytes) -> list[bytes]:
    """An intact downlink packet by packet."""
    out, at = [], 0
    while at < len(downlink):
        size = struct.unpack_from(">H", downlink, at + 4)[0] + 7
        out.append(downlink[at : at + size])
        at += size
    return out


def apid(packet: bytes) -> int:
    """APID of a packet."""
    return int(struct.unpack_from(">H", packet)[0] & 0x7FF)


def frame_number(packet: bytes) -> int:
    """Frame number of a packet."""
    return int(struct.unpack_from(">I", packet, FRAME_OFFSET)[0])


def content(frames: tuple[DownlinkFrame, ...]) -> list[Any]:
    """What frames hold, comparable."""
    return [
        (
            f.header.frame,
            f.header.t_start_tai_ns,
            f.flags,
            f.housekeeping,
            f.stars.row.tobytes(),
            f.stars.flux_e.tobytes(),
            [(g.roi_id, g.detection, [s.values_adu.tobytes() for s in g.strips]) for g in f.rois],
            None if f.background is None else f.background.level_adu.tobytes(),
            None if f.thumbnail_adu is None else f.thumbnail_adu.tobytes(),
        )
        for f in frames
    ]


def test_complete_run_is_reported_complete(packets: list[bytes]) -> None:
    """Nothing missing, and a report that is JSON."""
    frames, report = decode_downlink(b"".join(packets), DECODERS)
    assert [f.header.frame for f in frames] == [0, 1, 2, 3]
    assert report.frames_complete == (0, 1, 2, 3)
    assert report.frames_incomplete == report.frames_missing == report.frames_unusable == ()
    assert report.garbage_bytes == report.corrupted == report.truncated == report.conflicts == 0
    assert sum(kind.received for kind in report.apids.values()) == len(packets)
    assert sum(kind.bytes for kind in report.apids.values()) == report.n_bytes
    assert json.loads(json.dumps(report.as_dict()))["run_id"] == small_run.RUN_ID
    assert frames[2].header.t_start_tai_ns == small_run.header(2).t_start_tai_ns
    telemetry = small_run.header(2)
    assert frames[2].header.attitude is not None
    assert telemetry.attitude is not None
    assert (frames[2].header.attitude.covariance_rad2 == telemetry.attitude.covariance_rad2).all()
    assert frames[2].header.observer is not None
    assert telemetry.observer is not None
    assert (frames[2].header.observer.position_m == telemetry.observer.position_m).all()


@given(seed=st.integers(0, 2**32), copies=st.integers(1, 3))
def test_order_and_duplicates_do_not_matter(packets: list[bytes], seed: int, copies: int) -> None:
    """Any permutation, with any packet repeated, gives the same frames."""
    shuffled = packets * copies
    random.Random(seed).shuffle(shuffled)  # noqa: S311 - a test's shuffle
    straight, _ = decode_downlink(b"".join(packets), DECODERS)
    frames, report = decode_downlink(b"".join(shuffled), DECODERS)
    assert content(frames) == content(straight)
    assert sum(kind.duplicates for kind in report.apids.values()) == (copies - 1) * len(packets)
    assert report.frames_complete == (0, 1, 2, 3)


@given(lost=st.sets(st.integers(0, 60), min_size=1, max_size=20))
def test_lost_packets_cost_what_they_carried(packets: list[bytes], lost: set[int]) -> None:
    """Strips and stars of every packet that arrived are there; every lost one is reported by sequence or segment."""
    lost = {k for k in lost if k < len(packets)}
    kept = [packet for k, packet in enumerate(packets) if k not in lost]
    frames, report = decode_downlink(b"".join(kept), DECODERS)
    assert sum(kind.received for kind in report.apids.values()) == len(kept)
    damaged = {frame_number(packets[k]) for k in lost}
    built = {f.header.frame for f in frames}
    for f in frames:
        mine = [p for p in kept if frame_number(p) == f.header.frame]
        assert sum(len(g.strips) for g in f.rois) == sum(apid(p) == Apid.ROI for p in mine)
        star_bytes = sum(len(p) - layout.HEADER_BYTES - 2 for p in mine if apid(p) == Apid.STARS)
        assert (len(f.stars) + len(f.remembered)) * layout.STAR_DTYPE.itemsize == star_bytes
        lost_header = not any(apid(p) == Apid.HEADER for p in mine)
        assert bool(f.flags & FrameFlag.HEADER_REBUILT) == lost_header
        if lost_header:
            assert f.header.t_start_tai_ns == small_run.header(f.header.frame).t_start_tai_ns
    assert set(report.frames_incomplete) == {frame_number(p) for p in kept} & damaged
    assert set(report.frames_complete) == {frame_number(p) for p in kept} - damaged
    for f in frames:
        assert bool(f.flags & FrameFlag.PACKETS_MISSING) == (f.header.frame in damaged)
    for number in damaged & built:
        kinds = {Apid(apid(packets[k])).name.lower() for k in lost if frame_number(packets[k]) == number}
        if "header" not in kinds:
            assert set(report.missing_segments[number]) == kinds


@pytest.mark.parametrize("kind", [Apid.STARS, Apid.BACKGROUND, Apid.THUMBNAIL], ids=lambda kind: kind.name.lower())
def test_a_list_or_an_image_that_is_lost_entirely_is_named_by_its_frame(packets: list[bytes], kind: Apid) -> None:
    """The header says what was sent; what did not fit into the budget is not missed."""
    kept = [p for p in packets if not (apid(p) == kind and frame_number(p) == 1)]
    frames, report = decode_downlink(b"".join(kept), DECODERS)
    assert report.frames_complete == (0, 2, 3)
    assert report.missing_segments == {1: {kind.name.lower(): 1}}
    assert [bool(f.flags & FrameFlag.PACKETS_MISSING) for f in frames] == [False, True, False, False]


def test_what_the_budget_kept_back_is_not_missed() -> None:
    """A link with room for header, stars and regions, but not for the images of the sky."""
    roomy = small_run.start_run().feed(small_run.frame(0)).bytes_by_apid
    room = sum(roomy[kind] for kind in (Apid.HEADER, Apid.STARS, Apid.ROI)) + 10
    run = small_run.start_run(downlink=DownlinkOptions(budget_mbit_s=room * 8 / 0.2 / 1e6, burst_s=0.0))
    packets = split(run.feed(small_run.frame(0)).packets)
    assert {apid(p) for p in packets} == {Apid.HEADER, Apid.STARS, Apid.ROI}
    _, report = decode_downlink(b"".join(packets), DECODERS)
    assert report.frames_complete == (0,)
    _, report = decode_downlink(b"".join(p for p in packets if apid(p) != Apid.STARS), DECODERS)
    assert report.missing_segments == {0: {"stars": 1}}


def test_inner_losses_are_named_by_sequence_count(packets: list[bytes]) -> None:
    """Without frame 1's star packets the report has exactly their counts."""
    gone = [p for p in packets if apid(p) == Apid.STARS and frame_number(p) == 1]
    counts = [struct.unpack_from(">H", p, 2)[0] & 0x3FFF for p in gone]
    _, report = decode_downlink(b"".join(p for p in packets if p not in gone), DECODERS)
    assert report.apids["stars"].missing == ((min(counts), max(counts)),)
    assert report.apids["stars"].n_missing == len(gone)
    assert report.apids["roi"].n_missing == 0


def test_lost_header_is_rebuilt_with_repeated_telemetry(packets: list[bytes]) -> None:
    """The next header packet repeats attitude and observer: only housekeeping is lost."""
    kept = [p for p in packets if not (apid(p) == Apid.HEADER and frame_number(p) == 1)]
    frames, report = decode_downlink(b"".join(kept), DECODERS)
    rebuilt = frames[1]
    assert rebuilt.flags & FrameFlag.HEADER_REBUILT
    assert rebuilt.flags & FrameFlag.PACKETS_MISSING
    assert rebuilt.housekeeping is None
    expected = small_run.header(1)
    assert rebuilt.header.t_start_tai_ns == expected.t_start_tai_ns
    assert rebuilt.header.attitude is not None
    assert expected.attitude is not None
    assert (rebuilt.header.attitude.rate_rad_s == expected.attitude.rate_rad_s).all()
    assert report.missing_segments[1] == {"header": 1}


def renamed(packet: bytes, number: int) -> bytes:
    """The packet as one of another frame."""
    return reseal(
        packet[:FRAME_OFFSET] + struct.pack(">I", number) + packet[FRAME_OFFSET + 4 :], packet[layout.HEADER_BYTES : -2]
    )


def test_frames_of_one_number_and_two_epochs_are_both_there_and_told_apart(packets: list[bytes]) -> None:
    """As after a counter that was set back: the later one goes on after the last, and telemetry is not mistaken."""
    straight, _ = decode_downlink(b"".join(packets), DECODERS)
    twice = [renamed(p, 1) if frame_number(p) == 2 else p for p in packets]
    frames, report = decode_downlink(b"".join(reversed(twice)), DECODERS)
    assert [f.header.frame for f in frames] == [0, 1, 3, 4]
    moved = [straight[k] for k in (0, 1, 3, 2)]
    assert [c[1:] for c in content(frames)] == [c[1:] for c in content(tuple(moved))]
    assert report.renumbered == {4: (1, straight[2].header.t_start_tai_ns)}
    assert report.frames_complete == (0, 1, 3, 4)
    assert report.frames_missing == ((2, 2),)
    assert json.loads(json.dumps(report.as_dict()))["renumbered"]["4"]["frame"] == 1
    without = [p for p in twice if not (apid(p) == Apid.HEADER and frame_number(p) == 1)]
    frames, report = decode_downlink(b"".join(without), DECODERS)
    assert [f.header.t_start_tai_ns for f in frames] == [f.header.t_start_tai_ns for f in moved]
    assert [f.header.attitude is None for f in frames] == [False, True, False, True]
    assert report.missing_segments == {1: {"header": 1}, 4: {"header": 1}}


def test_the_last_number_there_is_may_come_twice(packets: list[bytes]) -> None:
    """Then the second frame takes the first free number."""
    ends = [renamed(p, 2**32 - 1) if frame_number(p) > 1 else p for p in packets]
    frames, report = decode_downlink(b"".join(ends), DECODERS)
    assert [f.header.frame for f in frames] == [0, 1, 2, 2**32 - 1]
    assert list(report.renumbered) == [2]


def test_no_header_at_all_is_unusable_but_listed(packets: list[bytes]) -> None:
    """Without any header packet no frame has a size."""
    frames, report = decode_downlink(b"".join(p for p in packets if apid(p) != Apid.HEADER), DECODERS)
    assert frames == ()
    assert report.frames_unusable == (0, 1, 2, 3)


def test_a_whole_frame_missing_is_listed(packets: list[bytes]) -> None:
    """Frame 2 lost altogether."""
    frames, report = decode_downlink(b"".join(p for p in packets if frame_number(p) != 2), DECODERS)
    assert [f.header.frame for f in frames] == [0, 1, 3]
    assert report.frames_missing == ((2, 2),)


@given(data=st.data())
def test_flipped_bits_cost_their_packet_only(packets: list[bytes], data: st.DataObject) -> None:
    """One damaged packet: all others are received, nothing is misread."""
    which = data.draw(st.integers(0, len(packets) - 1))
    damaged = bytearray(packets[which])
    where = data.draw(st.integers(0, len(damaged) - 1))
    damaged[where] ^= 1 << data.draw(st.integers(0, 7))
    stream = b"".join([*packets[:which], bytes(damaged), *packets[which + 1 :]])
    _, report = decode_downlink(stream, DECODERS)
    assert sum(kind.received for kind in report.apids.values()) == len(packets) - 1
    assert report.garbage_bytes == len(damaged)
    assert report.n_decode_failures == 0


@given(cut=st.integers(1, 5000), head=st.binary(max_size=200), tail=st.binary(max_size=200))
def test_truncated_stream_with_garbage_around(packets: list[bytes], cut: int, head: bytes, tail: bytes) -> None:
    """Packets before the cut are all there; garbage before them is skipped."""
    stream = b"".join(packets)
    cut = min(cut, len(stream))
    _, report = decode_downlink(head + stream[:-cut], DECODERS)
    whole, size = 0, 0
    for packet in packets:
        size += len(packet)
        whole += size <= len(stream) - cut
    assert sum(kind.received for kind in report.apids.values()) == whole
    _, report = decode_downlink(head + stream + tail, DECODERS)
    assert sum(kind.received for kind in report.apids.values()) == len(packets)
    assert report.garbage_bytes == len(head) + len(tail)


def test_runs_are_kept_apart(packets: list[bytes]) -> None:
    """Packets of a smaller foreign run are counted, not used; they can be asked for."""
    foreign = split(small_run.short_run(2, run_id=99).downlink)
    mixed = [p for pair in zip(packets, [*foreign, *[b""] * len(packets)], strict=False) for p in pair]
    frames, report = decode_downlink(b"".join(mixed), DECODERS)
    straight, _ = decode_downlink(b"".join(packets), DECODERS)
    assert content(frames) == content(straight)
    assert report.foreign_runs == {99: len(foreign)}
    other, _ = decode_downlink(b"".join(mixed), DECODERS, run_id=99)
    assert [f.header.frame for f in other] == [0, 1]


@given(st.binary(max_size=3000))
def test_any_bytes_are_digested(stream: bytes) -> None:
    """Random bytes give no frame and a report."""
    frames, report = decode_downlink(stream, DECODERS)
    assert frames == ()
    assert report.garbage_bytes == len(stream)


def reseal(packet: bytes, payload: bytes) -> bytes:
    """A packet with another payload and a right checksum."""
    import binascii

    body = packet[4 : 4 + 0]
    length = layout.HEADER_BYTES + len(payload) + 2 - 7
    body = packet[:4] + struct.pack(">H", length) + packet[6 : layout.HEADER_BYTES] + payload
    return body + struct.pack(">H", binascii.crc_hqx(body, 0xFFFF))


@given(data=st.data())
def test_hostile_payloads_with_right_checksums_are_refused_one_by_one(packets: list[bytes], data: st.DataObject) -> None:
    """Payloads rewritten by an adversary: a listed failure or a frame, never an exception."""
    hostile = list(packets)
    for _ in range(data.draw(st.integers(1, 3))):
        which = data.draw(st.integers(0, len(packets) - 1))
        payload = bytearray(packets[which][layout.HEADER_BYTES : -2])
        for _ in range(data.draw(st.integers(0, 6))):
            payload[data.draw(st.integers(0, min(len(payload) - 1, 80)))] = data.draw(st.sampled_from((0, 1, 127, 128, 255)))
        cut = data.draw(st.integers(0, len(payload)))
        hostile[which] = reseal(packets[which], bytes(payload[:cut] if data.draw(st.booleans()) else payload))
    frames, report = decode_downlink(b"".join(hostile), DECODERS)
    assert len(frames) <= 4
    json.dumps(report.as_dict())


def test_unknown_codec_is_a_listed_failure(packets: list[bytes]) -> None:
    """ROI packets of a codec without decoder: stars and header are still used."""
    frames, report = decode_downlink(b"".join(packets), [RawDecoder()])
    n_rois = sum(apid(p) == Apid.ROI for p in packets)
    assert report.n_decode_failures == n_rois
    assert "codec number 1: no decoder; known are [0]" in report.decode_failures[0]
    assert all(len(f.stars) > 0 for f in frames)


def test_a_broken_decoder_is_named(packets: list[bytes]) -> None:
    """A decoder plug-in that raises stops the run by name."""

    class Broken:
        number = 1

        def decode(self, block: bytes, shape: tuple[int, int], *, level_adu: int, sigma_adu: float) -> Any:
            raise KeyError("oops")

    with pytest.raises(PluginError, match=r"ground\.decoder Broken: KeyError"):
        decode_downlink(b"".join(packets), [Broken()])
    with pytest.raises(UserError, match="more than one decoder for codec number 1"):
        decode_downlink(b"", [PlanesDecoder(), PlanesDecoder()])


def test_whole_frame_needs_every_chunk() -> None:
    """Complete: bit-exact. One chunk lost: None, and said so."""
    parts = split(small_run.short_run(1, whole_frame_every=1).downlink)
    frames, _ = decode_downlink(b"".join(parts), DECODERS)
    assert frames[0].whole_frame is not None
    assert (frames[0].whole_frame == small_run.sky(0).astype(np.int32) - 256).all()
    lost = next(k for k, p in enumerate(parts) if apid(p) == Apid.FRAME)
    frames, report = decode_downlink(b"".join(parts[:lost] + parts[lost + 1 :]), DECODERS)
    assert frames[0].whole_frame is None
    assert report.missing_segments[0] == {"frame": 1}


def test_sequence_counts_unwrap() -> None:
    """Counts that wrap at 16,384 within and between frames."""
    places = [(0, 0, 16382), (0, 0, 16383), (0, 0, 1), (1, 5, 2), (1, 5, 5), (2, 9, 6)]
    assert missing_counts(places) == ((16384, 16384), (16387, 16388))
    assert missing_counts([]) == ()


def test_garbage_is_skipped_in_linear_time() -> None:
    """200 kB made of nothing but look-alike headers (each with a wrong checksum) is digested."""
    head = layout.PRIMARY.pack(0x0800 | Apid.ROI, 0xC000, layout.MAX_PACKET_BYTES - 7) + layout.CUC_PREAMBLE
    frames, report = decode_downlink(head * (200_000 // len(head)), DECODERS)
    assert frames == ()
    assert report.corrupted + report.truncated == 200_000 // len(head)


def test_expansion_bomb_hits_the_memory_limit() -> None:
    """Thousands of small packets that each decode to 64 kpx: memory stays bounded, the rest is listed."""
    run = small_run.short_run(1)
    template = next(p for p in split(run.downlink) if apid(p) == Apid.ROI)
    constant = PlanesCodec().encode(np.zeros((256, 256), dtype=np.int32), level_adu=0, sigma_adu=1.0)
    head = layout.STRIP.pack(1, 0, 0, 256, 256, 0, 0, 0, 1.0, len(constant))
    payload = template[layout.HEADER_BYTES : layout.HEADER_BYTES + layout.ROI_GROUP.size] + head + constant
    stream = [run.downlink]
    for item in range(2000):
        packet = template[:38] + struct.pack(">HHH", item + 1, 0, 1) + template[44:]
        stream.append(reseal(packet, payload))
    frames, report = decode_downlink(b"".join(stream), DECODERS)
    held = sum(strip.values_adu.nbytes for group in frames[0].rois for strip in group.strips)
    assert held < 2**28
    assert report.n_decode_failures > 1000
    assert "memory limit" in report.decode_failures[0]
