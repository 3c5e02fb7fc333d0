"""Objects over several frames: what noise reaches, what is found, what is kept and sent of them, where tracking ends."""

import math
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from ground.ingest import decode_downlink
from ground.ingest.codecs import PlanesDecoder
from onboard.chain import OnboardChain, OnboardSteps, continues
from onboard.detect import LineIntegralDetector, ThresholdDetector
from onboard.detect.line_integral import dyadic
from onboard.downlink import roi
from onboard.downlink.codec import PlanesCodec
from onboard.downlink.kept_counts import kept_counts
from onboard.image.background import MeshBackground
from onboard.image.calibrate import Counts
from onboard.image.dark_map import DarkMap
from onboard.options import OnboardOptions
from onboard.stars.matched import MatchedStars
from onboard.track.false_alarms import half_point_sigma, independent_tracks, threshold_sigma
from onboard.track.joint import JointTracker
from onboard.track.kept_search import KeptSearch
from onboard.track.none import NoTracker
from onboard.track.packed import STEP
from onboard.track.particles import HIT_CODE, blank_hits
from onboard.track.trail_sums import path_variance, trail_variance
from sboc_e2e.exams.detector import NOISE_E, SHAPE, chain_with, frame_of, star_light
from sboc_e2e.exams.trails import trail
from sboc_e2e.faults import FaultOptions
from sboc_e2e.files import checkpoint
from sboc_e2e.icd.errors import UserError
from sboc_e2e.icd.flags import FrameFlag
from sboc_e2e.icd.frame import Frame
from sboc_e2e.icd.layout import CRC, HEADER_BYTES, Apid
from sboc_e2e.icd.signals import (
    UNKNOWN,
    BackgroundModel,
    Detection,
    DetectorView,
    Searched,
    StarList,
    Track,
    TrackerView,
    TrackMember,
)
from sboc_e2e.run.directory import RunDirectory
from sboc_e2e.run.onboard_stage import OnboardStage, join
from sboc_e2e.run.progress import Silent
from sboc_e2e.score.matching import TruthStreak
from tests.benchmarks.bench_tracks import STARS, PieceTracker, Storm, hit, random_track, run_cube
from tests.onboard.small_run import Run, calibration, camera, frame, header


@pytest.mark.parametrize(("n", "per_frame"), [(1, 6.97), (2, 5.14), (3, 4.26), (4, 3.73), (5, 3.37), (8, 2.71)])
def test_thresholds_are_those_of_the_theory(n: int, per_frame: float) -> None:
    """True S/N per frame of which half are found, 4096 x 4096 px, 0.1 false (Adler & Taylor 2007)."""
    volume = independent_tracks(n, area_px=4096.0**2, longest_px=2000.0, period_over_exposure=1.25, psf_sigma_px=0.849)
    assert half_point_sigma(threshold_sigma(volume, 0.1)) / math.sqrt(n) == pytest.approx(per_frame, abs=0.02)


@pytest.mark.slow
def test_tracks_that_no_frame_shows_are_found_in_both_senses_and_noise_gives_one_at_most() -> None:
    """S/N 5.8 in each of four frames: 2 sigma below what one frame needs.

    Noise may make 0.02 false tracks a frame: 0.3 in these sixteen, and more than one in 4 % of such cubes.
    """
    tracker, found_of, senses, false = JointTracker(window=5), [], set(), 0
    for cube in range(2):
        rng = np.random.default_rng((3, cube))
        truth = [random_track(512, length, 4, 6, 5.8, rng) for length in (20.0, 40.0, 60.0)]
        tracks, _, _ = run_cube(tracker, [t for t in truth if t is not None], 512, 8, rng)
        for t in truth:
            assert t is not None
            found_of.append(any(hit(track, t) >= 0.5 for track in tracks))
            senses.add(bool(t.ends[0, 3] > t.ends[0, 1]))
        false += sum(not any(hit(track, t) >= 0.5 for t in truth if t is not None) for track in tracks)
    assert false <= 1
    assert sum(found_of) >= 5
    assert senses == {True, False}


