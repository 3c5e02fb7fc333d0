"""OEM, OPM and samples as readers that share nothing with the writers get them: ccsds-ndm, and lines split at the equals sign."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import erfa
import numpy as np
import pytest
from astropy.table import vstack
from astropy.time import Time

from ground.options import ProductOptions
from ground.orbit import RangeScan
from ground.products.lacking import lacking
from ground.products.oem import oem_text
from ground.products.opm import opm_text
from ground.products.orbit_samples import orbit_samples_tables
from ground.records import GroundProducts
from sboc_e2e.icd.products import OrbitEstimate, Tracklet
from tests.orbit.encounters import T0_NS, draw_encounters, observed
from tests.orbit.test_observer import errors, headers_of, on_the_ground, orbiting
from tests.products.ndm_reader import read


def numbers(record: Any, names: tuple[str, ...]) -> np.ndarray:
    """Values of fields that the reader wraps with their units."""
    return np.array([float(getattr(record, name).value) for name in names])


PLACE = ("x", "y", "z", "x_dot", "y_dot", "z_dot")
AXES = ("x", "y", "z", "x_dot", "y_dot", "z_dot")


def covariance_of(record: Any) -> np.ndarray:
    """Matrix (6, 6) of a reader's 21 fields."""
    out = np.zeros((6, 6))
    for i, one in enumerate(AXES):
        for j, two in enumerate(AXES[: i + 1]):
            out[i, j] = out[j, i] = float(getattr(record, f"c{one}_{two}").value)
    return out


def bias_matrix() -> np.ndarray:
    """Frame bias from ERFA's angles of 2000 (Chapront et al. 2002), not from its matrix of 2006."""
    dpsibi, depsbi, dra = erfa.bi00()
    eps0 = np.radians(84381.448 / 3600.0)
    x, y = dpsibi * np.sin(eps0), depsbi
    return np.array([[1.0, dra, -x], [-dra, 1.0, -y], [x, y, 1.0]])


@pytest.mark.parametrize("path", [orbiting, on_the_ground])
def test_observer_message_is_a_smooth_orbit_with_covariance(tmp_path: Path, path: Any) -> None:
    """Of 80 fixes of 10 m: implied minus quoted velocity below 0.05 m/s rms (fixes: tens of m/s), truth within 5 sigma."""
    rng = np.random.default_rng(1)
    t_s = 0.25 * np.arange(80)
    headers = headers_of(path(t_s), t_s, errors(80, 0.7, rng))
    text = oem_text(headers, ProductOptions())
    assert text is not None
    (segment,) = read(text, tmp_path).body.segment
    vectors = segment.data.state_vector
    states = np.array([numbers(v, PLACE) for v in vectors])
    epochs = Time([str(v.epoch) for v in vectors], format="isot", scale="utc")
    step_s = np.diff(epochs.tai.jd1 - epochs.tai.jd1[0] + (epochs.tai.jd2 - epochs.tai.jd2[0])) * 86400.0
    assert np.abs(step_s - 1.0).max() < 1e-6
    implied = (states[2:, :3] - states[:-2, :3]) / 2.0
    assert np.sqrt(((implied - states[1:-1, 3:]) ** 2).sum(axis=1).mean()) < 5e-5
    # derivative of the Hermite polynomial in the middle of a step: (3 (x1 - x0) / h - (v0 + v1) / 2) / 2
    middle = 1.5 * np.diff(states[:, :3], axis=0) - 0.25 * (states[1:, 3:] + states[:-1, 3:])
    assert np.sqrt(((middle - 0.5 * (states[1:, 3:] + states[:-1, 3:])) ** 2).sum(axis=1).mean()) < 5e-5
    first_s = (Time(epochs[0].isot, scale="utc").tai.jd1 - 2436204.5) * 86400.0
    at = first_s + epochs[0].tai.jd2 * 86400.0 - T0_NS * 1e-9
    truth = path(np.round(at + np.arange(len(states)), 6))
    truth = np.hstack([truth[:, :3] @ bias_matrix().T, truth[:, 3:] @ bias_matrix().T])
    given = segment.data.covariance_matrix
    assert len(given) >= 3
    for matrix in given:
        k = [str(v.epoch) for v in vectors].index(str(matrix.epoch))
        covariance = covariance_of(matrix)
        assert np.linalg.eigvalsh(covariance).min() > 0.0
        assert (np.abs(states[k] - truth[k]) < 5.0 * np.sqrt(np.diag(covariance)) + 1e-5).all()
    frames_end = max(h.t_start_tai_ns + h.exposure_ns for h in headers)
    assert at <= 0.0
    assert at + len(states) - 1 >= (frames_end - T0_NS) * 1e-9
    assert "Smoothed orbit of the observer" in text
    assert ("turns with the Earth" in text) == (path is on_the_ground)


def estimated(n: int) -> tuple[list[OrbitEstimate], list[Tracklet], tuple]:
    """Estimates of encounters that share nothing but the generator; headers of the last."""
    rng = np.random.default_rng(11)
    estimates, tracklets, headers = [], [], ()
    for k, one in enumerate(draw_encounters(n, rng, population="natural", pool=60_000, passes=True)):
        tracklet, headers = observed(one, rng, steady=0.7)
        tracklet = replace(tracklet, tracklet_id=k)
        tracklets.append(tracklet)
        estimates.append(RangeScan(albedo_sigma_ln=0.0).estimate(tracklet, headers))
    return estimates, tracklets, headers


