"""Lines in the negative of a frame are its own rate of false ones: published, and used where nobody calibrated the frame."""

import json
import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ground.vetting.alike import LookAlikes, follows_readout
from ground.vetting.contrast import Contrast
from ground.vetting.look_alikes import LookAlikeVetter, OwnEvidence
from ground.vetting.star_trails import move_as
from onboard.detect.whiten import unusable
from onboard.options import OnboardOptions
from onboard.state import OnboardSteps
from onboard.work import meter
from sboc_e2e import scenario as scenarios
from sboc_e2e.icd.flags import MaskBit, StreakFlag
from sboc_e2e.icd.frame import Frame, FrameHeader, NominalCamera
from sboc_e2e.icd.products import StreakFit
from sboc_e2e.icd.signals import Detection, DetectorView, StarList
from sboc_e2e.icd.work import Work
from sboc_e2e.outside.found import RunFound
from sboc_e2e.outside.limits import work_meter
from sboc_e2e.outside.look_alikes import CountingChain, Dark, look_alikes, seen_of, shape_of
from sboc_e2e.outside.process import base_document
from sboc_e2e.outside.star_lines import stars_as_lines
from sboc_e2e.registry import Registry
from sboc_e2e.run.onboard_stage import onboard_steps
from tests.downlink import frame_of_psf
from tests.end_to_end.raw_camera import CLEAN, dusty, raw_frame, streaks_of, write
from tests.fuzz.outside import run


def counts_of(run_dir: Path) -> list[dict[str, int]]:
    ingest = json.loads((run_dir / "products" / "ingest.json").read_text(encoding="utf-8"))
    return [frame["look_alikes"] for frame in ingest["outside"]["frames"]]


def test_a_frame_with_dust_rings_has_look_alikes_and_its_weak_lines_are_not_published(tmp_path: Path) -> None:
    """Arcs of the rings are lines of S/N 8 to 12, as sharp as stars: five of them in two frames had probabilities of 0.65 to
    0.997. A trail of three times their S/N stays published."""
    pattern = dusty(1)
    write(tmp_path / "in" / "a.fits", raw_frame(1, pattern, sky=1))
    write(tmp_path / "in" / "b.fits", raw_frame(2, pattern, sky=2, trail_e_px=150.0))
    run(tmp_path / "in", tmp_path / "out")
    counts = counts_of(tmp_path / "out")
    assert min(each["all"] for each in counts) >= 4
    assert all(each["snr_50"] == 0 for each in counts)
    table, published = streaks_of(tmp_path / "out")
    length = np.hypot(table["row1"] - table["row0"], table["col1"] - table["col0"])
    (one,) = np.flatnonzero(published)
    assert table["frame"][one] == 1
    assert length[one] == pytest.approx(476.3, abs=6.0)
    assert len(table) >= 4, "the frames hold lines to be judged"
    (row,) = (row for row in RunFound.of(tmp_path / "out").rows() if "look-alikes" in row[0])
    assert row[1] == str(sum(each["all"] for each in counts))
    levels = sorted(int(key.removeprefix("snr_")) for key in counts[0] if key != "all")
    assert {10, 20} <= set(levels)
    told = [part.split(" at S/N >= ") for part in row[2].rpartition("; ")[2].split(", ")]
    assert told == [[str(sum(each[f"snr_{level}"] for each in counts)), str(level)] for level in levels]


def test_clean_frames_have_no_look_alikes_bright_trails_or_not(tmp_path: Path) -> None:
    """Three seeds of stars and noise, one with a trail of S/N 400, whose shadows in the sky level do not count."""
    for k, trail_e_px in enumerate((0.0, 0.0, 2000.0)):
        write(tmp_path / "in" / f"{k}.fits", raw_frame(10 + k, CLEAN, sky=10 + k, trail_e_px=trail_e_px))
    run(tmp_path / "in", tmp_path / "out")
    assert [each["all"] for each in counts_of(tmp_path / "out")] == [0, 0, 0]
    assert streaks_of(tmp_path / "out")[1].sum() == 1


@dataclass(frozen=True, kw_only=True)
class Scripted:
    """A detector that returns given lines and counts its searches."""

    detections: tuple[Detection, ...] = ()
    seen: list[float] = field(default_factory=list)
    history_frames: int = 0

    def detect(self, view: DetectorView) -> tuple[Detection, ...]:
        self.seen.append(float(view.residual_adu[40, 40]))
        return self.detections


