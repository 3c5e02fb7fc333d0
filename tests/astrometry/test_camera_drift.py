"""The camera's shared parameters over frames of the same stars: with and without thermal drift, errors mean what they say."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from ground.astrometry.astrometer import CameraFit
from ground.astrometry.camera import Camera
from ground.astrometry.camera_drift import FrameEvidence, SharedKnowledge
from ground.astrometry.camera_fit import fit_camera
from ground.astrometry.star_turnover import focal_correlation
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd.flags import FrameFlag
from tests.astrometry.star_fields import FieldOptions, make_field

TRUE = Camera(focal_px=44450.0, center_row=2047.5, center_col=2047.5, k1=-1.02, k2=0.0, p1=3e-5, p2=-1e-5)
PRIOR = np.array([1e-3, 1.1, 1e3, 2e-2, 2e-2])
SIDE_PX = 4095.0
WHITE_PX, CATALOGUE_PX = 0.012, 0.013
SPAN_S, N_FRAMES = 150.0, 40
"""600 frames at 4 frames/s, every fifteenth of them."""


@pytest.fixture(scope="module")
def catalogue() -> StarCatalogue:
    return StarCatalogue.embedded()


def at_rest(share: float) -> float:
    return 0.0


def warming(share: float) -> float:
    """20 ppm over the span."""
    return 20e-6 * share


def run(
    seed: int, drift: Callable[[float], float], *, step: float = 0.0, drift_s: float = 1e-7, catalogue_lasts: bool = True
) -> SharedKnowledge:
    """Knowledge after the span, from 300 stars with known linear model; the truth starts at `TRUE`.

    step : move of the field from frame to frame, in widths of the field, along a direction that is drawn.
    """
    rng = np.random.default_rng(seed)
    known = SharedKnowledge.prior(TRUE.shared() + PRIOR * np.array([0.2, 0.02, 0.0, 1e-3, 1e-3]), PRIOR, drift_s)
    angle = rng.uniform(0.0, 2.0 * np.pi)
    move = step * SIDE_PX * np.array([np.sin(angle), np.cos(angle)])
    reach = 0.5 * SIDE_PX + np.abs(move) * N_FRAMES
    sky = rng.uniform(-reach, reach, (rng.poisson(300.0 * np.prod(2.0 * reach) / SIDE_PX**2), 2))
    displaced = rng.normal(0.0, CATALOGUE_PX, sky.shape)
    for k in range(N_FRAMES):
        if k == 0 or step > 0.0:
            place = sky - k * move + 0.5 * SIDE_PX
            inside = np.all((place > 0.0) & (place < SIDE_PX), axis=1)
            _, by_rotation, by_shared = TRUE.derivatives(TRUE.unproject(*place[inside].T))
            turn, shared = by_rotation.reshape(-1, 3), by_shared.reshape(-1, 5)
            free = shared - turn @ np.linalg.solve(turn.T @ turn, turn.T @ shared)
        variance = WHITE_PX**2 + CATALOGUE_PX**2
        noise = rng.normal(0.0, WHITE_PX, len(free)) + displaced[inside].reshape(-1)
        values = TRUE.shared() + np.array([drift(k / N_FRAMES), 0.0, 0.0, 0.0, 0.0])
        known = known if k == 0 else known.after(SPAN_S / N_FRAMES)
        known = known.seen(
            FrameEvidence(
                values=values,
                gradient=free.T @ noise / variance,
                information=free.T @ free / variance,
                catalogue=catalogue_lasts * free.T @ free * CATALOGUE_PX**2 / variance**2,
                lasting=0.0 if k == 0 else focal_correlation(*np.minimum(np.abs(move) / SIDE_PX, 1.0)),
            )
        )
    return known


def focal_errors(drift: Callable[[float], float], n: int = 100, **options: Any) -> tuple[np.ndarray, np.ndarray]:
    """Relative error of the focal length at the end of runs, and what they say it is."""
    runs = [run(seed, drift, **options) for seed in range(n)]
    true = np.log(TRUE.focal_px) + drift((N_FRAMES - 1) / N_FRAMES)
    return np.array([k.values[0] - true for k in runs]), np.array([np.sqrt(k.errors[0, 0]) for k in runs])


@pytest.mark.parametrize("drift", [at_rest, warming])
@pytest.mark.parametrize("step", [0.0, 0.04, pytest.param(0.2, marks=pytest.mark.slow)])
@pytest.mark.slow
def test_pulls_of_the_focal_length_hold_with_and_without_drift(drift, step):
    """Of 100 runs of one star field each, or of scans over 1.6 and 8 fields; the rms of as many pulls scatters by 0.07."""
    error, sigma = focal_errors(drift, step=step)
    assert np.sqrt(np.mean((error / sigma) ** 2)) == pytest.approx(1.0, abs=0.1)
    assert sigma.mean() < 4e-6


@pytest.mark.parametrize("step", [0.0, 0.04])
def test_a_filter_without_process_noise_is_fifteen_sigma_off(step):
    """What the filter was: at rest, errors of the catalogue new in each frame. The focal length lags by half the drift."""
    error, sigma = focal_errors(warming, 10, step=step, drift_s=0.0, catalogue_lasts=False)
    assert error.mean() == pytest.approx(-10e-6, abs=2e-6)
    assert np.mean(np.abs(error / sigma)) > 15.0


def test_jitter_shows_no_new_stars_and_a_move_does(catalogue, monkeypatch):
    """600 frames that jitter by a pixel had forgotten a third of the catalogue's errors, and more with each frame."""
    fit, moves = CameraFit(lost_in_space="never"), []
    seen = SharedKnowledge.seen

    def noted(known: SharedKnowledge, frame: FrameEvidence) -> SharedKnowledge:
        moves.append(frame.lasting)
        return seen(known, frame)

    monkeypatch.setattr(SharedKnowledge, "seen", noted)
    state = None
    for k, ra_deg in enumerate((131.5, 131.502, 131.498, 131.5, 131.8, 131.801)):
        made = make_field(catalogue, 40 + k, FieldOptions(ra_deg=ra_deg, roll_deg=10.0, rate_rad_s=(0.0, 0.0, 0.0)))
        state = fit.initial_state(made.calibration, catalogue) if state is None else state
        state, solution = fit.solve(state, made.frame)
        assert not solution.flags & FrameFlag.NO_SOLUTION
    assert moves[:4] + moves[5:] == [0.0, 1.0, 1.0, 1.0, 1.0]
    assert 0.5 < moves[4] < 0.7