def test_long_trails_are_found_below_the_threshold_of_their_number_of_frames_and_short_ones_are_not() -> None:
    """S/N 5.15 in each of two frames: 7.3 together, which is asked, give or take the noise."""
    tracker, found = PieceTracker(), list[tuple[float, float]]()
    asked = float(tracker.thresholds((512, 512), 1.25, 0.849)[2])
    for cube in (10, 22, 29, 52):
        rng = np.random.default_rng((77, cube))
        truth = [t for length in (200.0, 200.0, 30.0, 30.0) if (t := random_track(512, length, 2, 4, 5.15, rng)) is not None]
        tracks, _, _ = run_cube(tracker, truth, 512, 7, rng)
        found += [(t.members[0].detection.length_px, t.snr) for t in tracks if max(hit(t, one) for one in truth) >= 0.5]
    assert sum(px > 100.0 and snr < asked for px, snr in found) == 5
    assert min(snr for px, snr in found if px < 40.0) > asked


@dataclass(frozen=True, kw_only=True)
class Eager(PieceTracker):
    """Takes much of the noise for tracks."""

    def thresholds(self, *given: Any) -> NDArray[np.float64]:
        return super().thresholds(*given) - 1.5


def on_its_lines(track: Track, searched: list[Searched]) -> float:
    """Joint S/N of a track in the pixels nearest to the lines between its published ends."""
    total = pixels = 0.0
    for member in track.members:
        d = member.detection
        steep = abs(d.row1 - d.row0) >= abs(d.col1 - d.col0)
        ends = np.array([[d.row0, d.col0], [d.row1, d.col1]])[:, :: 1 if steep else -1]
        (major0, minor0), (major1, minor1) = ends[np.argsort(ends[:, 0])]
        major = np.arange(math.ceil(major0), math.floor(major1) + 1)
        minor = np.rint(minor0 + (major - major0) * (minor1 - minor0) / (major1 - major0)).astype(np.intp)
        light = searched[member.frame].smooth[(major, minor) if steep else (minor, major)]
        total += float(light.sum()) / STEP
        pixels += len(light)
        variance = path_variance(0.849, (major1 - major0) / d.length_px)
    return total / math.sqrt(trail_variance(*variance, pixels / len(track.members)) * pixels)


def test_tracks_have_their_snr_on_straight_lines() -> None:
    """Noise has S/N on paths that step from line to line; those that were measured so lost 0.9 on their own lines."""
    lost = []
    for cube in range(6):
        searched: list[Searched] = []
        tracks, _, _ = run_cube(Eager(), [], 512, 8, np.random.default_rng((78, cube)), left=searched)
        lost += [track.snr - on_its_lines(track, searched) for track in tracks]
    assert len(lost) > 10
    assert np.mean(lost) < 0.4


@dataclass(frozen=True, kw_only=True)
class WithoutOlder(JointTracker):
    """Looks at the window alone."""

    def _about(self, window: tuple[KeptSearch, ...], older: tuple[KeptSearch, ...], *rest: Any) -> Any:
        return super()._about(window, (), *rest)


def test_a_track_is_followed_into_frames_before_the_window() -> None:
    """S/N 4 in each of six frames: 6.9 in a window of three, where 7.4 is asked, and 9.8 in all. Members lie in the window."""
    with_older, without = [], []
    for tracker, out in ((JointTracker(window=3), with_older), (WithoutOlder(window=3), without)):
        rng = np.random.default_rng(18)
        truth = [random_track(512, length, 6, 6, 4.0, rng) for length in (16.0, 20.0, 24.0, 28.0, 32.0, 36.0)]
        tracks, _, _ = run_cube(tracker, [t for t in truth if t is not None], 512, 8, rng)
        assert all(len(track.members) <= 3 for track in tracks)
        out += [max((t.snr for t in tracks if t is not None and hit(t, one) >= 0.3), default=0.0) for one in truth if one]
    assert sum(snr > 8.5 for snr in with_older) >= 4
    assert sum(snr > 8.5 for snr in without) <= 1