def prepared(detector: Any) -> tuple[CountingChain, Any, Any]:
    scenario = scenarios.bare("process", base_document("none"), registry=Registry())
    steps: OnboardSteps = replace(onboard_steps(scenario), detector=detector)
    camera = NominalCamera(
        name="test", rows=96, cols=96, focal_px=1e4, center_row=47.5, center_col=47.5, psf_sigma_px=1.4, gain_e_adu=1.0,
        read_noise_e=1.0, saturation_adu=65535.0, full_well_e=65535.0, zero_point_e_s=None, aperture_m=0.1,
    )  # fmt: skip
    chain = CountingChain(OnboardOptions(), steps, camera=camera, run_id=1)
    pixels = np.random.default_rng(5).normal(500.0, 5.0, (96, 96)).astype(np.uint16)
    header = FrameHeader(frame=0, t_start_tai_ns=0, exposure_ns=10**9, line_time_ns=0, rows=96, cols=96)
    state = chain.initial_state()
    return chain, state, chain.prepare(state, Frame(header=header, pixels=pixels))


def test_a_frame_costs_one_search_more_of_its_negative() -> None:
    detector = Scripted(detections=(Detection(row0=5.0, col0=5.0, row1=60.0, col1=40.0, snr=9.0),))
    chain, state, made = prepared(detector)
    chain.judge(state, made)
    assert len(detector.seen) == 2
    assert detector.seen[0] == -detector.seen[1] != 0.0
    assert chain.evidence[0].look_alikes.table[:, :2].tolist() == [[9.0, pytest.approx(np.hypot(55.0, 35.0))]]


def test_fringes_are_counted_though_they_lie_beside_each_other() -> None:
    """Ripples 24 px apart raise the threshold of the lines beside them, and stars lift bright lines over it again. Of the dark
    ones none was counted, and seven of fourteen bright lines were published at p of 0.74 to 0.96."""
    rng = np.random.default_rng(12)
    row, col = np.mgrid[:512, :512].astype(np.float64)
    bend = 40.0 * np.sin(row / 90.0)
    image = rng.normal(1000.0, 20.0, row.shape) + 16.0 * np.sin((col + bend) / 4.0)
    frame = Frame(
        header=FrameHeader(frame=0, t_start_tai_ns=0, exposure_ns=10**9, line_time_ns=0, rows=512, cols=512),
        pixels=image.astype(np.uint16),
    )
    scenario = scenarios.bare("process", base_document("none"), registry=Registry())
    camera = NominalCamera(
        name="test", rows=512, cols=512, focal_px=1e4, center_row=255.5, center_col=255.5, psf_sigma_px=1.6, gain_e_adu=1.0,
        read_noise_e=1.0, saturation_adu=65535.0, full_well_e=65535.0, zero_point_e_s=None, aperture_m=0.1,
    )  # fmt: skip
    chain = CountingChain(scenario.onboard, onboard_steps(scenario), camera=camera, run_id=1)
    state = chain.initial_state()
    chain.judge(state, chain.prepare(state, frame))
    known = chain.evidence[0].look_alikes
    assert len(known.table) >= 10
    assert known.weight is not None
    assert 2.0 < known.weight.sum() < len(known.table)


def test_dark_lines_beside_a_line_twice_as_bright_are_its_shadow() -> None:
    dark = Detection(row0=20.0, col0=5.0, row1=70.0, col1=5.0, snr=9.0)
    detector = Scripted(detections=(dark,))
    _, _, made = prepared(detector)
    beside = Detection(row0=5.0, col0=30.0, row1=90.0, col1=30.0, snr=18.0)
    assert len(look_alikes(Dark.of(detector, made.view), made.view, (beside,)).table) == 0
    assert len(look_alikes(Dark.of(detector, made.view), made.view, (replace(beside, snr=17.0),)).table) == 1
    apart = replace(beside, row0=95.0, row1=95.0, col0=70.0, col1=95.0)
    assert len(look_alikes(Dark.of(detector, made.view), made.view, (apart,)).table) == 1


