"""Collision probability against NASA CARA's and Alfano's published figures, and against closed forms."""

import math

import numpy as np
import pytest
from scipy.special import i0e
from scipy.stats import ncx2, norm

from ground.conjunctions.assess import assess
from ground.conjunctions.cdm import read_cdm
from ground.conjunctions.curved import curved
from ground.conjunctions.encounter import Encounter, StateEstimate, encounter_of
from ground.conjunctions.equinoctial import equinoctial_of, state_at
from ground.conjunctions.monte_carlo import monte_carlo
from ground.conjunctions.probability import CHAN_ERROR, alfano, chan, dilution, equal_area_error, foster
from ground.orbit.dynamics import MU_KM3_S2
from sboc_e2e.icd.errors import UserError
from tests.conjunctions.reference import alfano_cases, folder, sheet

PER_MILLE = 1e-3


def messages() -> list[tuple[dict, StateEstimate, StateEstimate, float]]:
    """CARA's rows with the two estimates and the hard-body radius of each message."""
    root = folder("cdm")
    out = []
    for row in sheet(root / "CARA_PcMethod_Test_Conjunctions.xlsx"):
        message = read_cdm((root / f"{row['Conjunction_ID']}.cdm").read_text(), row["Conjunction_ID"])
        assert message.hard_body_km == pytest.approx(1e-3 * row["HBR_m"])
        out.append((row, message.first, message.second, message.hard_body_km))
    return out


def plane(miss_m: tuple[float, float], sigma_m: tuple[float, float], radius_m: float) -> Encounter:
    return Encounter(
        tca_s=0.0,
        relative=np.array([1e-3 * miss_m[0], 1e-3 * miss_m[1], 0.0, 0.0, 0.0, 10.0]),
        axes=np.eye(3),
        miss_km=1e-3 * np.array(miss_m),
        covariance_km2=1e-6 * np.diag(np.square(sigma_m)),
        hard_body_km=1e-3 * radius_m,
    )


def test_two_dimensional_probabilities_are_those_of_cara_for_every_message() -> None:
    found = messages()
    assert len(found) == 53
    for row, first, second, radius in found:
        encounter = encounter_of(first, second, radius)
        assert alfano(encounter) == pytest.approx(row["Pc2D"], rel=PER_MILLE), row["Conjunction_ID"]
        assert foster(encounter) == pytest.approx(row["Pc2D"], rel=PER_MILLE), row["Conjunction_ID"]


def test_linear_probabilities_are_those_of_alfano() -> None:
    for case in alfano_cases():
        if case.number == 12:
            continue  # no relative velocity at all: tested below
        encounter = encounter_of(case.first, case.second, case.hard_body_km)
        assert alfano(encounter) == pytest.approx(case.linear, rel=PER_MILLE), case.number


@pytest.mark.slow
def test_bent_orbits_give_caras_three_dimensional_probability_and_its_monte_carlo() -> None:
    pulls = []
    for row, first, second, radius in messages():
        found = curved(first, second, radius)
        if row["ViolationsNc2D"] > 0:
            assert found.slow, row["Conjunction_ID"]
            continue
        assert found.reliable, row["Conjunction_ID"]
        assert found.probability == pytest.approx(row["Nc3D"], rel=0.003), row["Conjunction_ID"]
        pulls.append((found.probability / row["PcSDMC"] - 1.0) * math.sqrt(row["NhitSDMC"]))
    assert len(pulls) == 50
    assert np.abs(pulls).max() < 3.0
    assert np.std(pulls) < 1.2


def test_the_assumptions_are_judged_as_cara_judges_them() -> None:
    wrong = []
    for row, first, second, radius in messages()[5::12]:
        judged = assess(first, second, radius, drawn=1000)
        fails = row["ViolationsPc2D"] > 0
        wrong.append((judged.stands != "two-dimensional") != fails)
    assert not any(wrong)