@pytest.mark.slow
def test_particles_of_a_storm_make_no_tracks() -> None:
    """Grazing particles at four times the density of 3,000 hits per whole frame: bright in one frame, noise beside it."""
    for seed in (2, 3):
        storm, rng = Storm(hits=12_000.0, seed=seed), np.random.default_rng(seed)
        tracks, _, _ = run_cube(PieceTracker(), [], 512, 10, rng, STARS, storm=storm)
        assert tracks == []


def test_what_is_too_bright_for_a_faint_trail_is_unknown_and_the_rest_stays() -> None:
    smooth = np.zeros((64, 64), np.int8)
    smooth[20, 10:40] = HIT_CODE - 1
    kept = smooth.copy()
    blank_hits(kept, 0.849)
    assert (kept == smooth).all()
    kept[40, 30] = HIT_CODE
    blank_hits(kept, 0.849)
    row, col = np.nonzero(kept == UNKNOWN)
    assert (row.min(), row.max(), col.min(), col.max()) == (36, 44, 26, 34)
    assert (kept[20] == smooth[20]).all()


def test_without_a_transform_nothing_of_earlier_frames_is_used() -> None:
    rng = np.random.default_rng(4)
    tracker, state = JointTracker(window=3), JointTracker(window=3).initial_state()
    for number in range(4):
        smooth = rng.integers(-40, 40, (96, 96)).astype(np.int8)
        view = DetectorView(
            header=header(number, 96), residual_adu=np.zeros((96, 96), np.float32), mask=np.zeros((96, 96), np.uint8),
            background=BackgroundModel(tile_px=64, level_adu=np.zeros((2, 2), np.float32), sigma_adu=np.ones((2, 2), np.float32)),
            stars=StarList.empty(), psf_sigma_px=0.849,
        )  # fmt: skip
        seen = TrackerView(view=view, detections=(), searched=Searched(smooth=smooth, seeds=np.zeros((0, 5))), transform=None)
        state, tracks = tracker.track(state, seen)
        assert tracks == ()
        assert [kept.header.frame for kept in state.window] == [number]


@pytest.mark.parametrize("axis", [0, 1])
def test_strips_of_a_kept_frame_are_those_of_the_frame(axis: int) -> None:
    """Stars, saturation, negative values and the frame's outside, to the last count."""
    rng = np.random.default_rng(7)
    pixels = rng.normal(110.0, 3.0, (150, 130))
    pixels[rng.integers(0, 150, 300), rng.integers(0, 130, 300)] += rng.exponential(4000.0, 300)
    pixels[5, 7], pixels[6, 7] = 65535, 0
    dark = DarkMap.of(
        (100.0 + rng.normal(0.0, 0.4, pixels.shape) + 900.0 * (rng.random(pixels.shape) < 0.003)).astype(np.float32)
    )
    counts = Counts(
        pixels=np.clip(pixels, 0, 65535).astype(np.uint16), dark=dark, defects=np.zeros(pixels.shape, np.uint8), adu_scale=1.0,
        adu_offset=0.0, saturation=65535,
    )  # fmt: skip
    background = BackgroundModel(
        tile_px=64, level_adu=rng.normal(10.0, 2.0, (3, 3)).astype(np.float32), sigma_adu=np.full((3, 3), 3.0, np.float32)
    )
    kept = kept_counts(replace(header(0), rows=150, cols=130), background, counts, ())
    geometry = roi.StripGeometry(axis=axis, major0=0, n=130, width=40, minor0_fp=-5 * 65536, slope_fp=60000)
    expected = roi.cut_strip(geometry, counts.pixels, counts.dark, 11)
    assert (kept.cut(geometry, 11).values_adu == expected.values_adu).all()


