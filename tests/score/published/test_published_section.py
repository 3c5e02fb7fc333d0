"""The section sees the error that was put into a message made by hand, and only that one."""

import json
from pathlib import Path

import numpy as np
import pytest
from astropy.table import Table

from sboc_e2e.score.published import published_products
from tests.score.published.conftest import EPOCH_TAI_NS, OBSERVER, HandMade

MAS = 1e-3


def value(section: dict, path: str) -> float:
    part, name = path.split(".")
    assert section[part][name]["value"] is not None, section[part][name]
    return section[part][name]["value"]


CLEAN = {
    "angles.along_rms_arcsec": 0.0, "angles.cross_rms_arcsec": 0.0, "angles.along_bias_arcsec": 0.0, "angles.gross_share": 0.0,
    "angles.epoch_bias_ms": 0.0, "angles.epoch_rms_ms": 0.0, "angles.differs_from_streaks": 0.0,
    "angles.epoch_differs_from_streaks": 0.0, "angles.streaks_along_rms_arcsec": 0.0, "magnitudes.line_rms_mag": 0.0,
    "magnitudes.tracklet_rms_mag": 0.0, "observer.position_rms_m": 0.0, "observer.velocity_rms_m_s": 0.0,
    "observer.interpolated_position_rms_m": 0.0, "observer.interpolated_velocity_rms_m_s": 0.0,
    "observer.implied_minus_quoted_rms_m_s": 0.0,
}  # fmt: skip
NEAR = {"arcsec": 5 * MAS, "ms": 1e-3, "mag": 1e-3, "m": 0.02, "s": 1e-3, "share": 1e-9, "streaks": 1e-9}
"""Microseconds of epochs move fast objects by milliarcseconds and the camera by millimetres."""


def check(section: dict, expected: dict[str, float]) -> None:
    for path, wanted in (CLEAN | expected).items():
        assert value(section, path) == pytest.approx(wanted, rel=0.02, abs=NEAR[path.rsplit("_", 1)[1]]), path


def test_messages_without_error_have_none(hand_made: HandMade) -> None:
    hand_made.write_tdm()
    hand_made.write_oem()
    section = hand_made.score()
    check(section, {})
    assert value(section, "angles.n_angles") == 5 * 8 * 2
    assert value(section, "angles.n_segments") == 5
    assert section["angles"]["along_pull_std"]["reason"] == "no errors are published for each angle"
    assert section["observer"]["nees"]["reason"] == "no covariance is published"
    assert "no orbit state was published" in section["states"]["nees"]["reason"]


def test_axes_of_gcrs_are_read_as_such(hand_made: HandMade) -> None:
    """Directions that say GCRF but are turned by the frame bias (23 mas) are off by that much, and differ from the table."""
    hand_made.write_oem()
    text = hand_made.write_tdm(frame="GCRF").read_text()
    check(hand_made.score(), {})
    (hand_made.folder / "products" / "tracklets.tdm").write_text(text.replace("GCRF", "EME2000"))
    section = hand_made.score()
    assert value(section, "angles.differs_from_streaks") == 1.0
    whole = np.hypot(value(section, "angles.along_rms_arcsec"), value(section, "angles.cross_rms_arcsec"))
    assert 0.015 < whole < 0.03


@pytest.mark.parametrize(
    ("mutation", "expected"),
    [
        ({"along": 1.0}, {"angles.along_rms_arcsec": 1.0, "angles.along_bias_arcsec": 1.0, "angles.differs_from_streaks": 1.0}),
        ({"along": -1.0}, {"angles.along_rms_arcsec": 1.0, "angles.along_bias_arcsec": -1.0, "angles.differs_from_streaks": 1.0}),
        ({"cross": 1.0}, {"angles.cross_rms_arcsec": 1.0, "angles.differs_from_streaks": 1.0}),
        ({"mag": 0.3}, {"magnitudes.line_rms_mag": 0.3}),
    ],
    ids=["along", "backwards", "across", "magnitude"],
)
def test_shifted_angles_are_off_by_the_shift(hand_made: HandMade, mutation: dict, expected: dict[str, float]) -> None:
    hand_made.write_tdm(**mutation)
    hand_made.write_oem()
    check(hand_made.score(), expected)