@pytest.mark.slow
def test_monte_carlo_is_within_three_sigma_of_alfanos() -> None:
    drawn = 200_000
    at_epoch = {case.number: case for case in alfano_cases("Epoch_Time")}
    for case in alfano_cases()[:10]:
        window = (-case.half_window_s, case.half_window_s)
        if case.number == 4:
            # drawn at epoch: between there and TCA, 250,560 s later, the cloud of an eccentric orbit bends
            case = at_epoch[4]
            window = (250_560.0 + window[0], 250_560.0 + window[1])
        found = monte_carlo(
            case.first, case.second, case.hard_body_km, drawn, window, cartesian=case.number == 4, enough_hits=drawn
        )
        sigma = math.sqrt(case.monte_carlo * (1.0 - case.monte_carlo) / drawn)
        assert abs(found.probability - case.monte_carlo) < 3.0 * sigma, case.number


@pytest.mark.slow
@pytest.mark.parametrize(("number", "entries"), [(11, 2.4407488450e-3), (12, 2.4415473580e-3)])
def test_encounters_that_last_are_entered_as_often_as_cara_says(number: int, entries: float) -> None:
    # expected: unit test of Pc3D_Hall (CARA Analysis Tools), which counts entries and not who is inside already
    case, drawn, first_s = alfano_cases()[number - 1], 400_000, -alfano_cases()[number - 1].half_window_s

    def hits(until_s: float) -> float:
        return monte_carlo(case.first, case.second, case.hard_body_km, drawn, (first_s, until_s), enough_hits=drawn).probability

    entered = hits(-first_s) - hits(first_s + 1e-4)
    assert abs(entered - entries) < 3.0 * math.sqrt(entries / drawn)


@pytest.mark.slow
def test_case_eleven_is_alfanos_from_the_closest_approach_on() -> None:
    case, drawn = alfano_cases()[10], 400_000
    window = (0.0, case.half_window_s)
    found = monte_carlo(case.first, case.second, case.hard_body_km, drawn, window, cartesian=True, enough_hits=drawn)
    assert abs(found.probability - case.monte_carlo) < 3.0 * math.sqrt(case.monte_carlo / drawn)


@pytest.mark.parametrize(("sigma_m", "radius_m"), [((100.0, 100.0), 10.0), ((5000.0, 20.0), 10.0), ((3000.0, 2.0), 20.0)])
def test_forms_agree_where_a_strip_is_all_there_is(sigma_m: tuple[float, float], radius_m: float) -> None:
    # along the long axis the density is flat: a chord-weighted sum of normal probabilities, by brute force
    encounter = plane((0.0, 30.0), sigma_m, radius_m)
    x = np.linspace(-radius_m, radius_m, 200_001)
    half = np.sqrt(radius_m**2 - x**2)
    strip = norm.cdf((30.0 + half) / sigma_m[1]) - norm.cdf((30.0 - half) / sigma_m[1])
    brute = np.trapezoid(strip * norm.pdf(x / sigma_m[0]) / sigma_m[0], x)
    assert alfano(encounter) == pytest.approx(brute, rel=1e-6)


def crossing(miss_m: float, sigma_m: tuple[float, float]) -> tuple[StateEstimate, StateEstimate]:
    """Orbits that cross at a right angle, the miss radial; combined errors radial and across, velocities to 0.01 mm/s."""
    speed = math.sqrt(MU_KM3_S2 / 7000.0)
    covariance = np.diag([*(0.5e-6 * np.square([sigma_m[0], sigma_m[1], sigma_m[1]])), 1e-16, 1e-16, 1e-16])
    one = StateEstimate(name="A", state=np.array([7000.0, 0, 0, 0, speed, 0]), covariance=covariance)
    two = StateEstimate(name="B", state=np.array([7000.0 + 1e-3 * miss_m, 0, 0, 0, 0, speed]), covariance=covariance)
    return one, two


@pytest.mark.parametrize(("sigma_m", "miss_m"), [(0.6, 18.0), (0.1, 18.0), (0.05, 0.0), (1.0, 20.0), (0.3, 20.5)])
def test_small_round_errors_are_a_noncentral_chi_square(sigma_m: float, miss_m: float) -> None:
    one, two = crossing(miss_m, (sigma_m, sigma_m))
    expected = float(ncx2.cdf((20.0 / sigma_m) ** 2, 2, (miss_m / sigma_m) ** 2))
    found = curved(one, two, 0.02)
    assert found.reliable
    assert found.probability == pytest.approx(expected, rel=2e-3)
    assert alfano(encounter_of(one, two, 0.02)) == pytest.approx(expected, rel=1e-5)


