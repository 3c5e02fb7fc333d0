"""The curve of found trails against closed forms: shares, means over objects, the likelihood's slope, finds of one object."""

import numpy as np
import pytest
from scipy import integrate, optimize, stats

from sboc_e2e import scenario
from sboc_e2e.registry import Registry
from sboc_e2e.survey import curve as curves
from sboc_e2e.survey import response as responses
from sboc_e2e.survey.block import finds_of
from sboc_e2e.survey.curve import HALF, LN_SPREAD, LN_WIDTH, LOGIT_TOP, SHORTEST, WHEN_CUT, found_share, mean_share
from simulator.survey.looks import Looks

CURVE = np.array([7.3, -0.6, 0.4, -0.4, 4.0, -1.0, 0.5, 8.0, -0.3])


def test_half_of_the_top_is_found_at_the_half_point() -> None:
    top = 1.0 / (1.0 + np.exp(-CURVE[LOGIT_TOP]))
    thirty = np.full(1, 30.0)
    for cut in (False, True):
        half = CURVE[HALF] + cut * CURVE[WHEN_CUT]
        assert found_share(CURVE, np.array([half]), thirty, 1.0, cut)[0] == pytest.approx(0.5 * top)
        # three quarters of the top are found ln 3 widths above
        above = half + np.log(3.0) * np.exp(CURVE[LN_WIDTH])
        assert found_share(CURVE, np.array([above]), thirty, 1.0, cut)[0] == pytest.approx(0.75 * top)
    assert found_share(CURVE, np.array([7.3 - 1.0 * np.log10(2.0)]), thirty, 2.0)[0] == pytest.approx(0.5 * top)


def test_nothing_is_found_below_the_shortest_length_however_bright() -> None:
    bright = np.full(3, 1e3)
    top = 1.0 / (1.0 + np.exp(-CURVE[LOGIT_TOP]))
    shares = found_share(CURVE, bright, CURVE[SHORTEST] + np.array([-3.0, 0.0, 3.0]))
    assert shares == pytest.approx([0.0, 0.5 * top, top], abs=1e-3)


def test_the_mean_over_objects_is_the_integral_over_their_shifts() -> None:
    sigma = np.exp(CURVE[LN_SPREAD])
    for snr in (5.0, 7.3, 9.0):

        def at(shift: float, snr: float = snr) -> float:
            share = found_share(CURVE, np.array([snr]), np.array([30.0]), 1.0, False, shift)
            return float(stats.norm.pdf(shift, 0.0, sigma) * share[0])

        whole, _ = integrate.quad(at, -8.0 * sigma, 8.0 * sigma)
        assert mean_share(CURVE, np.array([snr]), np.array([30.0]))[0] == pytest.approx(whole, abs=3e-4)


def test_the_slope_of_the_likelihood_is_that_of_its_values(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(2)
    n = 400
    trails = curves.Trails(
        snr=rng.uniform(4.0, 14.0, n), length_px=10.0 ** rng.uniform(0.7, 2.5, n), noise_ratio=rng.uniform(1.0, 2.0, n),
        cut=rng.random(n) < 0.3, found=rng.random(n) < 0.5, owner=rng.integers(60, size=n),
    )  # fmt: skip
    errors = []

    def compared(loss, start, **_):  # type: ignore[no-untyped-def]
        by_values = optimize.approx_fprime(CURVE, lambda c: loss(c)[0], 1e-6)
        errors.append(np.abs(loss(CURVE)[1] - by_values).max())
        return optimize.OptimizeResult(x=start)

    monkeypatch.setattr(curves, "minimize", compared)
    curves.fitted(trails, sky=True)
    assert errors[0] < 2e-3


def test_finds_of_one_object_are_as_alike_as_its_shift_makes_them() -> None:
    """Two trails of each object: both found with the mean of p^2 over shifts, not with the square of the mean."""
    n = 40_000
    passage = np.repeat(np.arange(n), 2)
    k = len(passage)
    looks = Looks(
        passage=passage, snr=np.full(k, 7.5), length_px=np.full(k, 40.0), mag=np.full(k, 14.0), noise_e=np.ones(k),
        stands_for=np.ones(k), open_s=np.tile([1.0, 1.25], n), cut=np.ones(k, np.bool_), frames=np.full(n, 2),
    )  # fmt: skip
    detection = {"curve": CURVE.tolist(), "noise_e": [1.0, 1.0]}
    linking = [{"tried": 10, "linked": 0 if low < 2 else 10} for low in responses.FRAME_EDGES[:-1]]
    response = responses.Response(content={"detection": detection, "noise_e": 1.0, "linking": linking})
    finds = finds_of(np.ones(n), looks, response, np.random.default_rng(3))
    z = np.linspace(-8.0, 8.0, 4001)
    density = stats.norm.pdf(z) * (z[1] - z[0])
    p = found_share(CURVE, np.full(len(z), 7.5), np.full(len(z), 40.0), 1.0, True, np.exp(CURVE[LN_SPREAD]) * z)
    one, both = float(density @ p), float(density @ p**2)
    assert finds.look.mean() == pytest.approx(one, abs=4.0 * 0.5 / np.sqrt(n))
    assert (finds.frames == 2).mean() == pytest.approx(both, abs=4.0 * 0.5 / np.sqrt(n))
    assert both - one**2 > 0.02  # eight of its own sigma: independent finds would fail


def test_the_shipped_curve_has_what_its_trails_show() -> None:
    """Trails that the edge cuts need more S/N, those below 8 px are not found, and one object's trails are alike."""
    found = scenario.load("sso_antisun", registry=Registry())
    figures = responses.read(responses.shipped(found), found).content["detection"]
    assert figures["when_cut"]["low"] > 0.0
    assert 7.0 < figures["shortest_px"]["low"] < figures["shortest_px"]["high"] < 10.0
    assert figures["ln_spread_of_objects"]["low"] > np.log(0.1)
    # cells of the table against the curve: as far as their binomial scatter takes them
    assert figures["chi2"] < stats.chi2.ppf(0.999, figures["cells"] - len(figures["curve"]))