@dataclass(frozen=True, kw_only=True)
class Planted:
    """Reports a track through the last three frames whenever it may."""

    window_frames: int = 3
    seed_sigma: float = 5.0

    def initial_state(self) -> tuple[int, ...]:
        """Frame numbers seen since the window began."""
        return ()

    def track(self, state: tuple[int, ...], view: TrackerView) -> tuple[tuple[int, ...], tuple[Track, ...]]:
        """A faint one in the middle of the frame."""
        state = (*(state if view.transform is not None else ()), view.view.header.frame)[-3:]
        if len(state) < 3:
            return state, ()
        members = tuple(
            TrackMember(frame=k, detection=Detection(row0=100.0, col0=90.0 + 10 * k, row1=120.0, col1=98.0 + 10 * k, snr=4.0))
            for k in state
        )
        return state, (Track(number=5, snr=7.5, members=members),)


@dataclass(frozen=True, kw_only=True)
class Waiting(Planted):
    """Reports another track through the last two frames when no frame follows."""

    def finish(self, state: tuple[int, ...]) -> tuple[Track, ...]:
        """A faint one beside the first."""
        members = tuple(
            TrackMember(frame=k, detection=Detection(row0=60.0, col0=90.0 + 10 * k, row1=80.0, col1=98.0 + 10 * k, snr=5.0))
            for k in state[-2:]
        )
        return (Track(number=6, snr=8.0, members=members),) if len(members) == 2 else ()


def tracked_run(
    numbers: Sequence[int],
    *,
    tracker: object | None = None,
    detector: LineIntegralDetector | None = None,
    exposure_of: dict[int, int] | None = None,
    turned_from: int | None = None,
) -> Run:
    """A run of frames with these numbers; exposures (ns) where they are not the usual ones; other stars from a frame on."""
    steps = OnboardSteps(
        background=MeshBackground(), star_extractor=MatchedStars(), codec=PlanesCodec(),
        detector=detector or LineIntegralDetector(), tracker=tracker or Planted(),  # type: ignore[arg-type]
    )  # fmt: skip
    chain = OnboardChain(OnboardOptions(), steps, calibration=calibration(), camera=camera(), run_id=1)
    run = Run(chain=chain, state=chain.initial_state())
    for number in numbers:
        one = frame(number, pixels=frame(0).pixels + np.uint16(number % 5))
        if turned_from is not None and number >= turned_from:
            one = replace(one, pixels=other_stars() + np.uint16(number % 5))
        if exposure_of and number in exposure_of:
            one = replace(one, header=replace(one.header, exposure_ns=exposure_of[number]))
        run.feed(one)
    return run


def test_members_come_down_once_with_the_pixels_of_their_own_frames() -> None:
    run = tracked_run(range(5))
    frames, report = decode_downlink(run.downlink, (PlanesDecoder(),))
    assert not report.decode_failures
    assert not report.frames_incomplete
    for number, decoded in enumerate(frames):
        (group,) = [g for g in decoded.rois if g.track >= 0]
        assert (group.track, group.track_snr) == (5, 7.5)
        assert group.detection.col0 == 90.0 + 10 * number
        pixels = frame(0).pixels.astype(np.int64) + number % 5
        for strip in group.strips:
            row, col, inside = strip.pixel_coordinates(256, 256)
            dark = np.rint(calibration().dark_adu[row[inside], col[inside]])
            assert (strip.values_adu[inside] == pixels[row[inside], col[inside]] - dark).all()


@dataclass(frozen=True, kw_only=True)
class PartSeen(LineIntegralDetector):
    """Sees the middle of a trail alone."""

    def search(self, view: DetectorView, seed_sigma: float) -> tuple[tuple[Detection, ...], Searched]:
        """A third of what `Longer` has."""
        seen = Detection(row0=100.0, col0=80.0, row1=140.0, col1=120.0, snr=30.0)
        return (seen,), Searched.empty(view.mask.shape)


