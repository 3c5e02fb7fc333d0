"""Work on board: limits that add up to twice the nominal work, what is left when they are reached, and where it is told."""

from dataclasses import replace

import numpy as np
import pytest

from ground.ingest import decode_downlink
from ground.ingest.codecs import PlanesDecoder
from onboard import work
from onboard.detect import LineIntegralDetector
from onboard.detect.line_integral.segments import within_work as trails_within_work
from onboard.options import OnboardOptions
from onboard.parameter_set import parameter_set_id
from onboard.stars.matched import group_pixels
from onboard.stars.matched import within_work as stars_within_work
from sboc_e2e.icd.flags import FrameFlag
from sboc_e2e.icd.work import Work, WorkMeter
from tests.benchmarks import fuzz_work, sky_frames
from tests.benchmarks.other_skies import chain, frame, second_of


@pytest.mark.parametrize("n_pixels", [64, 192**2, 4096**2])
def test_passes_and_limits_are_twice_the_nominal_work(n_pixels: int) -> None:
    meter = work.meter(n_pixels)
    assert meter.regular + sum(meter.limits.values()) == 2 * work.nominal(n_pixels)


@pytest.mark.parametrize("seed", range(2 * len(fuzz_work.KINDS)))
def test_no_frame_takes_more_than_twice_the_nominal_work(seed: int) -> None:
    """Each kind of the fuzz driver twice, in small frames; `python -m tests.benchmarks.fuzz_work` draws thousands."""
    row = fuzz_work.counted(seed, 128)
    assert row["of_nominal"] <= 2.0
    assert row["flagged"] == bool(row["shed"])


def test_a_storm_is_cut_short_and_says_so() -> None:
    """Tracks as dense as 20,000 on 2048 x 2048: counts come down in the header packet and are the same each time."""
    rng = np.random.default_rng(3)
    earlier, later = (sky_frames.storm(512, rng) for _ in range(2))
    results = [second_of(earlier, later)[0] for _ in range(2)]
    assert results[0].packets == results[1].packets
    told = results[0].housekeeping
    assert told.flags & FrameFlag.WORK_SHED
    assert told.shed_candidates > 0
    assert told.operations <= 2 * work.nominal(512**2)
    (decoded,), _ = decode_downlink(results[0].packets, [PlanesDecoder()])
    assert decoded.housekeeping is not None
    assert decoded.housekeeping.flags & FrameFlag.WORK_SHED
    for name in ("parameter_set", "operations", "shed_stars", "shed_halos", "shed_candidates", "shed_points", "shed_trails"):
        assert getattr(decoded.housekeeping, name) == getattr(told, name), name


def test_quiet_frames_leave_nothing() -> None:
    drawn = sky_frames.scene(sky_frames.ROWS[0], 512, [(100.0, 10.0)], 1)
    result, _ = second_of(drawn.earlier, drawn.later)
    assert not result.work.has_shed
    assert not result.housekeeping.flags & FrameFlag.WORK_SHED
    assert result.housekeeping.operations == pytest.approx(result.work.operations, abs=1000)


def test_long_trails_do_not_make_room_for_many_short_ones() -> None:
    """A hundred bright trails of 12 px and one faint one of 900 px, with room for five."""
    table = np.zeros((101, 7))
    table[:, 3], table[:, 6] = 12.0, np.linspace(50.0, 100.0, 101)
    table[37, 3], table[37, 6] = 900.0, 7.5
    meter = WorkMeter()
    meter.limits[Work.TRAILS] = 2_800_000
    kept = trails_within_work(table, meter)
    assert 1 < len(kept) < 10
    assert (kept[:, 3] == 900.0).any()
    assert meter.shed[Work.TRAILS] == 101 - len(kept)
    assert meter.done[Work.TRAILS] <= meter.limits[Work.TRAILS]


def test_every_part_of_the_field_keeps_stars() -> None:
    """Four thousand peaks in one corner and forty elsewhere, fainter: those forty are fitted."""
    rng = np.random.default_rng(0)
    crowd, others = np.zeros((4000, 5), np.float32), np.zeros((40, 5), np.float32)
    crowd[:, :2], crowd[:, 2] = rng.uniform(0.0, 60.0, (4000, 2)), rng.uniform(100.0, 900.0, 4000)
    others[:, :2], others[:, 2] = rng.uniform(100.0, 512.0, (40, 2)), rng.uniform(10.0, 20.0, 40)
    meter = WorkMeter()
    meter.limits[Work.STARS] = 2_000_000
    peaks, n_fitted = stars_within_work(np.concatenate((crowd, others)), (512, 512), meter)
    assert n_fitted < len(peaks) < 4040
    assert np.count_nonzero(peaks[:n_fitted, 2] < 50.0) == 40
    assert meter.shed[Work.STARS] == 4040 - n_fitted
    assert meter.done[Work.STARS] <= meter.limits[Work.STARS]


def test_all_peaks_are_fitted_as_they_come_while_work_lasts() -> None:
    peaks = np.random.default_rng(0).random((50, 5)).astype(np.float32)
    same, n_fitted = stars_within_work(peaks, (10, 10), WorkMeter())
    assert same is peaks
    assert n_fitted == 50


def test_saturated_areas_are_grouped_by_their_neighbours() -> None:
    """Against all pairs of pixels within two rows and two cols, joined until nothing changes."""
    for seed, share in ((0, 0.02), (1, 0.1), (2, 0.5), (3, 1.0)):
        pixels = np.argwhere(np.random.default_rng(seed).random((24, 30)) < share).astype(np.int32)
        near = np.abs(pixels[:, None] - pixels[None]).max(axis=-1) <= 2
        label = np.arange(len(pixels))
        while True:
            lowest = np.where(near, label[None], len(pixels)).min(axis=1)
            if (lowest == label).all():
                break
            label = lowest
        assert (group_pixels(pixels) == label).all()


def test_a_set_of_parameters_has_a_number() -> None:
    """The same for equal options, another one for any that differs, and in every header packet."""
    options = OnboardOptions()
    first = parameter_set_id(options, LineIntegralDetector())
    assert first == parameter_set_id(OnboardOptions(), LineIntegralDetector())
    assert first != parameter_set_id(options, LineIntegralDetector(n_sigma=7.3))
    assert first != parameter_set_id(replace(options, roi=replace(options.roi, end_margin=2.0)), LineIntegralDetector())
    run = chain(64)
    pixels = np.random.default_rng(0).normal(300.0, 5.0, (64, 64)).astype(np.uint16)
    _, result = run.process(run.initial_state(), frame(0, pixels))
    assert result.housekeeping.parameter_set > 0
