"""The chain as a whole: bad input, budget, priorities, plug-ins that fail, determinism."""

import gc
import pickle
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from ground.ingest import decode_downlink
from ground.ingest.codecs import PlanesDecoder, RawDecoder, SqrtPlanesDecoder
from ground.ingest.rans import RansDecoder
from onboard.chain import OnboardSteps
from onboard.detect import LineIntegralDetector, ThresholdDetector
from onboard.downlink.budget import Allowance
from onboard.downlink.codec import PlanesCodec, RansCodec, RawCodec, SqrtPlanesCodec
from onboard.image.background import MeshBackground
from onboard.options import DownlinkOptions, RoiOptions
from onboard.stars.matched import MatchedStars
from onboard.track.joint import JointTracker
from sboc_e2e.icd import layout
from sboc_e2e.icd.errors import ContractError, PluginError
from sboc_e2e.icd.flags import FrameFlag, StreakFlag
from sboc_e2e.icd.frame import Frame
from sboc_e2e.icd.signals import BackgroundModel, Detection, DetectorView, StarList
from tests.onboard import small_run
from tests.onboard.small_run import SIDE, STREAK, PlantedDetector, frame, header, start_run

POINT = Detection(row0=60.0, col0=60.0, row1=60.0, col1=60.0, snr=9.0, flags=StreakFlag.POINT_LIKE)


def steps_with(**changed: Any) -> OnboardSteps:
    """The default steps with some of them replaced."""
    usual: dict[str, Any] = {
        "background": MeshBackground(),
        "star_extractor": MatchedStars(),
        "detector": PlantedDetector(),
        "codec": PlanesCodec(),
    }
    return OnboardSteps(**{**usual, **changed})


def only_frame(downlink: bytes) -> Any:
    """The one frame of a downlink."""
    frames, report = decode_downlink(downlink, [PlanesDecoder(), RawDecoder(), SqrtPlanesDecoder()])
    assert report.n_decode_failures == 0
    assert len(frames) == 1
    return frames[0]


def test_plain_frame_comes_down_whole() -> None:
    """Header, stars, strips and mesh on ground equal what was found on board."""
    run = start_run()
    result = run.feed(frame(0))
    got = only_frame(run.downlink)
    assert got.flags == FrameFlag(0)
    assert got.header.attitude is not None
    assert got.housekeeping == replace(
        result.housekeeping,
        background_adu=pytest.approx(result.housekeeping.background_adu, rel=1e-6),
        sigma_adu=pytest.approx(result.housekeeping.sigma_adu, rel=1e-6),
    )
    assert len(got.stars) == result.housekeeping.n_stars_sent > 20
    assert got.psf_sigma_px == pytest.approx(0.849, rel=0.03)
    assert len(got.rois) == 1
    for sent, received in zip(result.rois[0].strips, got.rois[0].strips, strict=True):
        assert (sent.values_adu == received.values_adu).all()
        assert (sent.major0, sent.minor0_fp, sent.slope_fp) == (received.major0, received.minor0_fp, received.slope_fp)
    assert got.rois[0].detection.snr == 20.0
    assert got.background is not None
    assert got.background.sigma_adu.mean() == pytest.approx(result.housekeeping.sigma_adu, rel=0.02)
    assert got.thumbnail_adu is not None


def test_values_are_raw_minus_rounded_dark() -> None:
    """With a dark of 256.3 ADU the strips hold raw - 256."""
    run = start_run()
    run.feed(frame(0))
    strip = only_frame(run.downlink).rois[0].strips[0]
    row, col, inside = strip.pixel_coordinates(SIDE, SIDE)
    assert (strip.values_adu[inside] == frame(0).pixels[row[inside], col[inside]].astype(int) - 256).all()