@dataclass(frozen=True, kw_only=True)
class Longer(Planted):
    """Reports the whole trail in two frames."""

    def track(self, state: tuple[int, ...], view: TrackerView) -> tuple[tuple[int, ...], tuple[Track, ...]]:
        """At the same place in both."""
        state = (*state, view.view.header.frame)
        whole = Detection(row0=60.0, col0=40.0, row1=180.0, col1=160.0, snr=20.0)
        members = tuple(TrackMember(frame=k, detection=whole) for k in state)
        return state, (Track(number=5, snr=30.0, members=members),) if len(state) == 2 else ()


def test_pixels_of_a_trail_beyond_a_region_that_was_sent_come_down_as_strips_of_it() -> None:
    """Also where the packet that names the region is lost, or one with pixels: then the region says that pixels are missing."""
    run = tracked_run(range(2), tracker=Longer(), detector=PartSeen())
    frames, report = decode_downlink(run.downlink, (PlanesDecoder(),))
    assert not report.decode_failures
    for number, decoded in enumerate(frames):
        (group,) = decoded.rois
        assert (group.track, group.roi_id, group.detection.snr, group.n_strips) == (5, 0, 30.0, len(group.strips))
        seen = np.zeros((256, 256), dtype=np.bool_)
        pixels = frame(0).pixels.astype(np.int64) + number % 5
        for strip in group.strips:
            row, col, inside = strip.pixel_coordinates(256, 256)
            seen[row[inside], col[inside]] = True
            dark = np.rint(calibration().dark_adu[row[inside], col[inside]])
            assert (strip.values_adu[inside] == pixels[row[inside], col[inside]] - dark).all()
        along = np.arange(60, 181)
        assert seen[along, along - 20].all()
    for start, length in packets_of(run.downlink, Apid.TRACK):
        frames, _ = decode_downlink(run.downlink[:start] + run.downlink[start + length :], (PlanesDecoder(),))
        (spoilt,) = [g for decoded in frames for g in decoded.rois if len(g.strips) < g.n_strips]
        assert spoilt.track == 5


def packets_of(downlink: bytes, apid: Apid) -> list[tuple[int, int]]:
    """Place and length of the packets of one kind."""
    out, at = [], 0
    while at < len(downlink):
        length = int.from_bytes(downlink[at + 4 : at + 6], "big") + 7
        if int.from_bytes(downlink[at : at + 2], "big") & 0x7FF == int(apid):
            out.append((at, length))
        at += length
    return out


def test_what_waits_at_the_end_of_a_run_comes_down_after_the_last_frame() -> None:
    """With that frame's number, beside the track that came with it, and the strips of every frame it lies in."""
    run = tracked_run(range(4), tracker=Waiting())
    end = run.chain.finish(run.state)
    assert [track.number for track in end.tracks] == [6]
    frames, report = decode_downlink(run.downlink + end.packets, (PlanesDecoder(),))
    assert not report.decode_failures
    assert (report.conflicts, report.apids["track"].n_missing) == (0, 0)
    assert [sorted(g.track for g in decoded.rois if g.track >= 0) for decoded in frames] == [[5], [5], [5, 6], [5, 6]]
    for number in (2, 3):
        (group,) = [g for g in frames[number].rois if g.track == 6]
        pixels = frame(0).pixels.astype(np.int64) + number % 5
        for strip in group.strips:
            row, col, inside = strip.pixel_coordinates(256, 256)
            dark = np.rint(calibration().dark_adu[row[inside], col[inside]])
            assert (strip.values_adu[inside] == pixels[row[inside], col[inside]] - dark).all()


@pytest.mark.parametrize("tracker", [NoTracker(), Planted()])
def test_without_a_last_word_nothing_follows_the_last_frame(tracker: object) -> None:
    run = tracked_run(range(3), tracker=tracker)
    assert run.chain.finish(run.state).packets == b""


def test_the_last_word_says_nothing_of_frames_before_a_break() -> None:
    """Their tracks came down with the frame that ended the window."""
    run = tracked_run((0, 1, 2, 5, 6), tracker=Waiting())
    (track,) = run.chain.finish(run.state).tracks
    assert [member.frame for member in track.members] == [5, 6]


