"""Members of tracks too faint for their own frames: flux and place across against the truth and its Cramér-Rao bound."""

from dataclasses import replace

import numpy as np
import pytest

from ground.streaks.fit_record import failed_fit
from ground.streaks.fitter import TrailedPsfFitter
from ground.streaks.forced import forced_fit, has_given_ends, track_error_px
from ground.streaks.no_trail import NoTrailError
from ground.streaks.trail_frame import cut_ends
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.signals import Detection
from tests.streaks.trail_rendering import expose, render, trail_at

TRACK_SNR = 9.0


@pytest.mark.slow
def test_a_trail_of_four_sigma_keeps_its_length_and_its_errors_are_as_quoted() -> None:
    """Ends off by the law of the track's S/N; flux and offset within their errors, unbiased; a frame alone loses the ends."""
    rng, flux, across, ratio, lengths, alone = np.random.default_rng(1), [], [], [], [], []
    for _ in range(150):
        length = float(rng.choice([40.0, 150.0]))
        exposure = expose(rng, trail_at(rng, length), 4.0)
        truth = exposure.trail
        off = rng.normal(0.0, 5.1 * length / TRACK_SNR**2 / 2.0, 2)
        guess = truth.moved(off[0], off[1], *rng.normal(0.0, 0.2, 2), 0.0)
        detection = Detection(row0=guess.row0, col0=guess.col0, row1=guess.row1, col1=guess.col1, snr=4.0)
        try:
            fit = forced_fit(exposure.pixels, detection, TRACK_SNR)
        except NoTrailError:
            continue
        lengths.append(fit.length_px / length)
        cos, sin = truth.axes
        middle = np.array([fit.row0 + fit.row1 - truth.row0 - truth.row1, fit.col0 + fit.col1 - truth.col0 - truth.col1]) / 2.0
        across.append((middle[0] * cos - middle[1] * sin) / fit.sigma_cross_px)
        flux.append((fit.flux_e - truth.flux_e) / fit.flux_err_e)
        ratio.append(fit.sigma_cross_px / exposure.bounds()["cross_px"])
        single = TrailedPsfFitter().fit(exposure.pixels, replace(exposure.detection, snr=4.0))
        alone.append(single.length_px / length)
    assert len(flux) >= 145
    assert np.abs(np.array(lengths) - 1.0).max() < 0.35
    assert np.mean(np.abs(np.array(alone) - 1.0) > 0.35) > 0.2
    assert np.std(flux) == pytest.approx(1.0, abs=0.2)
    assert np.sqrt(np.median(np.square(across)) / 0.4549) == pytest.approx(1.0, abs=0.2)
    assert 0.9 < float(np.median(ratio)) < 1.25


@pytest.mark.parametrize("snr", [0.7, 1.5])
def test_the_light_of_foretold_points_is_unbiased_where_noise_makes_some_negative(snr: float) -> None:
    """Points of 32 frames, off by what their track may be off: a mean without the negative fluxes would be too bright."""
    rng, flux, pulls, negative = np.random.default_rng(4), [], [], 0
    track_snr = snr * np.sqrt(32.0)
    for _ in range(400):
        exposure = expose(rng, trail_at(rng, 1.8), snr)
        truth = exposure.trail
        off = rng.normal(0.0, track_error_px(0.9, truth.length_px, track_snr), 2)
        detection = Detection(
            row0=truth.row0 + off[0], col0=truth.col0 + off[1], row1=truth.row1 + off[0], col1=truth.col1 + off[1], snr=snr,
            flags=StreakFlag.POINT_LIKE,
        )  # fmt: skip
        fit = forced_fit(exposure.pixels, detection, track_snr)
        assert fit.track_frames == 32.0
        negative += fit.flux_e <= 0.0
        flux.append(fit.flux_e / truth.flux_e)
        pulls.append((fit.flux_e - truth.flux_e) / fit.flux_err_e)
    assert negative > 5
    assert np.mean(flux) == pytest.approx(1.0, abs=3.3 * np.std(flux) / 20.0)
    assert np.std(pulls) == pytest.approx(1.0, abs=0.1)