@pytest.mark.parametrize(
    ("pixels", "flag"),
    [
        (np.zeros((SIDE, SIDE), np.uint16), FrameFlag.EMPTY_SIGNAL),
        (np.full((SIDE, SIDE), 65535, np.uint16), FrameFlag.SATURATED | FrameFlag.ALL_MASKED),
        (np.full((SIDE, SIDE), np.nan, np.float32), FrameFlag.ALL_MASKED),
        (np.full((SIDE, SIDE), np.inf, np.float32), FrameFlag.ALL_MASKED),
        (np.full((SIDE, SIDE), 1e-3, np.float32), FrameFlag.EMPTY_SIGNAL),
    ],
)
def test_frames_without_content_are_flagged(pixels: Any, flag: FrameFlag) -> None:
    """All zero, all saturated, all NaN, all infinite, constant: a flagged header comes down, nothing is invented."""
    run = start_run()
    run.feed(frame(0, pixels=pixels))
    got = only_frame(run.downlink)
    assert got.flags & flag == flag
    assert got.flags & FrameFlag.NO_STARS
    assert len(got.stars) == 0
    assert got.rois == ()


def test_ninety_percent_masked_still_works() -> None:
    """Stars in the remaining tenth are found; nothing is flagged as masked at 89 %."""
    pixels = small_run.sky(0).astype(np.float32)
    pixels[int(0.11 * SIDE) :] = np.nan
    run = start_run(detections=())
    run.feed(frame(0, pixels=pixels))
    got = only_frame(run.downlink)
    assert not got.flags & FrameFlag.ALL_MASKED
    assert len(got.stars) >= 4
    assert got.stars.row.max() < 0.12 * SIDE


@pytest.mark.parametrize("detector", [LineIntegralDetector(), ThresholdDetector()])
def test_detectors_live_with_frames_that_are_mostly_missing(detector: Any) -> None:
    """89 % NaN, scattered or in one piece, with a saturated block: nothing that is invented, and a trail in the rest is found."""
    rng = np.random.default_rng(12)
    row, col = np.indices((SIDE, SIDE), dtype=np.float64)
    sky = rng.normal(260.0, 2.4, (SIDE, SIDE)) + 12.0 * np.exp(-0.5 * ((row - 14.0) / 0.9) ** 2) * ((col > 40) & (col < 180))
    pixels = sky.astype(np.float32)
    pixels[10:14, 200:204] = 65535.0
    scattered = pixels.copy()
    scattered[rng.random(pixels.shape) < 0.89] = np.nan
    pixels[28:] = np.nan
    run = start_run(steps=steps_with(detector=detector))
    assert run.feed(frame(0, pixels=scattered)).housekeeping.n_detections <= 1
    whole = run.feed(frame(1, pixels=pixels))
    assert any(d.length_px > 100.0 and abs(d.row0 - 14.0) < 2.0 and abs(d.row1 - 14.0) < 2.0 for d in whole.detections)
    assert len(whole.detections) <= 2


def test_no_star_and_one_star() -> None:
    """An empty sky is flagged; one star is one star."""
    rng = np.random.default_rng(3)
    empty = np.rint(rng.normal(260.0, 2.4, (SIDE, SIDE))).astype(np.uint16)
    one = empty.copy()
    one[100:103, 50:53] += np.array([[30, 80, 30], [80, 200, 80], [30, 80, 30]], np.uint16)
    run = start_run(detections=())
    run.feed(frame(0, pixels=one))
    got = only_frame(run.downlink)
    assert len(got.stars) == 1
    assert (got.stars.row[0], got.stars.col[0]) == (pytest.approx(101, abs=0.1), pytest.approx(51, abs=0.1))
    run = start_run(detections=())
    run.feed(frame(0, pixels=empty))
    assert only_frame(run.downlink).flags & FrameFlag.NO_STARS
    assert only_frame(run.downlink).psf_sigma_px is None