def test_late_epochs_are_late_and_move_angles_back_by_the_rate(hand_made: HandMade) -> None:
    hand_made.write_tdm(late_ms=10.0)
    hand_made.write_oem()
    section = hand_made.score()
    for name, wanted in (("epoch_bias_ms", 10.0), ("epoch_rms_ms", 10.0), ("epoch_differs_from_streaks", 1.0)):
        assert value(section, f"angles.{name}") == pytest.approx(wanted, abs=2e-3)
    for name in ("cross_rms_arcsec", "differs_from_streaks", "gross_share", "streaks_along_rms_arcsec"):
        assert value(section, f"angles.{name}") == pytest.approx(0.0, abs=0.05), name
    units = [hand_made.direction(k, np.array([1.0, 1.01])) for k in range(hand_made.n_objects)]
    moved = [np.degrees(np.arccos(np.clip(u[0] @ u[1], -1, 1))) * 3600 for u, _ in units]
    assert value(section, "angles.along_rms_arcsec") == pytest.approx(np.sqrt(np.mean(np.square(moved))), rel=0.1)
    assert value(section, "angles.along_bias_arcsec") < -0.5 * min(moved)


def test_swapped_angles_are_gross(hand_made: HandMade) -> None:
    hand_made.write_tdm(swapped=True)
    hand_made.write_oem()
    section = hand_made.score()
    assert value(section, "angles.gross_share") == 1.0
    assert value(section, "angles.differs_from_streaks") == 1.0
    assert value(section, "angles.epoch_rms_ms") == pytest.approx(0.0, abs=1e-3)
    assert value(section, "angles.streaks_along_rms_arcsec") == pytest.approx(0.0, abs=1e-6)
    assert value(section, "observer.velocity_rms_m_s") == pytest.approx(0.0, abs=1e-3)


def test_velocity_error_of_the_ephemeris(hand_made: HandMade) -> None:
    """Positions stay right; halfway between nodes the Hermite cubic shows half the error the other way (p' = 1.5 dx/h - v/2)."""
    hand_made.write_tdm()
    hand_made.write_oem(velocity_m_s=3.0)
    expected = {"velocity_rms_m_s": 3.0, "implied_minus_quoted_rms_m_s": 3.0, "interpolated_velocity_rms_m_s": 1.5}
    check(hand_made.score(), {f"observer.{name}": wanted for name, wanted in expected.items()})


def test_position_error_of_the_ephemeris(hand_made: HandMade) -> None:
    hand_made.write_tdm()
    hand_made.write_oem(position_m=40.0)
    check(hand_made.score(), {"observer.position_rms_m": 40.0, "observer.interpolated_position_rms_m": 40.0})


def test_covariance_of_the_ephemeris(hand_made: HandMade) -> None:
    """5 m along one axis of 5 m sigma and nothing else: chi-square 1 of six; the interval is that of six numbers."""
    hand_made.write_oem(position_m=5.0, covariance=True)
    found = hand_made.score()["observer"]["nees"]
    assert found["value"] == pytest.approx(1.0 / 6.0, rel=1e-2)
    assert found["n"] == 6
    assert (found["low"], found["high"]) == pytest.approx((found["value"] * 6 / 12.592, found["value"] * 6 / 1.635), rel=1e-3)