@pytest.mark.parametrize(("n", "snr"), [(2, 7.0), (3, 6.0)])
def test_an_object_of_a_runs_last_frames_is_found_when_no_frame_follows(n: int, snr: float) -> None:
    """Below the 7.2 of one frame, and in none of the tracks that came with the frames."""
    chain, stars = chain_with(tracker=JointTracker()), star_light()
    state, before, trails = chain.initial_state(), [], []
    for number in range(7):
        k = number - (7 - n)
        if k >= 0:
            trails.append(trail((160.0 + 4.0 * k, 90.0 + 30.0 * k), 24.0, 7.6, snr, SHAPE, NOISE_E))
        drawn = [
            TruthStreak(
                index=0, frame=number, object_id=0, path=each.path, snr=each.snr, length_px=24.0, rate_deg_s=1.0,
                attainable_end_px=0.0,
            )
            for each in trails[-1:]
        ]  # fmt: skip
        state, result = chain.process(state, frame_of(number, stars, drawn, np.random.default_rng([71, n, number])))
        before += result.tracks
    end = chain.finish(state)
    assert before == []
    assert {track.number for track in end.tracks} == {0}
    found = max(end.tracks, key=lambda track: track.snr)
    assert [member.frame for member in found.members] == list(range(7 - n, 7))
    for member, each in zip(found.members, trails, strict=True):
        d = member.detection
        assert 0.5 * (d.row0 + d.row1) == pytest.approx(each.path.row.mean(), abs=4.0)
        assert 0.5 * (d.col0 + d.col1) == pytest.approx(each.path.col.mean(), abs=6.0)
    assert end.packets


def test_the_last_word_is_sent_once_though_a_run_is_killed_after_any_frame(tmp_path: Path) -> None:
    """Also when it is killed after that word, before the files are joined."""
    frames = [frame(number, pixels=frame(0).pixels + np.uint16(number)) for number in range(4)]
    whole: set[bytes] = set()
    for last in (None, *range(len(frames) + 1)):
        folder = RunDirectory(path=tmp_path / str(last))
        folder.prepare(resume=False, force=False)
        if last is not None:
            with pytest.raises(KeyboardInterrupt) if last < len(frames) else nullcontext():
                OnboardStage(run=folder, chain=tracked_run((), tracker=Waiting()).chain).take(
                    killed_after(frames, last), Silent()
                )
        stage = OnboardStage(run=folder, chain=tracked_run((), tracker=Waiting()).chain)
        join(folder, stage.take(frames[stage.first :], Silent()), FaultOptions(), 0)
        whole.add(folder.downlink.read_bytes())
    (downlink,) = whole
    decoded, _ = decode_downlink(downlink, (PlanesDecoder(),))
    assert [sorted(g.track for g in one.rois if g.track >= 0) for one in decoded] == [[5], [5], [5, 6], [5, 6]]


def killed_after(frames: Sequence[Frame], last: int) -> Iterator[Frame]:
    """The first frames, then an interrupt where not all are wanted."""
    yield from frames[:last]
    if last < len(frames):
        raise KeyboardInterrupt


def test_a_lost_track_packet_is_missed_and_named() -> None:
    run = tracked_run(range(4))
    whole = run.downlink
    start = next(k for k in range(len(whole)) if whole[k : k + 2] == (0x0800 | int(Apid.TRACK)).to_bytes(2, "big"))
    length = int.from_bytes(whole[start + 4 : start + 6], "big") + 7
    frames, _ = decode_downlink(whole[:start] + whole[start + length :], (PlanesDecoder(),))
    assert len(frames) == 4
    assert sum(any(g.track >= 0 for g in decoded.rois) for decoded in frames) == 3