def test_float_frame_is_rounded_at_a_twentieth_of_its_noise() -> None:
    """Strips times scale plus offset give the float pixels back to 0.025 sigma."""
    pixels = small_run.sky(0).astype(np.float32) * np.float32(0.37) + np.float32(1000.0)
    run = start_run(with_calibration=False)
    run.feed(frame(0, pixels=pixels))
    got = only_frame(run.downlink)
    sigma = 2.39 * 0.37
    assert got.adu_scale == pytest.approx(0.05 * sigma, rel=0.1)
    strip = got.rois[0].strips[0]
    row, col, inside = strip.pixel_coordinates(SIDE, SIDE)
    back = strip.values_adu[inside] * got.adu_scale + got.adu_offset
    assert np.abs(back - pixels[row[inside], col[inside]]).max() <= 0.51 * got.adu_scale
    assert got.background is not None
    assert got.background.sigma_adu.mean() == pytest.approx(sigma, rel=0.05)
    assert got.background.level_adu.mean() == pytest.approx(1000.0 + 0.37 * (256 + 2.8 / 1.2), abs=0.1 * sigma)


def test_near_lossless_steps_follow_the_noise_in_float_frames_too() -> None:
    """A trail of 9,000 ADU: as many bytes as the same frame takes in integers, and errors of the same share of the noise."""
    along, row, col = np.linspace(0.0, 1.0, 2000)[:, None, None], np.arange(SIDE)[:, None], np.arange(SIDE)
    trail = np.zeros((SIDE, SIDE))
    for share in along.ravel():
        i, j = STREAK.row0 + share * (STREAK.row1 - STREAK.row0), STREAK.col0 + share * (STREAK.col1 - STREAK.col0)
        near = np.s_[int(i) - 6 : int(i) + 8, int(j) - 6 : int(j) + 8]
        trail[near] += np.exp(-0.5 * ((row[near[0]] - i) ** 2 + (col[near[1]] - j) ** 2) / 2.0**2)
    bright = np.random.default_rng(1).poisson(trail * (9000.0 * 1.2 / trail.max())) / 1.2
    pixels = np.rint(small_run.sky(0) + bright)
    sent = []
    for dtype in (np.uint16, np.float32):
        run = start_run(codec=SqrtPlanesCodec())
        result = run.feed(frame(0, pixels=pixels.astype(dtype)))
        (group,), got = only_frame(run.downlink).rois, only_frame(run.downlink)
        errors = []
        for strip in group.strips:
            i, j, inside = strip.pixel_coordinates(SIDE, SIDE)
            value = strip.values_adu[inside] * got.adu_scale + got.adu_offset
            i, j = i[inside], j[inside]
            errors.append((value + 256.0 - pixels[i, j]) / np.sqrt(2.4**2 + bright[i, j] / 1.2))
        sent.append((result.bytes_by_apid[layout.Apid.ROI], np.concatenate(errors).std()))
    assert sent[1][0] == pytest.approx(sent[0][0], rel=0.05)
    assert sent[1][1] == pytest.approx(sent[0][1], rel=0.1)


@pytest.mark.parametrize("saturation_adu", [np.nan, -1e30, np.inf])
def test_saturation_level_must_be_a_number_of_the_sensor(saturation_adu: float) -> None:
    """Refused when the header is made, by its name."""
    with pytest.raises(ContractError, match=r"header\.saturation_adu: expected a value in"):
        replace(header(0), saturation_adu=saturation_adu)


def test_float_values_beyond_all_measurement_are_missing() -> None:
    """Near the end of 32-bit floats, and below: the frame is processed, or flagged as a whole."""
    huge = small_run.sky(0).astype(np.float32) * np.float32(1e35)
    run = start_run(with_calibration=False)
    run.feed(frame(0, pixels=huge))
    assert only_frame(run.downlink).flags & FrameFlag.ALL_MASKED
    column = small_run.sky(1).astype(np.float32)
    column[:, 9] = 3e38
    assert run.feed(frame(1, pixels=column)).housekeeping.n_masked == SIDE
    high = small_run.sky(2).astype(np.float32) + np.float32(1e14)
    assert run.feed(frame(2, pixels=high)).housekeeping.n_masked == SIDE * SIDE