def test_stated_errors_of_angles_give_pulls(hand_made: HandMade) -> None:
    """Errors of 1 and 2 arcsec that the companion states as 0.5 and 4: robust widths and chi-square are plain numbers."""
    hand_made.write_tdm(along=1.0, cross=2.0)
    t = np.concatenate([hand_made.streaks["t0_tai_ns"], hand_made.streaks["t1_tai_ns"]])
    number = np.tile(hand_made.streaks["tracklet_id"], 2)
    companion = Table({"tracklet_id": number, "epoch_tai_ns": t, "sigma_along_arcsec": np.full(len(t), 0.5)})
    companion["sigma_cross_arcsec"] = 4.0
    companion.write(hand_made.folder / "products" / "tdm_angles.ecsv", format="ascii.ecsv")
    angles = hand_made.score()["angles"]
    assert angles["along_pull_std"]["value"] == pytest.approx(2.0 / np.sqrt(0.4549), rel=0.01)
    assert angles["cross_pull_std"]["value"] == pytest.approx(0.5 / np.sqrt(0.4549), rel=0.01)
    assert angles["nees"]["value"] == pytest.approx(0.5 * (4.0 + 0.25), rel=0.01)
    companion["correlation_along_cross"] = 0.6
    companion.write(hand_made.folder / "products" / "tdm_angles.ecsv", format="ascii.ecsv", overwrite=True)
    expected = 0.5 * np.array([2.0, 0.5]) @ np.linalg.inv([[1.0, 0.6], [0.6, 1.0]]) @ np.array([2.0, 0.5])
    assert hand_made.score()["angles"]["nees"]["value"] == pytest.approx(expected, rel=0.01)


def test_magnitudes_of_tracklets_have_their_own_errors(hand_made: HandMade) -> None:
    """Off by twice their sigma: the pull is 2 for unit-normal medians of 0.6745."""
    hand_made.write_tdm()
    hand_made.tracklets["mag"] = hand_made.tracklets["mag"] + 0.04
    found = hand_made.score()["magnitudes"]
    assert found["tracklet_bias_mag"]["value"] == pytest.approx(0.04, abs=1e-6)
    assert found["tracklet_pull_std"]["value"] == pytest.approx(2.0 / 0.6745, rel=1e-3)
    assert found["tracklet_pull_std"]["n"] == 5
    assert found["line_pull_std"]["value"] == pytest.approx(0.0, abs=1e-3)


def test_states_drawn_from_their_covariance(tmp_path: Path) -> None:
    """A hundred objects: chi-square over its degrees of freedom is 1 with the covariance, 4 with one of half the sigma."""
    run = HandMade(tmp_path / "run", n_objects=100, n_frames=4)
    rng = np.random.default_rng(3)
    sigma = np.array([5.0, 3.0, 2.0, 0.05, 0.04, 0.02])
    mixed = np.eye(6) + 0.5 * np.tril(rng.uniform(-1, 1, (6, 6)), -1)
    factor = sigma[:, None] * mixed
    errors = {tracklet: factor @ rng.standard_normal(6) for tracklet in run.owner}
    chi2 = np.mean([np.sum(np.linalg.solve(factor, e) ** 2) for e in errors.values()]) / 6.0
    for scale in (1.0, 0.5):
        for tracklet, error in errors.items():
            run.write_opm(tracklet, error, scale**2 * factor @ factor.T)
        found = run.score()["states"]
        assert found["nees"]["value"] == pytest.approx(chi2 / scale**2, rel=1e-3)
        assert found["nees"]["n"] == 100
    assert found["n_not_positive"]["value"] == 0
    lengths = [np.linalg.norm(e[:3]) for e in errors.values()]
    assert found["position_error_median_km"]["value"] == pytest.approx(np.median(lengths), rel=1e-4)
    assert found["velocity_error_median_km_s"]["value"] == pytest.approx(
        np.median([np.linalg.norm(e[3:]) for e in errors.values()]), rel=1e-4
    )
    assert found["covariance_share"]["value"] == 1.0
    assert found["samples_share"]["value"] == 0.0