def test_dark_lines_that_a_neighbouring_frame_has_too_do_not_count() -> None:
    """Remains of stars and of the flat in frames given together: dark in both, among the stars (shifted by 3, 5 px) or on the
    sensor. What is dark in one of them alone counts."""
    dark = Detection(row0=20.0, col0=12.0, row1=70.0, col1=60.0, snr=12.0)
    detector = Scripted(detections=(dark,))
    _, _, made = prepared(detector)
    stars = np.random.default_rng(8).uniform(12.0, 84.0, (2, 30))
    flux = np.linspace(9000.0, 3000.0, 30, dtype=np.float32)
    plain = StarList(row=stars[0], col=stars[1], flux_e=flux, snr=flux / 20.0, flags=np.zeros(30, np.uint8))
    moved = replace(plain, row=stars[0] + 3.0, col=stars[1] + 5.0)
    sigma = float(np.median(made.view.background.sigma_adu))

    def before(shift: tuple[float, float], share: float) -> DetectorView:
        """The neighbouring frame with a dark line of this share of S/N 12 at a shift."""
        grid = np.mgrid[:96, :96] - np.array([20.0 + shift[0], 12.0 + shift[1]])[:, None, None]
        unit = np.array([50.0, 48.0]) / np.hypot(50.0, 48.0)
        along, across = np.tensordot(unit, grid, 1), grid[0] * unit[1] - grid[1] * unit[0]
        s_px = made.view.psf_sigma_px
        height = share * 12.0 / np.sqrt(dark.length_px * np.sqrt(np.pi) * s_px)
        line = -sigma * height * np.exp(-0.5 * (across / s_px) ** 2) * ((along > 0.0) & (along < dark.length_px))
        return replace(made.view, residual_adu=line.astype(np.float32), stars=moved)

    for shift, share, left in (((3.0, 5.0), 1.0, 0), ((0.0, 0.0), 1.0, 0), ((3.0, 5.0), 0.2, 1), ((20.0, -9.0), 1.0, 1)):
        view = replace(made.view, stars=plain, history=(before(shift, share),))
        assert len(look_alikes(Dark.of(detector, view), view, ()).table) == left, (shift, share)
    assert len(look_alikes(Dark.of(detector, made.view), replace(made.view, stars=plain), ()).table) == 1


@dataclass(frozen=True, kw_only=True)
class Certain:
    """A vetter that is sure of everything."""

    def probability(self, fits: Any, frame: Any) -> Any:
        return np.full(len(fits), 0.99)


def fit_of(
    snr: float, length_px: float, width_px: float = 1.2, light: tuple[float, ...] = (), at: tuple[float, float] = (40.0, 40.0)
) -> StreakFit:
    row, col = at
    ends = {"row0": row, "col0": col, "row1": row + 10.0, "col1": col + 10.0, "light_curve_e_px": np.array(light, np.float32)} | {
        "flags": StreakFlag(0),
        "sagitta_px": 0.0,
    }
    made: Any = type("Fit", (), {"snr": snr, "length_px": length_px, "width_px": width_px} | ends)()
    return made


def seen_width(width_px: float) -> float:
    """Width of a line's profile with that of a pixel, whose variance is 1/12 px^2."""
    return float(np.sqrt(width_px**2 + 1.0 / 12.0))


def test_look_alikes_speak_against_their_own_kind_alone() -> None:
    """59 of S/N 20 and 30 px: against a line like them and against fainter ones, not against 1,274 px of S/N 700 nor in another
    frame. Values by hand: 1 / (1 + 0.0101 + 59 / (2 pi 0.49) / 0.0181)."""
    known = np.tile([20.0, 30.0, seen_width(1.2), 1.0, 0.0], (59, 1))
    vetter = LookAlikeVetter(vetter=Certain(), evidence={0: OwnEvidence(look_alikes=LookAlikes(table=known))})
    frame = frame_of_psf(1.4)
    assert frame.header.frame == 0
    fits = [fit_of(20.0, 30.0), fit_of(8.0, 30.0), fit_of(700.0, 1274.0), fit_of(20.0, 1274.0)]
    probability = vetter.probability(fits, frame)
    assert probability[:2] == pytest.approx(1.0 / (1.0 + 59.0 / (2.0 * np.pi * 0.49) / 0.01805), rel=0.01)
    assert probability[2] == pytest.approx(0.99, abs=1e-6)
    assert probability[3] > 0.98, "as bright as they, and forty times as long"
    elsewhere = LookAlikeVetter(vetter=Certain(), evidence={1: OwnEvidence(look_alikes=LookAlikes(table=known))})
    assert elsewhere.probability(fits, frame) == pytest.approx(0.99)
    assert LookAlikes().near(fits).tolist() == [0.0] * 4