def test_unknown_gain_and_telemetry_are_flagged() -> None:
    """Without gain, read noise, attitude and observer: flags, and fluxes in ADU."""
    bare = replace(header(0, telemetry=False), gain_e_adu=None, read_noise_e=None)
    run = start_run()
    run.feed(Frame(header=bare, pixels=small_run.sky(0)))
    flags = only_frame(run.downlink).flags
    expected = FrameFlag.GAIN_ASSUMED | FrameFlag.READ_NOISE_ASSUMED | FrameFlag.NO_ATTITUDE | FrameFlag.NO_OBSERVER
    assert flags == expected


def test_time_backwards_is_flagged_and_processed() -> None:
    """A clock that jumps back costs the flag, not the frame; the budget does not shrink."""
    run = start_run()
    run.feed(frame(5))
    back = replace(header(6), t_start_tai_ns=header(0).t_start_tai_ns)
    result = run.feed(Frame(header=back, pixels=small_run.sky(6)))
    assert result.housekeeping.flags & FrameFlag.TIME_BACKWARDS
    assert result.housekeeping.n_rois_sent == 1


def test_repeated_frame_sends_its_header_only() -> None:
    """The same pixels under a new number publish nothing a second time."""
    run = start_run()
    run.feed(frame(0))
    result = run.feed(Frame(header=header(1), pixels=small_run.sky(0)))
    assert result.housekeeping.flags & FrameFlag.REPEATED_FRAME
    assert result.housekeeping.n_stars_sent == 0
    assert result.rois == ()


def test_wrong_shape_names_both_shapes() -> None:
    """A frame larger than the calibration is refused in one line."""
    run = start_run()
    with pytest.raises(ContractError, match=r"inside the calibration's 256 x 256 px, got 300 x 300 at \(0, 0\)"):
        run.feed(frame(0, side=300, pixels=np.zeros((300, 300), np.uint16)))


def test_wrong_dtype_is_refused_at_birth() -> None:
    """Frames are uint16 or float32."""
    with pytest.raises(ContractError, match="expected uint16 or float32, got int64"):
        Frame(header=header(0), pixels=np.zeros((SIDE, SIDE), np.int64))  # type: ignore[arg-type]  # what the test is about


DARK_ADU = 256.0 + 0.27 * np.arange(SIDE)[:, None] + 0.41 * np.arange(SIDE)
"""A dark that differs everywhere."""


@pytest.mark.parametrize(("window", "binning", "whole"), [((100, 120), 1, True), ((200, 240), 2, True), ((100, 120), 1, False)])
def test_windowed_readout_uses_its_part_of_the_dark(window: tuple[int, int], binning: int, whole: bool) -> None:
    """What a strip carries is above the dark under it: maps of the whole detector, and maps that were made for the window."""
    given = replace(header(0, 64), window_row0=window[0], window_col0=window[1], bin_rows=binning, bin_cols=binning)
    part = DARK_ADU[100:164, 120:184]
    pixels = np.rint(small_run.sky(0, 64) - small_run.PEDESTAL_ADU + part).astype(np.uint16)
    side, dark = (SIDE, DARK_ADU) if whole else (64, part)
    run = start_run(detections=(replace(STREAK, row0=10, col0=10, row1=50, col1=50),), side=side, dark_adu=dark)
    run.feed(Frame(header=given, pixels=pixels))
    (group,) = only_frame(run.downlink).rois
    above = pixels - np.rint(part.astype(np.float32))
    for strip in group.strips:
        row, col, inside = strip.pixel_coordinates(64, 64)
        assert np.array_equal(strip.values_adu[inside], above[row[inside], col[inside]])


def test_window_across_binned_pixels_is_refused() -> None:
    """Pixels of a window that begins inside of a binned pixel are not those of the calibration."""
    run = start_run()
    with pytest.raises(ContractError, match=r"border of the calibration's pixels of 2 x 2, got detector pixel \(201, 240\)"):
        run.feed(
            Frame(
                header=replace(header(0, 64), window_row0=201, window_col0=240, bin_rows=2, bin_cols=2),
                pixels=small_run.sky(0, 64),
            )
        )