def test_true_states_are_those_of_the_orbits(hand_made: HandMade) -> None:
    """States without error: decimetres within the arc; 60 s later what the Earth's flattening does, which these orbits lack."""
    for tracklet in hand_made.owner:
        hand_made.write_opm(tracklet, np.zeros(6), None)
    found = hand_made.score()["states"]
    assert found["position_error_median_km"]["value"] < 1e-4
    assert found["velocity_error_median_km_s"]["value"] < 1e-6
    assert found["nees"]["reason"] == "no covariance of a true object was published"
    for tracklet in hand_made.owner:
        hand_made.write_opm(tracklet, np.zeros(6), None, t_s=61.0)
    found = hand_made.score()["states"]
    assert found["position_error_median_km"]["value"] < 0.5 * 1.5e-5 * 60.0**2 * 1.1
    for tracklet in hand_made.owner:
        hand_made.write_opm(tracklet, np.zeros(6), None, t_s=3600.0)
    assert hand_made.score()["states"]["position_error_median_km"]["value"] is None


def test_a_covariance_that_is_none_is_counted(hand_made: HandMade) -> None:
    wrong = np.diag([1.0, 1.0, 1.0, 1e-4, 1e-4, 1e-4])
    wrong[0, 1] = wrong[1, 0] = 1.5
    for tracklet in hand_made.owner:
        hand_made.write_opm(tracklet, np.zeros(6), wrong)
    found = hand_made.score()["states"]
    assert found["n_not_positive"]["value"] == 5
    assert found["nees"]["value"] is None


@pytest.mark.parametrize(("offset_km", "covered"), [(0.0, 1.0), (100.0, 0.0)])
def test_samples_cover_the_true_distance_or_not(hand_made: HandMade, offset_km: float, covered: float) -> None:
    """Clouds of 10 km around the true place, moved away from the camera by nothing and by ten times their width."""
    rng = np.random.default_rng(5)
    parts = []
    for tracklet, number in hand_made.owner.items():
        position, velocity = (v[0] for v in hand_made.orbits[number].at(np.array([0.6])))
        away = position - OBSERVER.at(np.array([0.6]))[0][0]
        away /= np.linalg.norm(away)
        cloud = Table({"tracklet_id": np.full(400, tracklet), "weight": rng.uniform(0.5, 1.5, 400)})
        cloud["t_tai_ns"] = EPOCH_TAI_NS + 600_000_000
        along = rng.normal(offset_km, 10.0, 400)
        for k, axis in enumerate("xyz"):
            cloud[f"{axis}_km"] = position[k] + along * away[k]
            cloud[f"v{axis}_km_s"] = velocity[k] * np.ones(400)
        parts.append(cloud)
    table = Table({name: np.concatenate([p[name] for p in parts]) for name in parts[0].colnames})
    table["x_km"].description = "geocentric position, GCRF"
    path = hand_made.folder / "products" / "orbit_samples.ecsv"
    table.write(path, format="ascii.ecsv")
    found = hand_made.score()["states"]
    assert found["samples_range_coverage_90"]["value"] == covered
    assert found["samples_share"]["value"] == 1.0
    assert found["samples_position_error_median_km"]["value"] == pytest.approx(offset_km, abs=1.5)
    table["x_km"].description = "geocentric position"
    table.write(path, format="ascii.ecsv", overwrite=True)
    assert "names none of the axes" in hand_made.score()["states"]["n_sampled"]["reason"]
    table.remove_column("x_km")
    table.write(path, format="ascii.ecsv", overwrite=True)
    assert hand_made.score()["states"]["samples_share"]["reason"] == "orbit_samples.ecsv: lacks the columns x_km"