def test_dark_lines_that_stand_out_less_than_a_trail_hardly_speak_against_it() -> None:
    """Values by hand: exp(-1/2) for a sigma less of wins, the same for one of peak; in full for lines that stand out as much, and
    where either is not known, or where the line itself does not win all along."""
    known = np.tile([20.0, 30.0, seen_width(1.2), 1.0, 0.0], (1, 1))
    fit = fit_of(20.0, 30.0)
    (full,) = LookAlikes(table=known).near([fit])
    cases = ((0.7, 0.85, math.exp(-0.5)), (0.4, 0.7, math.exp(-2.5)), (1.0, 0.95, 1.0), (math.nan, math.nan, 1.0))
    for wins, peak, share in cases:
        told = [Contrast(pieces=6, wins=1.0, peak=0.85)]
        seen = LookAlikes(table=known, stand_out=np.array([[wins, peak]]))
        assert seen.near([fit], told) == pytest.approx([full * share])
        for other in (None, Contrast(pieces=20, wins=0.9, peak=0.85)):
            assert seen.near([fit], [other]) == pytest.approx([full])


def test_look_alikes_tell_most_of_what_lies_near_them() -> None:
    """Beside a fit one counts 0.2 + 0.8 / (2 pi 0.15^2), far away 0.2. Spread evenly, they count as those of no known place."""
    row = [20.0, 30.0, seen_width(1.2), 1.0, 0.0]
    at = [fit_of(20.0, 30.0, at=place) for place in ((495.0, 995.0), (1.0, 1900.0), (5.0, 20.0))]
    (full,) = LookAlikes(table=np.array([row])).near(at[:1])
    there = LookAlikes(table=np.array([row]), place=np.array([[500.0, 1000.0]]), shape=(1000, 2000))
    near, border, corner = there.near(at)
    assert near == pytest.approx(full * (0.2 + 0.8 / (2.0 * math.pi * 0.15**2)), rel=0.02)
    assert [border, corner] == pytest.approx([0.2 * full] * 2, rel=0.01)
    grid = np.stack(np.meshgrid(np.arange(5.0, 1000.0, 10.0), np.arange(5.0, 2000.0, 10.0)), axis=-1).reshape(-1, 2)
    evenly = LookAlikes(table=np.tile(row, (len(grid), 1)), place=grid, shape=(1000, 2000))
    assert evenly.near(at) == pytest.approx([len(grid) * full] * 3, rel=0.02)


def test_a_dark_line_stands_out_of_the_negative_as_a_bright_one_of_the_frame() -> None:
    """A dark trench that is alone wins all along it. A row of dark pits, with as many to its sides, does not."""
    _, _, made = prepared(Scripted())
    noise = np.random.default_rng(3).normal(0.0, 1.0, made.view.mask.shape)
    row, col = np.mgrid[:96, :96]
    line = Detection(row0=30.0, col0=10.0, row1=60.0, col1=86.0, snr=40.0)
    across = ((row - line.row0) * 76.0 - (col - line.col0) * 30.0) / math.hypot(76.0, 30.0)
    trench = -60.0 * np.exp(-0.5 * (across / 1.2) ** 2)
    pits = -60.0 * (np.random.default_rng(4).random(noise.shape) < 0.04)
    found = []
    for dark in (trench, pits):
        view = replace(made.view, residual_adu=(noise + dark).astype(np.float32))
        negative = replace(view, residual_adu=-view.residual_adu)
        told = look_alikes(Dark(view=negative, lines=(line,)), view, ()).stand_out
        assert told is not None
        found.append(told[0])
    assert found[0] == pytest.approx([1.0, 0.9], abs=0.15)
    assert found[1][0] < 0.5
    assert found[1][1] < 0.5
    nothing = look_alikes(Dark(view=made.view, lines=()), made.view, ()).stand_out
    assert nothing is not None
    assert nothing.shape == (0, 2)


def test_what_may_be_a_star_is_refused_in_frames_that_stand_alone() -> None:
    """Stars of S/N 170 to 5,000 that were fitted as trails of 2 to 4 px had probabilities of 0.6 to 0.97 in raw frames."""
    fits = [fit_of(5000.0, 1.7), fit_of(170.0, 24.0), fit_of(20.0, 26.0)]
    frame = frame_of_psf(1.4)
    alone = LookAlikeVetter(vetter=Certain(), evidence={0: OwnEvidence(alone=True)})
    assert alone.probability(fits, frame) == pytest.approx([0.0, 0.0, 0.99])
    beside = LookAlikeVetter(vetter=Certain(), evidence={0: OwnEvidence()})
    assert beside.probability(fits, frame) == pytest.approx([0.332, 0.99, 0.99], abs=1e-3), "left to the linker, not published"