def test_small_errors_along_one_axis_are_alfanos() -> None:
    one, two = crossing(10.0, (0.2, 20.0))
    # radially the miss is known: half a chord at 10 m from the centre against a normal error of 20 m across
    expected = 2.0 * norm.cdf(math.sqrt(300.0) / 20.0) - 1.0
    found = curved(one, two, 0.02)
    assert found.reliable
    assert found.probability == pytest.approx(expected, rel=1e-3)
    assert found.probability == pytest.approx(alfano(encounter_of(one, two, 0.02)), rel=1e-3)


def test_foster_says_nothing_where_its_grid_is_too_coarse() -> None:
    assert math.isnan(foster(plane((18.0, 0.0), (0.9, 50.0), 20.0)))
    fine = plane((18.0, 0.0), (1.0, 1.0), 20.0)
    assert foster(fine) == pytest.approx(ncx2.cdf(400.0, 2, 324.0), rel=1e-6)


def test_all_hits_have_an_upper_limit_of_one() -> None:
    one, two = crossing(0.0, (0.1, 0.1))
    found = monte_carlo(one, two, 0.02, 1000, (-1.0, 1.0))
    assert found.hits == found.drawn == 1000
    # Clopper and Pearson 1934: with n of n hits the limits are (alpha / 2)^(1 / n) and 1
    assert found.low == pytest.approx(0.025 ** (1.0 / 1000.0), rel=1e-9)
    assert found.high == 1.0


def test_chan_holds_for_small_bodies_and_circles() -> None:
    round_one = plane((300.0, 0.0), (150.0, 150.0), 10.0)
    assert chan(round_one) == pytest.approx(alfano(round_one), rel=1e-9)
    assert chan(plane((300.0, 50.0), (400.0, 150.0), 5.0)) == pytest.approx(
        alfano(plane((300.0, 50.0), (400.0, 150.0), 5.0)), rel=2e-3
    )


def test_chan_says_nothing_where_an_ellipse_of_equal_area_is_another_one() -> None:
    """Of 2,000 encounters, half of them nearly round: a hundredth off at most, and less than the bound."""
    rng, said = np.random.default_rng(5), 0
    for k in range(2000):
        sigma = 10.0 ** rng.uniform(0.0, 4.0, 2)
        sigma[1] = sigma[0] * 10.0 ** rng.uniform(-0.3, 0.3) if k % 2 else sigma[1]
        miss = sigma * np.abs(rng.normal(size=2)) * rng.choice([0.3, 1.0, 3.0, 8.0])
        encounter = plane(tuple(miss), tuple(sigma), 10.0 ** rng.uniform(-1.0, 3.0))
        value, expected = chan(encounter), alfano(encounter)
        if math.isnan(value) or expected < 1e-290:
            continue
        said += 1
        assert value == pytest.approx(expected, rel=min(CHAN_ERROR, equal_area_error(encounter) + 1e-6), abs=0.0)
    assert said > 500
    # 20 m body, errors of 5 m and 500 m, 15 m off along the short axis: 0.001 by Chan's form, where it is 0.018
    assert math.isnan(chan(plane((15.0, 0.0), (5.0, 500.0), 20.0)))


def test_chan_is_caras_probability_or_nothing() -> None:
    values = [(chan(encounter_of(first, second, radius)), row["Pc2D"]) for row, first, second, radius in messages()]
    assert sum(not math.isnan(value) for value, _ in values) == 6
    for value, expected in values:
        assert math.isnan(value) or value == pytest.approx(expected, rel=CHAN_ERROR, abs=0.0)


def test_the_error_of_equal_areas_is_its_first_term() -> None:
    """A small body on the short axis: the closed form against the integrals themselves."""
    encounter = plane((30.0, 0.0), (10.0, 40.0), 1.0)
    error = chan(encounter) / alfano(encounter) - 1.0
    u = 1.0 / 10.0 - 1.0 / 40.0
    assert error == pytest.approx(-u / 8.0 * (30.0**2 / 10.0**3 - u), rel=0.01)
    assert abs(error) < equal_area_error(encounter) < 1.2 * abs(error)