@pytest.mark.parametrize(
    ("numbers", "exposures", "ended_at"),
    [((0, 1, 2, 4, 5, 6), {}, 4), ((0, 1, 2, 3, 4, 5), {3: 100_000_000, 4: 100_000_000, 5: 100_000_000}, 3)],
)
def test_tracking_ends_at_a_gap_and_at_another_exposure_and_says_so(
    numbers: tuple[int, ...], exposures: dict[int, int], ended_at: int
) -> None:
    run = tracked_run(numbers, exposure_of=exposures)
    for number, result in zip(numbers, run.results, strict=True):
        assert bool(result.housekeeping.flags & FrameFlag.TRACKS_ENDED) == (number == ended_at)
        for track in result.tracks:
            frames = {member.frame for member in track.members}
            assert min(frames) >= ended_at or max(frames) < ended_at


def test_a_repeated_frame_ends_the_window() -> None:
    last = header(3)
    assert continues(last, header(4))
    assert not continues(last, header(3))
    assert not continues(last, header(5))
    assert not continues(None, header(0))
    assert not continues(last, replace(header(4), t_start_tai_ns=last.t_start_tai_ns - 1))


def test_no_tracker_keeps_and_sends_nothing() -> None:
    run = tracked_run(range(3), tracker=NoTracker())
    assert run.state.tracking is None
    assert all(int(Apid.TRACK) not in result.bytes_by_apid for result in run.results)


def test_a_detector_that_leaves_nothing_is_refused_in_one_line() -> None:
    steps = OnboardSteps(
        background=MeshBackground(), star_extractor=MatchedStars(), detector=ThresholdDetector(), codec=PlanesCodec(),
        tracker=JointTracker(),
    )  # fmt: skip
    with pytest.raises(UserError, match=r"onboard\.tracker: JointTracker goes on from what a detector's search leaves"):
        OnboardChain(OnboardOptions(), steps, calibration=None, camera=camera(), run_id=1)


def other_stars() -> NDArray[np.uint16]:
    """Forty stars at random places: those of `frame` stand on a grid, which fits on itself anywhere."""
    rng = np.random.default_rng(8)
    row, col = np.indices((256, 256), dtype=float)
    pixels = rng.normal(260.0, 2.4, (256, 256))
    for at in rng.uniform(10.0, 245.0, (40, 2)):
        pixels += rng.uniform(100.0, 900.0) * np.exp(-0.5 * ((row - at[0]) ** 2 + (col - at[1]) ** 2) / 0.8)
    return np.rint(pixels).astype(np.uint16)


def flagged(run: Run) -> list[int]:
    """Places in a run of the frames that end tracking."""
    return [k for k, result in enumerate(run.results) if result.housekeeping.flags & FrameFlag.TRACKS_ENDED]


def test_a_frame_that_comes_twice_ends_the_window_and_says_so() -> None:
    """Nothing is linked across it: the frame after it begins anew."""
    run = tracked_run((0, 1, 2, 2, 3, 4, 5))
    assert flagged(run) == [3]
    spans = [(track.members[0].frame, track.members[-1].frame) for result in run.results for track in result.tracks]
    assert spans == [(0, 2), (3, 5)]


def test_frames_that_do_not_come_end_the_window_and_the_next_one_says_so() -> None:
    run = tracked_run((0, 1, 2, 5, 6, 7))
    assert flagged(run) == [3]
    assert [track.members[0].frame for result in run.results for track in result.tracks] == [0, 5]


def test_a_slew_ends_the_window_and_says_so() -> None:
    """Other stars from the third frame on."""
    run = tracked_run(range(6), turned_from=3)
    assert flagged(run) == [3]
    assert [track.members[0].frame for result in run.results for track in result.tracks] == [0, 3]


def test_a_change_of_exposure_and_back_ends_the_window_twice() -> None:
    run = tracked_run(range(7), exposure_of={3: 100_000_000})
    assert flagged(run) == [3, 4]
    assert [track.members[0].frame for result in run.results for track in result.tracks] == [0, 4]