def test_the_chain_says_which_frames_stand_alone() -> None:
    chain, state, made = prepared(Scripted())
    chain.judge(state, made)
    assert not chain.evidence[0].alone, "a detector that looks at one frame at a time needs no other"
    chain, state, made = prepared(Scripted(history_frames=1))
    chain.judge(state, made)
    assert chain.evidence[0].alone


def test_slopes_ten_times_as_wide_say_nothing_of_a_trail() -> None:
    """Dark slopes of a vignetted border, 600 to 1,300 px long at S/N 440 to 640, vetoed a satellite of S/N 794 (p 0.02)."""
    slopes = np.array([[640.0, 750.0, 12.0, 1.0, 0.0], [440.0, 1300.0, 12.0, 1.0, 0.0]])
    vetter = LookAlikeVetter(vetter=Certain(), evidence={0: OwnEvidence(look_alikes=LookAlikes(table=slopes))})
    frame = frame_of_psf(1.4)
    trail, slope = vetter.probability([fit_of(794.0, 1365.0), fit_of(400.0, 1365.0, 12.0)], frame)
    assert trail == pytest.approx(0.99, abs=1e-3)
    assert slope < 0.05


def test_a_dark_column_says_nothing_of_a_trail_that_crosses_it() -> None:
    """A dark column beside the overscan, 922 px of S/N 41, vetoed a satellite of S/N 181 (p 0.41)."""
    column = np.array([[41.0, 922.0, 0.4, 1.0, 1.0]])
    vetter = LookAlikeVetter(vetter=Certain(), evidence={0: OwnEvidence(look_alikes=LookAlikes(table=column))})
    across, along = fit_of(30.0, 1366.0, 0.6), fit_of(30.0, 1366.0, 0.6)
    across.row0, across.col0, across.row1, across.col1 = 13.0, 108.0, 1369.0, 270.0
    along.row0, along.col0, along.row1, along.col1 = 3.0, 1381.0, 1369.0, 1381.0
    probability = vetter.probability([across, along], frame_of_psf(0.9))
    assert probability[0] == pytest.approx(0.99)
    assert probability[1] < 0.5


def test_a_dark_line_of_any_direction_speaks_against_lines_along_the_readout_too() -> None:
    """False lines of all directions run along rows or columns as often as any other way."""
    known = np.tile([30.0, 300.0, seen_width(1.2), 1.0, 0.0], (5, 1))
    vetter = LookAlikeVetter(vetter=Certain(), evidence={0: OwnEvidence(look_alikes=LookAlikes(table=known))})
    oblique, along = fit_of(30.0, 300.0, 1.2), fit_of(30.0, 300.0, 1.2)
    oblique.row0, oblique.col0, oblique.row1, oblique.col1 = 10.0, 10.0, 190.0, 250.0
    along.row0, along.col0, along.row1, along.col1 = 50.0, 10.0, 50.0, 310.0
    probability = vetter.probability([oblique, along], frame_of_psf(0.9))
    assert probability[0] == pytest.approx(probability[1])
    assert probability[1] < 0.1


def test_lines_within_two_degrees_of_rows_or_columns_are_aligned() -> None:
    angles = np.radians([0.0, 1.9, 2.1, 45.0, 87.9, 88.1, 180.0])
    aligned = [follows_readout(100.0 * math.sin(a), 100.0 * math.cos(a)) for a in angles.tolist()]
    assert aligned == [True, True, False, False, False, True, True]


