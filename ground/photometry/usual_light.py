"""Light that an object shows in most frames, and the error of a magnitude of a faint frame, which is not normal.

Where S/N is 3 to 7, an error that is relative to the measured flux is too small for just the frames that noise or a star has made
too bright, and the logarithm bends the error that is left.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.photometry.zero_point import POGSON
from sboc_e2e.icd.products import StreakMeasurement

Array = NDArray[np.float64]

BRIGHTNESS: Final = 0.3
"""Spread of an object's light from frame to frame, relative. Spreads of 0.15 and 0.5 gave errors of 1.06 and 1.16 times the joint
bound where this gives 1.08 (63 tracklets), so that the choice matters little."""
ROBUST_STEPS: Final = 5
"""Of the mean brightness with Huber's weights, which have settled after them. Chosen, not measured."""
HUBER: Final = 2.0
"""Sigmas beyond which the weight of a frame's brightness falls. Chosen, not measured."""
OF_LOGARITHM: Final = 11.0 / 4.0
"""For y normal of mean 0 and variance q^2, the mean of ln(1 + y)^2 is q^2 (1 + 11/4 q^2) to the fourth order of q: that of y^2 -
y^3 + 11/12 y^4."""


def usual_light(light: Array) -> float:
    """Robust mean of the light of frames (n, 2), each with its variance."""
    value, variance = light.T
    mean = float(np.median(value))
    for _ in range(ROBUST_STEPS):
        total = variance + (BRIGHTNESS * mean) ** 2 + 1e-30
        weight = 1.0 / (total * np.maximum(1.0, np.abs(value - mean) / (HUBER * np.sqrt(total))))
        mean = float(weight @ value / weight.sum())
    return mean


def with_errors_of_usual_light(members: Sequence[StreakMeasurement]) -> list[StreakMeasurement]:
    """The members of a tracklet; those of an on-board track with the error of the magnitude of the light expected in their frame.

    Expected is the mean of the frame's own light and the usual one, by their errors. Errors of bright frames do not change.
    """
    known = [
        k
        for k, m in enumerate(members)
        if m.track >= 0 and not m.fit.is_foretold and np.isfinite(m.mag) and np.isfinite(m.mag_err) and m.mag_err > 0.0
    ]
    if not known:
        return list(members)
    mag, mag_err = (np.array([getattr(members[k], name) for k in known]) for name in ("mag", "mag_err"))
    light = 10.0 ** (-0.4 * (mag - np.median(mag)))
    variance = (light * mag_err / POGSON) ** 2
    usual = usual_light(np.stack([light, variance], axis=1))
    spread2 = (BRIGHTNESS * usual) ** 2
    expected = (light * spread2 + usual * variance) / (spread2 + variance)
    relative2 = variance / expected**2
    error = POGSON * np.sqrt(relative2 * (1.0 + OF_LOGARITHM * relative2))
    of = dict(zip(known, error.tolist(), strict=True))
    return [replace(m, mag_err=of[k]) if k in of else m for k, m in enumerate(members)]