def test_frames_on_request_are_sent_whole() -> None:
    """By their numbers, beside every n-th, and no other."""
    run = start_run(downlink=DownlinkOptions(whole_frames=(2, 3), whole_frame_every=4))
    sent = [layout.Apid.FRAME in run.feed(frame(number)).bytes_by_apid for number in range(6)]
    assert sent == [True, False, True, True, True, False]


@dataclass(frozen=True, kw_only=True)
class Raising:
    """A detector with a bug."""

    history_frames: int = 0

    def detect(self, view: DetectorView) -> tuple[Detection, ...]:
        """Fails."""
        raise ZeroDivisionError("oops")


@dataclass(frozen=True, kw_only=True)
class Scribbling:
    """A detector that writes into its input."""

    history_frames: int = 0

    def detect(self, view: DetectorView) -> tuple[Detection, ...]:
        """Tries to."""
        view.residual_adu[0, 0] = 1.0
        return ()


@pytest.mark.parametrize(
    ("detector", "message"),
    [
        (Raising(), r"onboard\.detector .*:Raising: ZeroDivisionError: oops"),
        (Scribbling(), r"onboard\.detector .*:Scribbling: ValueError: assignment destination is read-only"),
        (PlantedDetector(detections=(replace(STREAK, row1=300.0),)), r"PlantedDetector: end \(300\.0, 200\.0\) lies outside"),
        (PlantedDetector(detections=("not a detection",)), "PlantedDetector: expected a Detection, got str"),  # type: ignore[arg-type]  # on purpose
    ],
)
def test_faulty_detector_stops_the_run_and_is_named(detector: Any, message: str) -> None:
    """A plug-in's bug is a PluginError with its name."""
    run = start_run(steps=steps_with(detector=detector))
    with pytest.raises(PluginError, match=message):
        run.feed(frame(0))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"snr": 1e300}, r"detection\.snr: expected a value in \[0, 1e\+09\], got 1e\+300"),
        ({"snr": -1.0}, r"detection\.snr: expected a value in \[0, 1e\+09\], got -1"),
        ({"sagitta_px": 1e39}, r"detection\.sagitta_px: expected a value within \+-256, got 1e\+39"),
    ],
)
def test_numbers_that_no_packet_holds_are_the_detectors_fault(wrong: dict[str, float], message: str) -> None:
    """They are found when the detector returns, by its name, not while packets are made."""
    run = start_run(detections=(replace(STREAK, **wrong),))  # type: ignore[arg-type]  # floats only
    with pytest.raises(PluginError, match=rf"onboard\.detector .*:PlantedDetector: {message}"):
        run.feed(frame(0))


@dataclass(frozen=True, kw_only=True)
class Mistaken:
    """Background estimator and star extractor in one that spoils a right answer."""

    level_adu: float = 2.0
    sigma_adu: float = 2.4
    tiles: int = 4
    row: float = 50.0
    flux_e: tuple[float, float] = (200.0, 100.0)

    def estimate(self, pixels_adu: Any, dark_adu: Any, mask: Any) -> BackgroundModel:
        """A flat sky with one node of its own."""
        level, sigma = np.full((self.tiles, 4), 2.0), np.full((self.tiles, 4), 2.4)
        level[0, 0], sigma[1, 1] = self.level_adu, self.sigma_adu
        return BackgroundModel(tile_px=64, level_adu=level, sigma_adu=sigma)

    def extract(self, view: DetectorView) -> StarList:
        """Two stars."""
        flux = np.array(self.flux_e)
        return StarList(row=np.array([self.row, 60.0]), col=np.array([9.0, 80.0]), flux_e=flux, snr=flux, flags=np.zeros(2))