def test_a_clump_of_dark_light_says_nothing_of_an_even_trail() -> None:
    """What was left of one star made a dark line of S/N 413, 652 px long, whose median light was that of the sky, and vetoed a
    satellite of S/N 786 (p 0.94 before, 0.27 after). It still speaks against lines that are clumps themselves."""
    clump = np.array([[413.0, 652.0, 0.4, 0.0, 0.0], [632.0, 748.0, 3.8, 0.2, 0.0]])
    vetter = LookAlikeVetter(vetter=Certain(), evidence={0: OwnEvidence(look_alikes=LookAlikes(table=clump))})
    even = replace_even(clump, 1.0)
    strict = LookAlikeVetter(vetter=Certain(), evidence={0: OwnEvidence(look_alikes=LookAlikes(table=even))})
    trail = fit_of(786.0, 1399.0, 0.8, (4.0, 4.0, 3.0, 3.0, 2.0))
    assert vetter.probability([trail], frame_of_psf(0.9))[0] > 0.98
    assert strict.probability([trail], frame_of_psf(0.9))[0] < 0.5
    lump = fit_of(400.0, 652.0, 0.8, (40.0, 0.0, 0.0, 0.0, 0.0))
    assert vetter.probability([lump], frame_of_psf(0.9))[0] < 0.5


def replace_even(table: Any, even: float) -> Any:
    return np.column_stack((table[:, :3], np.full(len(table), even), table[:, 4]))


def test_light_in_one_place_of_a_line_is_not_even() -> None:
    """A source of 30 px on a line of 300 px."""
    image = np.random.default_rng(3).normal(0.0, 1.0, (40, 400))
    image[20, 200:230] += 100.0
    line = Detection(row0=20.0, col0=50.0, row1=20.0, col1=350.0, snr=90.0)
    assert shape_of(line, image.astype(np.float32), np.zeros(image.shape, np.uint8))[1] < 0.05


@pytest.mark.parametrize("sigma_px", [1.0, 2.0, 5.0])
def test_the_width_of_a_line_is_that_of_its_profile(sigma_px: float) -> None:
    """A Gaussian ridge at 30 deg, noise of a twentieth of its height: to a fifth, or half a pixel where that is more."""
    row, col = np.mgrid[:200, :200].astype(float)
    across = (row - 100.0) * np.cos(np.pi / 6.0) - (col - 100.0) * np.sin(np.pi / 6.0)
    image = np.exp(-0.5 * (across / sigma_px) ** 2) + np.random.default_rng(3).normal(0.0, 0.05, row.shape)
    half = 60.0 * np.array([np.sin(np.pi / 6.0), np.cos(np.pi / 6.0)])
    line = Detection(row0=100.0 - half[0], col0=100.0 - half[1], row1=100.0 + half[0], col1=100.0 + half[1], snr=9.0)
    found, even = shape_of(line, image.astype(np.float32), np.zeros(row.shape, np.uint8))
    assert even > 0.9
    assert found == pytest.approx(seen_width(sigma_px), abs=max(0.5, 0.2 * sigma_px))


def test_limits_of_orbit_do_not_bind_frames_from_outside() -> None:
    """In raw frames of a 1.1 m telescope slopes and ghosts took all the work, and a trail across the frame was not found."""
    detector = Scripted()
    chain, _, made = prepared(detector)
    on_board = meter(96 * 96)
    assert all(made.view.work.limits[kind] > most for kind, most in on_board.limits.items())
    assert chain.evidence == {}
    scenario = scenarios.bare("process", base_document("none"), registry=Registry())
    orbit = scenarios.bare("orbit", {}, registry=Registry())
    for step, most in ((scenario, 1000), (orbit, 200)):
        assert step.step("onboard.detector").max_detections == most
    assert scenario.onboard.roi.max_per_frame == 1000 > orbit.onboard.roi.max_per_frame
    assert scenario.onboard.roi.max_cosmic_like == 100 > orbit.onboard.roi.max_cosmic_like


def test_small_pictures_have_the_work_of_four_megapixels_for_candidates_and_trails() -> None:
    """A meteor of 79 px in a picture of 736 px was left undone: trees below it had 11,000 candidates."""
    small, square, large = (work_meter(n).limits for n in (736**2, 2048**2, 4096**2))
    for kind in Work:
        if kind in (Work.CANDIDATES, Work.TRAILS):
            assert small[kind] == square[kind] < large[kind]
        else:
            assert small[kind] < square[kind] < large[kind]


def test_a_fit_where_no_pixel_saw_the_sky_is_refused() -> None:
    """The step beside an overscan of 51 columns was fitted in its first column, 230 px long at S/N 550 and p 0.69."""
    frame = frame_of_psf(1.4)
    for last_col, kept in ((95, True), (45, True), (44, False)):
        own = OwnEvidence(seen=(0, 95, 0, last_col))
        (seen,) = LookAlikeVetter(vetter=Certain(), evidence={0: own}).probability([fit_of(50.0, 15.0)], frame)
        assert (seen > 0.6) == kept == (seen > 0.0)
    mask = np.zeros((20, 30), np.uint8)
    mask[:3] = mask[:, 25:] = 1
    assert seen_of(mask) == (3, 19, 0, 24)