@pytest.mark.slow
def test_a_chain_taken_up_from_its_saved_state_sends_the_same_bytes() -> None:
    """Saved and read back after every frame, with the joint tracker's window in it."""
    plain, saved = (tracked_run((), tracker=JointTracker(window=3, seed_sigma=4.0)) for _ in range(2))
    rng, n_seeds = np.random.default_rng(6), 0
    for number in range(5):
        noise = rng.integers(0, 8, (256, 256)).astype(np.uint16)
        one = frame(number, pixels=frame(0).pixels + noise)
        plain.feed(one)
        saved.feed(one)
        saved.state = checkpoint.from_bytes(checkpoint.to_bytes(saved.state))
        n_seeds += len(saved.state.tracking.step.window[-1].seeds)
    assert n_seeds > 0
    assert len(saved.state.tracking.step.window) == 2
    assert saved.downlink == plain.downlink


def test_a_tracker_adds_packets_and_changes_no_other() -> None:
    """Without the packets of tracks the downlink is that of `none`, but for the number of the parameter set in the headers."""
    without, planted = tracked_run(range(4), tracker=NoTracker()), tracked_run(range(4))
    assert packets_but(planted.downlink, Apid.TRACK) == packets_but(without.downlink, Apid.TRACK)
    assert len(planted.downlink) > len(without.downlink)


PARAMETER_SET = slice(436, 440)
"""Place in the fields of a header packet (ICD)."""


def packets_but(downlink: bytes, left_out: Apid) -> list[bytes]:
    """The packets of every other kind, in order; those of headers without their set of parameters and checksum."""
    out, at = [], 0
    while at < len(downlink):
        length = int.from_bytes(downlink[at + 4 : at + 6], "big") + 7
        kind, packet = int.from_bytes(downlink[at : at + 2], "big") & 0x7FF, downlink[at : at + length]
        if kind == Apid.HEADER:
            packet = packet[: HEADER_BYTES + PARAMETER_SET.start] + packet[HEADER_BYTES + PARAMETER_SET.stop : -CRC.size]
        if kind != left_out:
            out.append(packet)
        at += length
    return out


def test_what_only_the_tracker_asks_for_takes_nothing_from_the_single_frame() -> None:
    """Candidates of a lower threshold hold those of the higher one, in the same order, and are told from them by their S/N."""
    image = np.random.default_rng(3).normal(0.0, 32.0, (256, 256)).astype(np.int16)
    noise = np.array([32.0**2, 32.0**2])
    high, _ = dyadic.coarse_segments(image.copy(), noise, 4.0, 4, 10_000)
    low, _ = dyadic.coarse_segments(image.copy(), noise, 3.6, 4, 10_000)
    assert 20 < len(high) < 0.6 * len(low)
    assert (dyadic.in_order(low[dyadic.above(low, 4.0)]) == high).all()


def test_a_horizon_leaves_work_for_a_trail_elsewhere() -> None:
    """20,000 candidates of one place and 20 fainter ones of another: after a thousandth of the work the best of those is reached.

    Candidates along rows and along columns of one place are in one.
    """
    rng = np.random.default_rng(5)
    rows, cols = rng.uniform(1_030.0, 1_270.0, (2, 20_000))
    horizon = np.column_stack((np.zeros(20_000), rows, cols, rows + 100.0, cols + 20.0, rng.uniform(50.0, 60.0, 20_000)))
    place = np.linspace(10.0, 100.0, 20)
    trail = np.column_stack((np.ones(20), place + 300.0, place, place + 400.0, place + 30.0, np.linspace(20.0, 30.0, 20)))
    ordered = dyadic.in_order(np.concatenate((horizon, trail)))
    assert len(ordered) == 20_020
    (found,) = np.nonzero(ordered[:, 5] == 30.0)
    assert found[0] <= 20
    assert (dyadic.in_order(horizon[:5_000])[:, 5] == np.sort(horizon[:5_000, 5])[::-1]).all(), "few ones by their S/N alone"