@pytest.mark.parametrize(
    ("seam", "step", "message"),
    [
        ("background", Mistaken(level_adu=np.nan), r"level_adu: expected values in \[-2\.14748e\+09, 2\.14748e\+09\], got nan"),
        ("background", Mistaken(sigma_adu=-1.0), r"sigma_adu: expected values in \[1e-06, 2\.14748e\+09\], got -1"),
        ("background", Mistaken(sigma_adu=0.0), r"sigma_adu: expected values in \[1e-06, 2\.14748e\+09\], got 0"),
        ("background", Mistaken(tiles=5), r"expected a mesh of \(4, 4\) for tiles of 64 px, got \(5, 4\)"),
        ("star_extractor", Mistaken(row=np.nan), r"row: expected values in \[-64, 319\], got nan"),
        ("star_extractor", Mistaken(row=5e8), r"row: expected values in \[-64, 319\], got 5e\+08"),
        ("star_extractor", Mistaken(flux_e=(np.inf, 100.0)), r"flux_e: expected values in .* got inf"),
        ("star_extractor", Mistaken(flux_e=(100.0, 200.0)), "expected stars by falling flux"),
    ],
)
def test_what_background_and_stars_must_be_is_checked_for_every_frame(seam: str, step: Mistaken, message: str) -> None:
    """Nothing that breaks the contract reaches the packets, and the step that broke it is named."""
    run = start_run(steps=steps_with(**{seam: step}))
    with pytest.raises(PluginError, match=rf"onboard\.{seam} .*:Mistaken: {message}"):
        run.feed(frame(0))


def test_two_plausible_answers_pass() -> None:
    """What the test above spoils."""
    assert len(start_run(steps=steps_with(background=Mistaken(), star_extractor=Mistaken())).feed(frame(0)).stars) == 2


@pytest.mark.parametrize("most_px", [2.0, 4.0])
def test_no_region_is_wider_than_its_largest_half_width(most_px: float) -> None:
    """The largest half width holds for the one that is asked for by PSF sigmas too."""
    level = replace(STREAK, row1=STREAK.row0)
    result = start_run(detections=(level,), roi=RoiOptions(half_width_sigma=20.0, max_half_width_px=most_px)).feed(frame(0))
    assert max(strip.values_adu.shape[1] for strip in result.rois[0].strips) <= 2 * most_px + 2


def test_tight_budget_drops_in_order_of_priority() -> None:
    """Stars stay, the better streak stays, the suspicious one and the pictures go; everything dropped is counted."""
    good, cosmic = STREAK, replace(STREAK, row0=20.0, row1=140.0, snr=40.0, flags=StreakFlag.COSMIC_LIKE)
    roomy = start_run(detections=(cosmic, good)).feed(frame(0))
    needed = {apid: n for apid, n in roomy.bytes_by_apid.items() if apid in (layout.Apid.HEADER, layout.Apid.STARS)}
    room = sum(needed.values()) + roomy.bytes_by_apid[layout.Apid.ROI] // 2 + 100
    run = start_run(detections=(cosmic, good), downlink=DownlinkOptions(budget_mbit_s=room * 8 / 0.2 / 1e6, burst_s=0.0))
    result = run.feed(frame(0))
    assert result.housekeeping.flags & FrameFlag.BUDGET_CUT
    assert result.rois[0].detection.snr == 20.0
    assert result.housekeeping.n_rois_sent + result.housekeeping.n_rois_dropped == 2
    assert result.housekeeping.bytes_dropped > 0
    assert layout.Apid.BACKGROUND not in result.bytes_by_apid
    assert len(result.packets) <= room


def test_a_streak_that_does_not_fit_is_cut_before_it_is_dropped() -> None:
    """Between the full and the tight size, the tight one is sent and flagged ROI_CUT."""
    faint = replace(STREAK, snr=7.0)
    full = start_run(detections=(faint,)).feed(frame(0))
    fixed = full.bytes_by_apid[layout.Apid.HEADER] + full.bytes_by_apid[layout.Apid.STARS]
    room = fixed + 0.8 * full.bytes_by_apid[layout.Apid.ROI]
    run = start_run(detections=(faint,), downlink=DownlinkOptions(budget_mbit_s=room * 8 / 0.2 / 1e6, burst_s=0.0))
    result = run.feed(frame(0))
    assert result.rois[0].detection.flags & StreakFlag.ROI_CUT
    assert result.housekeeping.n_rois_dropped == 0