def test_files_that_are_not_there_or_broken_are_reasons(hand_made: HandMade) -> None:
    section = hand_made.score()
    assert section["angles"]["along_rms_arcsec"]["reason"] == "no tracking data message was published (products/*.tdm)"
    assert section["observer"]["position_rms_m"]["reason"] == "no ephemeris of the camera was published (products/*.oem)"
    path = hand_made.write_tdm()
    hand_made.write_oem()
    lines = path.read_text().splitlines()
    first = next(k for k, line in enumerate(lines) if line.startswith("ANGLE_2"))
    path.write_text("\n".join([*lines[:first], "ANGLE_2 = 2027-01-29T00:00:00.000000 east", *lines[first + 1 :]]))
    section = hand_made.score()
    assert section["angles"]["n_angles"]["reason"] == f"tracklets.tdm line {first + 1}: expected 1 numbers"
    assert section["magnitudes"]["line_rms_mag"]["value"] is None
    assert value(section, "observer.position_rms_m") == pytest.approx(0.0, abs=0.02)


def test_false_tracklets_and_strange_epochs_are_counted_and_not_measured(hand_made: HandMade) -> None:
    hand_made.owner[100] = -1
    path = hand_made.write_tdm(name="early.tdm")
    hand_made.owner[100] = 0
    text = path.read_text().replace("T000000", "T000100")
    path.write_text(text)
    hand_made.owner[100] = -1
    hand_made.write_oem()
    section = hand_made.score()
    assert value(section, "angles.n_without_object") == 16
    assert value(section, "angles.n_angles") == 80
    check(section, {})
    path.write_text(path.read_text().replace("2027-01-29T00:00:01", "2027-01-29T00:10:01"))
    section = hand_made.score()
    assert 0 < value(section, "angles.n_outside_truth") < 64
    check(section, {})


def test_truth_that_knows_nothing_of_the_sky_is_named(hand_made: HandMade) -> None:
    """As tables of pixel positions from elsewhere are: what is missing is said, column by column."""
    hand_made.write_tdm()
    hand_made.write_oem(covariance=True)
    hand_made.write_opm(101, np.zeros(6), np.eye(6))
    for name in ("path_ra_deg", "path_dec_deg", "range_km"):
        hand_made.truth["streaks"][name] = np.nan
    for name in ("position_m", "velocity_m_s", "grid_row"):
        hand_made.truth["frames"][name] = np.nan
    section = published_products(
        hand_made.folder / "products", hand_made.streaks, hand_made.tracklets, hand_made.truth, hand_made.owner,
        dict.fromkeys(hand_made.truth_mag, np.nan),
    )  # fmt: skip
    assert "path_ra_deg" in section["angles"]["cross_rms_arcsec"]["reason"]
    assert "mag of truth/streaks.ecsv" in section["magnitudes"]["line_rms_mag"]["reason"]
    assert "position_m" in section["observer"]["position_rms_m"]["reason"]
    assert "range_km" in section["states"]["nees"]["reason"]
    assert value(section, "observer.implied_minus_quoted_rms_m_s") == pytest.approx(0.0, abs=1e-3)


def test_fewer_than_three_objects_have_no_interval_and_no_figure(tmp_path: Path) -> None:
    run = HandMade(tmp_path / "run", n_objects=2)
    run.write_tdm()
    found = run.score()["angles"]["along_rms_arcsec"]
    assert (found["value"], found["n"]) == (None, 32)
    assert "fewer than three objects" in found["reason"]


def test_the_same_files_give_the_same_section(hand_made: HandMade) -> None:
    """To the last digit, with intervals; the order in which a folder lists its files does not matter."""
    for tracklet in sorted(hand_made.owner, reverse=True):
        hand_made.write_opm(tracklet, np.full(6, 1e-3), np.eye(6) * 1e-6)
    hand_made.write_tdm(along=0.3)
    hand_made.write_oem(position_m=3.0, covariance=True)
    assert json.dumps(hand_made.score()) == json.dumps(hand_made.score())


def test_a_run_without_tracklets_is_scored(hand_made: HandMade) -> None:
    hand_made.write_tdm()
    hand_made.streaks["tracklet_id"] = -1
    assert value(hand_made.score(), "angles.differs_from_streaks") == 1.0
