"""Brightness of a tracklet from frame to frame, and its period where there is one."""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.products import StreakMeasurement

FEWEST_FRAMES: Final = 8
"""A sine, a mean and a frequency take four; twice as many leave some to judge them by. Chosen, not measured."""
FALSE_ALARM: Final = 0.01
"""A period is given when noise alone would show as high a peak in one of a hundred tracklets."""


class LightCurve(NamedTuple):
    """Magnitudes of the members that have one: t_s (n,) after the first, mag and mag_err (n,).

    period_s : NaN without a significant one; false_alarm : probability of as high a peak without any, NaN when not tried.
    Frames sample a curve at their rate: periods below two frames appear as longer ones.
    """

    t_s: NDArray[np.float64]
    mag: NDArray[np.float64]
    mag_err: NDArray[np.float64]
    period_s: float
    false_alarm: float


def light_curve(members: Sequence[StreakMeasurement]) -> LightCurve:
    """Generalised Lomb-Scargle periodogram of the members' magnitudes (Zechmeister & Kuerster 2009, A&A 496, 577).

    Tried are periods from two frames to the whole passage; the false-alarm probability is Baluev's (2008, MNRAS 385, 1279).
    """
    known = sorted((int(s.t_tai_ns[1]), s.mag, s.mag_err) for s in members if np.isfinite(s.mag) and s.mag_err > 0.0)
    if not known:
        none = np.zeros(0)
        return LightCurve(none, none, none, float("nan"), float("nan"))
    t_s = np.array([(t - known[0][0]) * 1e-9 for t, _, _ in known])
    mag, error = np.array([m for _, m, _ in known]), np.array([e for _, _, e in known])
    span, step = float(np.ptp(t_s)), float(np.median(np.diff(t_s))) if len(t_s) > 1 else 0.0
    if len(t_s) < FEWEST_FRAMES or not step > 0.0:
        return LightCurve(t_s, mag, error, float("nan"), float("nan"))
    from astropy.timeseries import LombScargle  # takes a tenth of a second, which short tracklets do not need

    highest = 0.5 / step
    frequency = np.linspace(1.0 / span, highest, max(int(10 * span * highest), 50))
    model = LombScargle(t_s, mag, error)
    power = model.power(frequency)
    best = int(np.argmax(power))
    alarm = float(model.false_alarm_probability(power[best], method="baluev", maximum_frequency=highest))
    return LightCurve(t_s, mag, error, float(1.0 / frequency[best]) if alarm < FALSE_ALARM else float("nan"), alarm)