def test_state_messages_carry_a_covariance_where_it_is_honest(tmp_path: Path) -> None:
    """Both kinds occur; a plain parser and ccsds-ndm agree; states and covariances are the estimate's, turned by 23 mas."""
    estimates, _, _ = estimated(10)
    kinds = set()
    for estimate in estimates:
        state = estimate.state
        assert state is not None
        kinds.add(state.gaussian)
        text = opm_text(estimate, ProductOptions(), T0_NS)
        assert text is not None
        # the longest line that CCSDS 502.0-B allows in KVN
        assert max(map(len, text.splitlines())) <= 254
        plain = dict(re.findall(r"^(\w+) = (.*)$", text, flags=re.MULTILINE))
        data = read(text, tmp_path).body.segment.data
        vector = numbers(data.state_vector, PLACE)
        assert vector.tolist() == [float(plain[name.upper()]) for name in PLACE]
        assert plain["REF_FRAME"] == "EME2000"
        assert plain["OBJECT_NAME"] == f"UCT-{estimate.tracklet_id:06d}"
        radius, speed = np.linalg.norm(vector[:3]), np.linalg.norm(vector[3:])
        a_km = 1.0 / (2.0 / radius - speed**2 / 398600.4418)
        assert float(plain["SEMI_MAJOR_AXIS"]) == pytest.approx(a_km, rel=1e-6)
        assert {"RA_OF_ASC_NODE", "ARG_OF_PERICENTER", "MEAN_ANOMALY"} <= plain.keys()
        both = np.kron(np.eye(2), bias_matrix())
        if state.gaussian:
            got = covariance_of(data.covariance_matrix)
            want = both @ state.covariance @ both.T
            scale = np.sqrt(np.diag(want))
            assert np.abs((got - want) / np.outer(scale, scale)).max() < 1e-6
            assert np.abs(vector - both @ state.mean).max() < 2e-6
        else:
            assert data.covariance_matrix is None
            assert "NOT Gaussian" in text
            assert "orbit_samples.ecsv" in text
            assert np.abs(vector - state.sample_state @ both.T).max(axis=1).min() < 2e-6
    assert kinds == {True, False}


def test_samples_are_the_posterior() -> None:
    """Weights of each tracklet sum to one; mean and range of the rows are the estimate's."""
    estimates, _, headers = estimated(3)
    table = vstack(list(orbit_samples_tables(estimates, headers)), metadata_conflicts="silent")
    for estimate in estimates:
        rows = table[table["tracklet_id"] == estimate.tracklet_id]
        state = estimate.state
        assert state is not None
        assert float(rows["weight"].sum()) == pytest.approx(1.0)
        mean = [float((rows["weight"] * rows[name]).sum()) for name in ("x_km", "y_km", "z_km", "vx_km_s", "vy_km_s", "vz_km_s")]
        both = np.kron(np.eye(2), bias_matrix())
        assert (np.abs(np.array(mean) - both @ state.mean) < np.sqrt(np.diag(state.covariance))).all()
        assert estimate.range_km[0] < np.median(rows["range_km"]) < estimate.range_km[2]
        assert (rows["t_tai_ns"] == state.t_tai_ns).all()
    assert len(next(orbit_samples_tables([], headers))) == 0


def products_of(tracklets: list[Tracklet], headers: Any, estimates: list[OrbitEstimate]) -> GroundProducts:
    return GroundProducts(
        headers=headers, solutions=(), photometry=(), streaks=(), tracklets=tuple(tracklets), members=(), orbits=tuple(estimates)
    )


def test_what_is_lacking_is_said() -> None:
    """No GPS, no frame, one frame, no sense of motion: a sentence each; with everything, none of these."""
    estimates, tracklets, headers = estimated(1)
    whole = lacking(products_of(tracklets, headers, estimates), orbits_wanted=True)
    assert not any("observer" in line or "one frame" in line for line in whole)
    blind = tuple(replace(h, observer=None) for h in headers)
    nothing = RangeScan().estimate(tracklets[0], blind)
    assert nothing.state is None
    assert nothing.lacks == "no state of the observer in the run"
    assert opm_text(nothing, ProductOptions(), T0_NS) is None
    lacks = "\n".join(lacking(products_of(tracklets, blind, [nothing]), orbits_wanted=True))
    assert "observer.oem is not written" in lacks
    assert "no orbit state, no state of the observer in the run: tracklets 0" in lacks
    far = [replace(h, observer=replace(h.observer, tai_ns=h.observer.tai_ns + 10**13)) for h in headers]
    assert RangeScan().estimate(tracklets[0], far).lacks == "no state of the observer near its epochs"
    assert lacking(products_of([], (), []), orbits_wanted=True) == [
        "no frame could be built: tables have no rows, no message is written"
    ]
    single = replace(tracklets[0], frames=np.array([0]), direction_resolved=False)
    lacks = "\n".join(lacking(products_of([single], headers[:1], []), orbits_wanted=True))
    assert "one frame only" in lacks
    assert "the sense of motion is unknown: tracklets 0" in lacks
    assert "seen in one frame only: tracklets 0" in lacks
