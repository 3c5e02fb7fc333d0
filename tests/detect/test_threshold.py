"""Elongated sources are those of sep, whose formulas they follow."""

import numpy as np
import pytest
import sep

from onboard.detect import components, threshold
from tests.benchmarks.detection_frames import add_streak, exposure, random_stars, random_streak, view_of


@pytest.mark.parametrize(("level", "area", "ratio"), [(112.0, 8, 3.0), (80.5, 8, 1.5)])
def test_sources_are_those_of_sep(level: float, area: int, ratio: float) -> None:
    rng = np.random.default_rng(4)
    scene = exposure(512, random_stars(512, 50_000, rng), rng)
    for length in (8.0, 20.0, 60.0, 200.0):
        add_streak(scene, random_streak(512, length, 100.0, rng), rng)
    view = view_of(scene)
    image = components.half_resolution(components.masked_image(view, 0.0, 1e9), view.psf_sigma_px)
    found = sep.extract(image.astype(np.float32), level, minarea=area, filter_kernel=None, deblend_cont=1.0, clean=False)
    found = found[found["a"] >= ratio * np.maximum(found["b"], 0.29)]
    ours = threshold.extract_elongated(image, threshold=level, min_area_px=area, min_axis_ratio=ratio)
    assert len(ours) == len(found) >= 4
    middle, half = 0.5 * (ours[:, :2] + ours[:, 2:]), 0.5 * (ours[:, 2:] - ours[:, :2])
    apart = np.hypot(middle[:, :1] - found["y"], middle[:, 1:] - found["x"])
    match = apart.argmin(axis=1)
    assert len(set(match)) == len(found)
    assert apart.min(axis=1).max() < 1e-6
    assert np.hypot(*half.T) == pytest.approx(np.sqrt(3.0) * found["a"][match], rel=1e-5)
    turn = np.arctan2(half[:, 0], half[:, 1]) - found["theta"][match]
    assert np.abs(np.sin(turn)).max() < 1e-4


def test_empty_image_has_no_sources() -> None:
    assert threshold.extract_elongated(np.zeros((8, 8), np.int16), threshold=10.0, min_area_px=1, min_axis_ratio=1.0).shape == (
        0,
        4,
    )