def test_unspent_budget_is_kept_for_a_burst() -> None:
    """After quiet frames a burst may spend what they left, but not more than burst_s of it."""
    run = start_run(detections=(), downlink=DownlinkOptions(budget_mbit_s=1.0, burst_s=0.5))
    for number in range(5):
        run.feed(frame(number))
    rate = 1e6 / 8
    assert 0.25 * rate < run.state.allowance.credit_bytes <= 0.5 * rate


def test_a_clock_that_jumps_grants_no_more_than_a_burst() -> None:
    """A day between two frames gave 43 GB at 4 Mbit/s; after one that went backwards the debt grew no further."""
    allowance = Allowance(rate_bytes_s=5e5, burst_s=2.0)
    assert allowance.after(86_400.0, 0.2).credit_bytes == 5e5 * 2.0
    assert allowance.after(-86_400.0, 0.2).credit_bytes == 0.0
    # an exposure longer than the burst is the time that a frame takes
    assert Allowance(rate_bytes_s=5e5, burst_s=0.0).after(86_400.0, 0.2).credit_bytes == 5e5 * 0.2


def test_without_a_limit_frames_that_took_no_time_are_sent_all_the_same() -> None:
    """Exposures of unknown length and frames of one and the same time earn nothing at any rate but 0."""
    assert Allowance(rate_bytes_s=5e5, burst_s=2.0).after(0.0).credit_bytes == 0.0
    unlimited = Allowance(rate_bytes_s=0.0, burst_s=2.0).after(0.0)
    assert unlimited.spend(10**12).after(0.0).credit_bytes == np.inf


def test_particle_hits_never_displace_a_trail_and_are_counted() -> None:
    """300 hits far brighter than a streak: it is sent, with one of them; the others are counted as dropped."""
    hit = replace(POINT, flags=StreakFlag.COSMIC_LIKE | StreakFlag.POINT_LIKE)
    hits = tuple(replace(hit, row0=5.0 + 0.5 * k, row1=5.0 + 0.5 * k, snr=1000.0 + k) for k in range(300))
    result = start_run(detections=(*hits, STREAK)).feed(frame(0))
    counts = result.housekeeping
    assert [group.detection.snr for group in result.rois] == [STREAK.snr, 1299.0]
    assert (counts.n_detections, counts.n_rois_sent, counts.n_rois_dropped) == (301, 2, 299)
    assert counts.flags & FrameFlag.STORM
    assert counts.threshold_sigma == 0.0  # nothing but hits was held back


def test_storm_is_limited_and_flagged() -> None:
    """More detections than allowed: half of the places go to the best; flag and S/N above which all are sent come down."""
    many = tuple(replace(POINT, row0=10.0 + 3 * k, row1=10.0 + 3 * k, snr=7.0 + k) for k in range(60))
    run = start_run(detections=many, roi=RoiOptions(max_per_frame=10))
    result = run.feed(frame(0))
    assert result.housekeeping.flags & FrameFlag.STORM
    assert result.housekeeping.n_rois_sent == 10
    assert result.housekeeping.n_rois_dropped == 50
    sent = {group.detection.snr for group in result.rois}
    assert {66.0, 65.0, 64.0, 63.0, 62.0} <= sent
    assert result.housekeeping.threshold_sigma == max(d.snr for d in many if d.snr not in sent)
    assert min(sent) < 50.0  # the best of another part of the field


def test_what_stays_is_flagged_static_not_cut() -> None:
    """A detection at the same place in two frames is sent with STATIC; a moving one is not flagged."""
    run = start_run(detections=(STREAK,))
    assert not run.feed(frame(0)).rois[0].detection.flags & StreakFlag.STATIC
    assert run.feed(frame(1)).rois[0].detection.flags & StreakFlag.STATIC