@pytest.mark.parametrize("move", [(0.0, 0.06), (0.17, 0.08)])
@pytest.mark.slow
def test_errors_of_stars_last_in_a_scan_as_long_as_stars_drawn_one_by_one_say(move):
    """Estimates of the focal length from 400 displaced stars a frame, least squares by another camera's derivatives: the error of
    the mean over long scans is that of a first-order process with the stated correlation, to 15 % (6.5 % of it chance)."""
    rng = np.random.default_rng(3)
    n = round(3.0 / max(move))
    reach = 1.0 + n * np.array(move)
    weight = None
    means, single = [], []
    for _ in range(120):
        sky = rng.random((rng.poisson(400.0 * np.prod(reach)), 2)) * reach
        displaced = rng.standard_normal(sky.shape)
        errors = []
        for k in range(n):
            place = sky - k * np.array(move)
            inside = np.all((place > 0.0) & (place < 1.0), axis=1)
            _, by_rotation, by_shared = TRUE.derivatives(TRUE.unproject(*(SIDE_PX * place[inside]).T))
            design = np.concatenate([by_shared, by_rotation], axis=2).reshape(-1, 8)
            design = design / np.abs(design).max(axis=0)
            weight = np.linalg.solve(design.T @ design, design.T @ displaced[inside].reshape(-1))
            errors.append(weight[0])
        means.append(np.mean(errors))
        single.append(np.mean(np.square(errors)))
    r = focal_correlation(*move)
    lags = np.arange(1, n)
    as_process = (1.0 + 2.0 * np.sum((1.0 - lags / n) * r**lags)) / n
    assert np.sqrt(np.mean(np.square(means)) / np.mean(single)) == pytest.approx(np.sqrt(as_process), rel=0.15)


def test_a_field_that_stands_still_keeps_its_errors_and_another_one_has_none_of_them():
    assert focal_correlation(0.0, 0.0) == 1.0
    assert focal_correlation(1.0, 0.3) == focal_correlation(1.0, 1.0) == 0.0
    assert focal_correlation(0.1, -0.02) == focal_correlation(0.1, 0.02)


def test_what_blends_do_to_stars_lasts_as_long_as_they_are_seen():
    """Shifts of 0.05 px that no error bar knows, the same in eight frames: the focal length may not claim to average them."""
    pulls = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        row, col = rng.uniform(0.0, SIDE_PX, (2, 250))
        vectors = TRUE.unproject(row, col)
        blended = rng.normal(0.0, 0.05, (250, 2))
        known = SharedKnowledge.prior(TRUE.shared(), PRIOR, 0.0)
        for k in range(8):
            fit = fit_camera(
                np.stack((row, col), axis=1) + blended + rng.normal(0.0, 0.02, (250, 2)),
                vectors,
                np.zeros((250, 3)),
                np.full(250, 0.02),
                catalogue_px=np.zeros(250),
                matrix=np.eye(3),
                camera=TRUE,
                prior=known.as_prior(),
            )
            known = known.seen(
                FrameEvidence(
                    values=fit.camera.shared(),
                    gradient=fit.gradient,
                    information=fit.information,
                    catalogue=fit.catalogue,
                    lasting=float(k > 0),
                )
            )
        pulls.append((known.values[0] - TRUE.shared()[0]) / np.sqrt(known.errors[0, 0]))
    # 40 runs: the rms scatters by 0.11; 2.6 when the excess counts as new in each frame
    assert np.sqrt(np.mean(np.square(pulls))) == pytest.approx(1.0, abs=0.25)
