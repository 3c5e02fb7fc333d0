"""Fits that fail: expected ones by name and counted, defects by a stop that names step, frame and region."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import ground.streaks.fitter as fitter_module
from ground.guard import guarded
from ground.streaks import TrailedPsfFitter
from ground.streaks.no_trail import Reason
from sboc_e2e.icd.errors import PluginError
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakFit, StreakPixels
from sboc_e2e.icd.signals import Detection
from tests.astrometry.test_faulty_steps import fields as fields
from tests.astrometry.test_ground_chain import chain_of
from tests.streaks.trail_rendering import PSF_SIGMA_PX, VARIANCE_E2


def region(value_e: np.ndarray, variance_e2: np.ndarray | None = None) -> StreakPixels:
    """All pixels of a small frame."""
    rows, cols = np.mgrid[: value_e.shape[0], : value_e.shape[1]]
    variance = np.full(value_e.shape, VARIANCE_E2) if variance_e2 is None else variance_e2
    return StreakPixels(
        row=rows.ravel().astype(np.int32), col=cols.ravel().astype(np.int32), value_e=value_e.ravel().astype(np.float32),
        variance_e2=variance.ravel().astype(np.float32), psf_sigma_px=PSF_SIGMA_PX, frame_shape=value_e.shape,
    )  # fmt: skip


ALONG = Detection(row0=15.0, col0=5.0, row1=15.0, col1=55.0, snr=10.0)


@pytest.mark.parametrize(
    ("pixels", "reason"),
    [
        (region(np.zeros((31, 61)), np.full((31, 61), np.inf)), Reason.NO_LINE),
        (region(np.full((31, 61), -20.0)), Reason.NO_LINE),
        (region(np.full((31, 61), np.nan)), Reason.NO_LINE),
    ],
)
def test_pixels_without_a_trail_say_why(pixels: StreakPixels, reason: Reason) -> None:
    fit = TrailedPsfFitter().fit(pixels, ALONG)
    assert fit.flags & StreakFlag.FIT_FAILED
    assert fit.failure == reason
    point = replace(ALONG, col1=5.0, flags=StreakFlag.POINT_LIKE)
    assert TrailedPsfFitter().fit(pixels, point).failure == Reason.NO_SOURCE


def test_a_defect_of_the_fitter_is_no_failed_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    """A ValueError of shapes was published as FIT_FAILED; it stops, and step, frame and region are named."""

    def broken(*_: Any) -> StreakFit:
        return np.zeros(3) @ np.zeros(4)

    monkeypatch.setattr(fitter_module, "fit_trail", broken)
    step = TrailedPsfFitter()
    with pytest.raises(PluginError, match=r"ground\.streak_fitter .*:TrailedPsfFitter, frame 3, region 8: ValueError: matmul"):
        guarded("streak_fitter", step, "frame 3, region 8", StreakFit, step.fit, region(np.zeros((31, 61))), ALONG)


def test_a_run_names_the_region_and_counts_what_was_expected(fields: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    chain = chain_of(fields[0])
    state = chain.initial_state()
    empty = [replace(f.frame, rois=tuple(_dark(group) for group in f.frame.rois)) for f in fields]
    products = []
    for frame in empty:
        state, product = chain.process_frame(state, frame)
        products.append(product)
    failed = sum(bool(s.fit.flags & StreakFlag.FIT_FAILED) for p in products for s in p.streaks)
    assert failed > 0
    assert sum(len(p.fit_failures) for p in products) == failed
    monkeypatch.setattr(fitter_module, "fit_trail", lambda *_: np.zeros(3) @ np.zeros(4))
    with pytest.raises(PluginError, match=r"TrailedPsfFitter, frame 0, region \d+: ValueError"):
        chain.process_frame(chain.initial_state(), fields[0].frame)


def _dark(group: Any) -> Any:
    """The region with pixels far below the sky: nothing there can be a trail."""
    return replace(group, strips=tuple(replace(s, values_adu=np.full_like(s.values_adu, -300)) for s in group.strips))


def test_any_pixels_give_a_record() -> None:
    """Regions cut, masked, of wild values and noise: 300 of them, none stops."""
    rng = np.random.default_rng(8)
    for _ in range(300):
        shape = (int(rng.integers(1, 60)), int(rng.integers(1, 90)))
        value = rng.choice([0.0, -50.0, 50.0, 1e4]) + rng.choice([0.0, 3.0, 1e5]) * rng.standard_normal(shape)
        variance = np.full(shape, rng.choice([1e-10, VARIANCE_E2, 1e9]))
        variance[rng.random(shape) < rng.random()] = np.inf
        ends = rng.uniform(-5.0, 65.0, 4)
        detection = Detection(row0=ends[0], col0=ends[1], row1=ends[2], col1=ends[3], snr=float(rng.choice([0.0, 8.0, 1e4])))
        fit = TrailedPsfFitter().fit(region(value, variance), detection)
        assert (fit.failure != "") == bool(fit.flags & StreakFlag.FIT_FAILED)
