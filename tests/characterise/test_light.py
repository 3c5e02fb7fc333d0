"""What light says of an object, against bodies of flat faces, closed forms and plain noise."""

import math

import numpy as np
import pytest

from ground.characterise.judge import characterise
from ground.characterise.period import find_period
from ground.characterise.reduced import Pass, phase_function
from sboc_e2e.icd.errors import UserError
from tests.characterise.facets import Body, light, passes


def read(rng: np.random.Generator, period_s: float | None, **options: float | int) -> list[Pass]:
    return [Pass(**vars(one)) for one in passes(rng, period_s=period_s, **options)]  # type: ignore[arg-type]


def flat(rng: np.random.Generator, mag: float = 10.0, sigma: float = 0.1, n: int = 200) -> Pass:
    return Pass(
        t_s=2.0 * np.arange(n, dtype=np.float64), mag=mag + sigma * rng.standard_normal(n), mag_err=np.full(n, sigma),
        range_km=np.full(n, 36_000.0), phase_deg=np.full(n, 40.0),
    )  # fmt: skip


def test_a_facet_reflects_by_lambert_s_law() -> None:
    plate = Body(
        normal=np.array([[0.0, 0.0, 1.0]]), area=np.array([2.0]), diffuse=np.array([0.3]), mirror=np.zeros(1),
        sharpness=np.ones(1),
    )  # fmt: skip
    tilt = math.radians(60.0)
    found = light(plate, np.eye(3)[None], np.array([[0.0, 0.0, 1.0]]), np.array([[math.sin(tilt), 0.0, math.cos(tilt)]]))
    assert found[0] == pytest.approx(0.3 / math.pi * 2.0 * 0.5)


def test_range_and_phase_leave_a_sphere_constant() -> None:
    # Lambert's sphere (Russell 1916) and a mirror-like one, typed in here
    alpha, away = np.radians(np.linspace(10.0, 100.0, 60)), np.linspace(30_000.0, 45_000.0, 60)
    diffuse = (np.sin(alpha) + (np.pi - alpha) * np.cos(alpha)) / np.pi
    mag = 9.0 + 5.0 * np.log10(away / 1000.0) - 2.5 * np.log10(0.7 * diffuse + 0.3 * 0.375)
    one = Pass(t_s=np.arange(60.0), mag=mag, mag_err=np.full(60, 0.01), range_km=away, phase_deg=np.degrees(alpha))
    found = phase_function([one])
    assert found.fitted
    # means of eighths of the pass: the curve's bend within one is left
    assert found.mirror_share == pytest.approx(0.3, abs=0.02)
    assert found.absolute_mag == pytest.approx(9.0, abs=0.02)
    assert float(np.ptp(one.at_standard - found.at(one.phase_deg))) < 0.03


def test_a_sine_in_noise_has_its_period() -> None:
    rng = np.random.default_rng(1)
    t = [np.sort(rng.uniform(0.0, 400.0, 200)) for _ in range(3)]
    mag = [0.3 * np.sin(2.0 * np.pi * x / 17.3 + k) + 0.1 * rng.standard_normal(200) for k, x in enumerate(t)]
    found = find_period(t, mag, [np.full(200, 0.1)] * 3)
    assert found.period_s == pytest.approx(17.3, rel=0.002)
    assert abs(found.period_s - 17.3) < 4.0 * found.period_err_s
    assert found.false_alarm < 1e-6
    assert found.string_alarm < 0.02
    assert found.amplitude_mag == pytest.approx(0.6, abs=0.1)


def test_noise_alarms_as_often_as_it_says() -> None:
    rng = np.random.default_rng(2)
    n = 30
    alarms = []
    for _ in range(n):
        t = [np.sort(rng.uniform(0.0, 200.0, 40)) for _ in range(2)]
        alarms.append(find_period(t, [rng.standard_normal(40) for _ in t], [np.ones(40)] * 2).false_alarm)
    # not more often than said, with three sigma of the count
    assert np.mean(np.array(alarms) < 0.1) < 0.1 + 3.0 * math.sqrt(0.09 / n)


def test_classes() -> None:
    rng = np.random.default_rng(3)
    steady = [flat(rng) for _ in range(3)]
    assert characterise(steady).kind == "stable"
    flash = np.where(np.arange(200) == 77, -3.0, 0.0)
    glint = Pass(**{**vars(steady[0]), "mag": steady[0].mag + flash})
    found = characterise([glint, *steady[1:]])
    assert (found.kind, found.flashes) == ("glinting", 1)
    wandering = Pass(**{**vars(steady[0]), "mag": steady[0].mag + 0.4 * np.cumsum(rng.standard_normal(200)) / 3.0})
    assert characterise([wandering, *steady[1:]]).kind in ("varying", "glinting")
    tumbler = read(np.random.default_rng(4), 23.0)
    found = characterise(tumbler)
    assert found.kind == "tumbling"
    assert found.period.period_s == pytest.approx(23.0, rel=0.01)


def test_bad_passes_are_refused_by_name() -> None:
    good = flat(np.random.default_rng(0))
    for field, value, words in (
        ("t_s", good.t_s[::-1], "times fall"),
        ("mag_err", np.zeros(200), "errors below"),
        ("range_km", np.full(200, -1.0), "not above 0"),
        ("phase_deg", np.full(200, 190.0), "between 0 and 180"),
    ):
        with pytest.raises(UserError, match=words):
            Pass(**{**vars(good), field: value})
    assert math.isnan(find_period([], [], []).period_s)


@pytest.mark.slow
@pytest.mark.parametrize(("bins", "shortest_s", "longest_s", "objects"), [(1, 6.0, 140.0, 100), (8, 0.6, 6.0, 30)])
def test_periods_of_tumblers_with_three_passes(bins: int, shortest_s: float, longest_s: float, objects: int) -> None:
    rng = np.random.default_rng([13, bins])
    right = tried = 0
    for _ in range(objects):
        true = 10.0 ** rng.uniform(math.log10(shortest_s), math.log10(longest_s))
        seen = read(rng, true, bins=bins)
        if seen:
            tried += 1
            right += abs(characterise(seen).period.period_s / true - 1.0) < 0.01
    assert tried >= 0.9 * objects
    assert right >= 0.9 * tried


@pytest.mark.slow
def test_stable_ones_have_no_period() -> None:
    rng = np.random.default_rng(14)
    found = [characterise(seen) for seen in (read(rng, None) for _ in range(100)) if seen]
    assert len(found) >= 90
    assert sum(math.isfinite(c.period.period_s) for c in found) <= 0.05 * len(found)