def star_lines(turn_rad: float, n: int, seed: int) -> list[Detection]:
    """Trails of stars over a frame of 1000 px: a shift of 120 px and a turn about the middle, ends to 1 px."""
    rng = np.random.default_rng(seed)
    lines = []
    for row, col in rng.uniform(100.0, 900.0, (n, 2)):
        d_row, d_col = 40.0 - turn_rad * (col - 499.5), 113.0 + turn_rad * (row - 499.5)
        ends = np.array([row - d_row / 2, col - d_col / 2, row + d_row / 2, col + d_col / 2]) + rng.normal(0.0, 0.5, 4)
        line = dict(zip(("row0", "col0", "row1", "col1"), map(float, ends), strict=True))
        lines.append(Detection(snr=float(rng.uniform(10.0, 300.0)), **line))
    return lines


@pytest.mark.parametrize("turn_rad", [0.0, 0.06])
def test_equal_trails_all_over_a_frame_are_its_stars(turn_rad: float) -> None:
    """Trails beyond 100 px are not in the star list. A satellite among them runs another way."""
    satellite = Detection(row0=200.0, col0=300.0, row1=330.0, col1=310.0, snr=40.0)
    motion = stars_as_lines([*star_lines(turn_rad, 14, 3), satellite], shape=(1000, 1000))
    assert motion is not None
    _, d_col = motion.at(np.array([250.0, 750.0]), np.array([499.5, 499.5]))
    assert (d_col[1] - d_col[0]) / 500.0 == pytest.approx(turn_rad, abs=0.006)
    own = OwnEvidence(stars=motion)
    vetter = LookAlikeVetter(vetter=Certain(), evidence={0: own})
    fits = [line_fit(each) for each in (*star_lines(turn_rad, 5, 9), satellite)]
    assert vetter.probability(fits, frame_of_psf(1.4)).tolist() == pytest.approx([0.0] * 5 + [0.99], abs=0.01)


def line_fit(line: Detection) -> StreakFit:
    """A fit of a detection."""
    ends = {name: getattr(line, name) for name in ("row0", "col0", "row1", "col1")}
    light = {"snr": 50.0, "width_px": 1.2, "light_curve_e_px": np.zeros(0, np.float32), "flags": line.flags}
    light["sagitta_px"] = line.sagitta_px
    made: Any = type("Fit", (), ends | light | {"length_px": line.length_px})()
    return made


def test_a_star_that_the_border_cuts_runs_the_same_way() -> None:
    motion = stars_as_lines(star_lines(0.0, 12, 4), shape=(1000, 1000))
    own = OwnEvidence(stars=motion)
    vetter = LookAlikeVetter(vetter=Certain(), evidence={0: own})
    short = Detection(row0=500.0, col0=0.0, row1=520.0, col1=56.5, snr=40.0, flags=StreakFlag.EDGE0)
    assert motion is not None
    fits = [line_fit(short), line_fit(replace(short, flags=StreakFlag(0)))]
    assert move_as(motion, fits).tolist() == [True, False]
    assert vetter.probability(fits[:1], frame_of_psf(1.4)).tolist() == [0.0]


def test_a_train_of_satellites_and_a_few_lines_are_no_stars() -> None:
    """Ten equal trails in a row; and seven stars, too few to tell."""
    train = [Detection(row0=r, col0=2.0 * r, row1=r + 50.0, col1=2.0 * r + 100.0, snr=30.0) for r in np.arange(40.0, 440.0, 40.0)]
    assert stars_as_lines(train, shape=(1000, 1000)) is None
    assert stars_as_lines(star_lines(0.0, 7, 5), shape=(1000, 1000)) is None


def test_full_pixels_are_light_and_others_that_are_masked_say_nothing() -> None:
    """A satellite that fills its pixels had no light left in its middle, and was taken for a slope."""
    mask = np.array([[0, MaskBit.SATURATED, MaskBit.DEAD, MaskBit.SATURATED | MaskBit.HOT]], dtype=np.uint8)
    assert unusable(mask).tolist() == [[False, False, True, True]]