def test_hot_pixels_are_learned() -> None:
    """A pixel that shines in three frames is masked from the fourth on; a cosmic ray in one frame is not."""
    run = start_run(detections=())
    for number in range(5):
        pixels = small_run.sky(number)
        pixels[33, 44] += 500
        pixels[70 + number, 90] += 500
        run.feed(frame(number, pixels=pixels))
    learned = run.state.hot_pixels.learned()
    assert list(learned) == [33 * SIDE + 44]
    assert run.results[-1].housekeeping.n_masked == 1
    assert run.results[2].housekeeping.n_masked == 0


@pytest.mark.parametrize("codec", [PlanesCodec(), RansCodec(), RawCodec()])
def test_whole_frames_are_bit_exact(codec: Any) -> None:
    """Every second frame comes down whole, equal to raw minus rounded dark, saturated stars included."""
    run = start_run(codec=codec, downlink=DownlinkOptions(whole_frame_every=2))
    pixels = small_run.sky(0)
    pixels[100:110, 100:110] = 65535
    run.feed(frame(0, pixels=pixels))
    run.feed(frame(1))
    frames, report = decode_downlink(run.downlink, [PlanesDecoder(), RansDecoder(), RawDecoder()])
    assert report.frames_complete == (0, 1)
    assert frames[1].whole_frame is None
    assert frames[0].whole_frame is not None
    assert (frames[0].whole_frame == pixels.astype(np.int32) - 256).all()


def test_lossy_codec_is_flagged() -> None:
    """Strips coded with loss say so."""
    result = start_run(codec=SqrtPlanesCodec()).feed(frame(0))
    assert result.rois[0].detection.flags & StreakFlag.LOSSY


def test_packets_obey_the_size_limit_and_the_state_pickles() -> None:
    """No packet beyond 4,096 bytes even for large strips; a pickled state goes on with the same bytes."""
    wide = replace(STREAK, row0=0.0, col0=0.0, row1=255.0, col1=255.0, snr=6.5)
    run = start_run(detections=(wide,), codec=RawCodec())
    run.feed(frame(0))
    data, at, sizes = run.downlink, 0, []
    while at < len(data):
        sizes.append(layout.PRIMARY.unpack_from(data, at)[2] + 7)
        at += sizes[-1]
    assert at == len(data)
    assert max(sizes) <= layout.MAX_PACKET_BYTES
    revived = pickle.loads(pickle.dumps(run.state))  # noqa: S301 - our own bytes, in a test of picklability
    direct = run.chain.process(run.state, frame(1))[1].packets
    assert run.chain.process(revived, frame(1))[1].packets == direct


def test_views_are_kept_for_detectors_that_ask() -> None:
    """A detector that declares two frames of history sees the two before, unchanged, oldest first."""

    @dataclass(frozen=True, kw_only=True)
    class Looking:
        seen: list[Any]
        history_frames: int = 2

        def detect(self, view: DetectorView) -> tuple[Detection, ...]:
            self.seen.append([(v.header.frame, float(v.residual_adu.sum())) for v in (*view.history, view)])
            return ()

    seen: list[Any] = []
    run = start_run(steps=steps_with(detector=Looking(seen=seen)))
    for number in range(4):
        run.feed(frame(number))
    assert [[number for number, _ in views] for views in seen] == [[0], [0, 1], [0, 1, 2], [1, 2, 3]]
    assert seen[3][0] == seen[2][1] == seen[1][1]


def test_a_frame_is_let_go_when_it_is_done() -> None:
    """Nothing of it waits for the collector of reference cycles, which lets some hundred frames pass at four a second."""
    steps = steps_with(detector=LineIntegralDetector(), tracker=JointTracker())
    compiling, run = start_run(steps=steps), start_run(steps=steps)
    for number in range(6):
        compiling.feed(frame(number))
    gc.collect()
    gc.disable()
    try:
        for number in range(6):
            run.feed(frame(number))
        assert gc.collect() == 0
    finally:
        gc.enable()