def test_where_there_is_no_light_the_fit_says_so() -> None:
    rng = np.random.default_rng(2)
    exposure = expose(rng, trail_at(rng, 60.0), 4.0)
    dark = replace(exposure.pixels, value_e=np.full(len(exposure.pixels.row), -5.0))
    with pytest.raises(NoTrailError):
        forced_fit(dark, exposure.detection, TRACK_SNR)


def test_ends_at_the_edge_stay_there() -> None:
    rng = np.random.default_rng(3)
    exposure = expose(rng, trail_at(rng, 80.0, angle_rad=0.0), 5.0)
    truth = exposure.trail
    pixels = replace(exposure.pixels, frame_shape=(4096, round(truth.col1) + 2))
    detection = Detection(row0=truth.row0, col0=truth.col0, row1=truth.row1, col1=truth.col1, snr=5.0, flags=StreakFlag.EDGE1)
    fit = forced_fit(pixels, detection, TRACK_SNR)
    assert fit.flags & (StreakFlag.EDGE0 | StreakFlag.EDGE1) == StreakFlag.EDGE1
    assert fit.end_interval_px[1] == pytest.approx(0.0)
    assert (np.abs(fit.end_interval_px[0]) > 1.0).all()


def test_a_trail_along_the_edge_has_ends_within_the_image() -> None:
    """Its ends are as near to the edge as its middle, and flagged; on the edge they would be without error."""
    rng = np.random.default_rng(3)
    exposure = expose(rng, trail_at(rng, 20.0, angle_rad=0.02), 5.0)
    pixels = replace(exposure.pixels, frame_shape=(2002, 4096))
    detection = replace(exposure.detection, flags=StreakFlag.EDGE0 | StreakFlag.EDGE1)
    assert cut_ends(detection, pixels.frame_shape) == (False, False)
    fit = forced_fit(pixels, detection, TRACK_SNR)
    assert not fit.flags & (StreakFlag.EDGE0 | StreakFlag.EDGE1)
    assert (np.abs(fit.end_interval_px) > 0.4).all()


def test_a_star_on_two_fifths_of_a_short_trail_leaves_its_light_out() -> None:
    """A star a hundred times as bright a pixel; without the mask the flux would be ten times that of the trail."""
    rng, pulls = np.random.default_rng(5), []
    for _ in range(100):
        exposure = expose(rng, trail_at(rng, 30.0), 5.5)
        truth, pixels = exposure.trail, exposure.pixels
        share = rng.uniform(0.2, 0.8)
        row, col = truth.row0 + share * (truth.row1 - truth.row0), truth.col0 + share * (truth.col1 - truth.col0)
        star = replace(truth, row0=row, row1=row, col0=col, col1=col + 0.01, flux_e=10.0 * truth.flux_e)
        with_star = replace(pixels, value_e=pixels.value_e + rng.poisson(render(star, pixels.row, pixels.col)))
        fit = forced_fit(with_star, exposure.detection, TRACK_SNR)
        assert StreakFlag.CROSSES_STAR in fit.flags
        pulls.append((fit.flux_e - truth.flux_e) / fit.flux_err_e)
    assert abs(np.median(pulls)) < 0.5
    assert np.sqrt(np.mean(np.square(pulls))) < 1.4


def test_only_a_forced_fit_has_given_ends() -> None:
    """Its width is stated to be as uncertain as it is large. A failed fit was taken for a forced one too."""
    exposure = expose(np.random.default_rng(3), trail_at(np.random.default_rng(3), 100.0), 12.0)
    assert has_given_ends(forced_fit(exposure.pixels, exposure.detection, 30.0))
    assert not has_given_ends(TrailedPsfFitter().fit(exposure.pixels, exposure.detection))
    assert not has_given_ends(failed_fit(exposure.detection, exposure.pixels, "no line"))