def test_the_worst_scale_is_that_of_the_closed_form() -> None:
    # small circle, equal errors: P = R^2/(2 s^2) exp(-d^2/2s^2) is largest at s = d/sqrt 2: R^2/(d^2 e)
    worst = dilution(plane((1000.0, 0.0), (2000.0, 2000.0), 1.0))
    assert worst.probability == pytest.approx(1.0 / (1000.0**2 * math.e), rel=1e-5)
    assert worst.scale == pytest.approx(1000.0 / math.sqrt(2.0) / 2000.0, rel=1e-3)
    assert worst.diluted
    assert not dilution(plane((1000.0, 0.0), (200.0, 200.0), 1.0)).diluted


def test_far_tails_do_not_cancel() -> None:
    encounter = plane((0.0, 1000.0), (50.0, 50.0), 5.0)
    # Rice's distribution: r exp(-(r^2 + 20^2) / 2) I0(20 r) up to a tenth of a deviation
    r = np.linspace(0.0, 0.1, 2001)
    expected = float(np.trapezoid(r * np.exp(-0.5 * (20.0 - r) ** 2) * i0e(20.0 * r), r))
    assert 0.0 < expected < 1e-80
    assert alfano(encounter) == pytest.approx(expected, rel=1e-6, abs=0.0)
    assert math.isnan(chan(encounter)), "its distribution function gives 0"


def test_equinoctial_elements_return_the_state_and_follow_kepler() -> None:
    rng = np.random.default_rng(5)
    states = np.hstack([rng.normal(size=(200, 3)), np.zeros((200, 3))])
    states[:, :3] *= rng.uniform(7000, 40000, (200, 1)) / np.linalg.norm(states[:, :3], axis=1, keepdims=True)
    states[:, 3:] = rng.normal(size=(200, 3)) * 0.5 * np.sqrt(MU_KM3_S2 / np.linalg.norm(states[:, :3], axis=1))[:, None]
    elements = equinoctial_of(states)
    bound = np.isfinite(elements).all(axis=1) & (np.hypot(elements[:, 1], elements[:, 2]) < 0.95)
    assert bound.sum() > 100
    np.testing.assert_allclose(state_at(elements[bound], 0.0), states[bound], rtol=0, atol=1e-6)
    period = 2.0 * np.pi / elements[bound][:, 0]
    np.testing.assert_allclose(state_at(elements[bound], period), states[bound], rtol=0, atol=1e-5)


def test_no_relative_motion_and_bad_figures_are_refused() -> None:
    one = StateEstimate(name="A", state=np.array([7000.0, 0, 0, 0, 7.5, 0]), covariance=1e-4 * np.eye(6))
    with pytest.raises(UserError, match="A and A: no relative velocity"):
        encounter_of(one, one, 0.01)
    two = StateEstimate(name="B", state=np.array([7000.0, 0, 0, 0, 0, 7.5]), covariance=1e-4 * np.eye(6))
    with pytest.raises(UserError, match="hard-body radius: expected more than 0"):
        encounter_of(one, two, 0.0)
    with pytest.raises(UserError, match="B: covariance of the position: not positive"):
        StateEstimate(name="B", state=two.state, covariance=np.diag([1.0, -1.0, 1.0, 1.0, 1.0, 1.0]))
    with pytest.raises(UserError, match="Monte Carlo: expected pairs"):
        monte_carlo(one, two, 0.01, 0, (-1.0, 1.0))


@pytest.mark.slow
def test_objects_that_stay_together_go_to_monte_carlo() -> None:
    speed = math.sqrt(MU_KM3_S2 / 7000.0)
    covariance = np.diag([0.01, 0.01, 0.01, 1e-9, 1e-9, 1e-9])
    one = StateEstimate(name="A", state=np.array([7000.0, 0, 0, 0, speed, 0]), covariance=covariance)
    two = StateEstimate(name="B", state=np.array([7000.02, 0, 0, 0, speed, 5e-5]), covariance=covariance)
    judged = assess(one, two, 0.02, drawn=2000)
    assert judged.stands == "Monte Carlo"
    assert judged.trial is not None
    assert judged.trial.low < judged.probability < judged.trial.high
