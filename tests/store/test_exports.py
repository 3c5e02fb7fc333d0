"""What leaves the store is read by others: oem, sgp4, ccsds-ndm, pyarrow; and the commands."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

pytest.importorskip("satkit", reason="satkit propagates orbits (extra `objects`)")
pytest.importorskip("sqlalchemy", reason="the store is on SQLAlchemy (extra `objects`)")

from sqlalchemy import text as sql

from ground.determination.forces import ForceModel
from ground.determination.precise import free_orbit, read_sp3
from ground.determination.propagation import propagate
from ground.orbit.ephemerides import read_oem
from ground.orbit.reference import teme_to_gcrs
from ground.store.exports import mean_elements, messages, oem, omm, opm
from ground.store.forces import carried, forces_of
from ground.store.store import ObjectStore, StoredOrbit
from ground.upkeep.new_objects import merges_of
from ground.upkeep.view import UpkeepOptions, known_orbit, position_error_km
from sboc_e2e.cli.main import run
from sboc_e2e.icd.errors import UserError
from sboc_e2e.objects.catalogue import add_precise
from tests.conjunctions.reference import folder
from tests.determination.burnt_table import burnt_table
from tests.determination.test_propagation import integrated_noise

T0 = 2_150_000_000_000_000_000


def orbit() -> StoredOrbit:
    return StoredOrbit(
        object_id=1, epoch_tai_ns=T0, state=np.array([42000.0, 900.0, 100.0, -0.1, 3.05, 0.3]),
        covariance=np.diag([1e-2] * 3 + [1e-10] * 3), made_tai_ns=T0, made_by="batch", n_used=40, chi2_nu=1.0,
    )  # fmt: skip


def test_an_oem_is_the_orbit() -> None:
    (read,) = read_oem(oem(orbit(), "G", "TEST", 0.5))
    expected = propagate(orbit().state, T0, read.t_tai_ns, ForceModel()).states
    # six digits of a km, microseconds of an epoch
    np.testing.assert_allclose(read.position_km, expected[:, :3], atol=1e-5)


def test_the_shortest_oem_can_be_interpolated() -> None:
    text = oem(orbit(), "G", "TEST", 0.001)
    (read,) = read_oem(text)
    assert "INTERPOLATION_DEGREE = 7" in text
    assert len(read.t_tai_ns) == 8  # CCSDS 502.0-B-2, 5.2.4.4: a degree of 7 needs eight states
    epochs = [line for line in text.splitlines() if line.startswith("EPOCH = ")]
    assert len(epochs) == len(set(epochs)) == 2


def test_an_oem_of_an_orbit_of_tracklets_has_the_forces_of_its_fit() -> None:
    """Fits to tracklets have gravity to degree 8; at 1000 km, degree 20 is elsewhere after half a day."""
    low = replace(orbit(), state=np.array([7378.0, 0.0, 0.0, 0.0, 1.2, 7.25]), parameters={"radiation": 0.03})
    (read,) = read_oem(oem(low, "G", "TEST", 0.5))
    expected = propagate(low.state, T0, read.t_tai_ns, ForceModel(gravity_degree=8, radiation=0.03)).states
    # integrations with and without partials differ by 0.1 m, the two degrees by 100 m and more
    np.testing.assert_allclose(read.position_km, expected[:, :3], atol=1e-3)


def of_two_days() -> StoredOrbit:
    """An orbit from six half hours of directions in 2.2 days: radiation pressure and the state are known together only."""
    forces = ForceModel(gravity_degree=8, radiation=0.02)
    hours = np.array([0.0, 3.0, 24.0, 27.0, 48.0, 53.0])
    t = T0 + np.round((hours[:, None] + [0.0, 0.25, 0.5]).reshape(-1) * 3600e9).astype(np.int64)
    arc = propagate(orbit().state, T0, t, forces, parameters=("radiation",), partials=True)
    normal = np.diag([0.0] * 6 + [0.01**-2])
    for state, partials in zip(arc.states, arc.partials, strict=True):
        line = state[:3] / np.linalg.norm(state[:3])
        # half an arcsecond across the line from the Earth's centre
        across = (np.eye(3) - np.outer(line, line)) @ partials[:3] / (2.4e-6 * np.linalg.norm(state[:3]))
        normal += across.T @ across
    scale = np.sqrt(np.diag(normal))
    covariance = np.linalg.inv(normal / np.outer(scale, scale)) / np.outer(scale, scale)
    return replace(orbit(), parameters={"radiation": 0.02}, covariance=0.5 * (covariance + covariance.T))


def by_whole_propagations(given: StoredOrbit, t_tai_ns: int) -> np.ndarray:
    """Covariance (6, 6) at an epoch from orbits moved along each axis of the covariance (7, 7), radiation pressure included."""
    scale = np.sqrt(np.diag(given.covariance))
    value, axes = np.linalg.eigh(given.covariance / np.outer(scale, scale))
    out = np.zeros((6, 6))
    for size, axis in zip(np.sqrt(np.maximum(value, 0.0)), axes.T, strict=True):
        ends = []
        for sign in (-1.0, 1.0):
            moved = np.append(given.state, 0.02) + sign * size * scale * axis
            forces = ForceModel(gravity_degree=8, radiation=float(moved[6]))
            ends.append(propagate(moved[:6], T0, np.array([t_tai_ns]), forces).states[0])
        half = 0.5 * (ends[1] - ends[0])
        out += np.outer(half, half)
    return out


def test_covariances_are_carried_with_the_parameters_of_the_fit() -> None:
    """In an OEM, in the error of place, and where a new orbit is held against a known one.

    So is the noise of what the forces leave out: 7 km in a month, here by dP/dt = F P + P F^T + q G G^T of two bodies.
    """
    given, days = of_two_days(), 30
    end = T0 + days * 86_400 * 10**9
    without = by_whole_propagations(given, end)
    expected = without + integrated_noise(given.state, days, 1e-18)[1]
    sigma_km = float(np.sqrt(np.trace(expected[:3, :3])))
    # the state alone, as if it and the light's push were known apart
    alone = propagate(given.state, T0, np.array([end]), forces_of(given), partials=True).partials[0]
    assert np.trace((alone @ given.state_covariance @ alone.T)[:3, :3]) > 1.5**2 * np.trace(without[:3, :3])
    assert sigma_km > 2.5 * np.sqrt(np.trace(without[:3, :3]))
    assert position_error_km(given, end) == pytest.approx(sigma_km, rel=0.01)
    text = oem(given, "G", "TEST", float(days))
    rows = text.split("COV_REF_FRAME = EME2000\n")[2].splitlines()
    assert np.sqrt(sum(float(rows[k].split()[k]) for k in range(3))) == pytest.approx(sigma_km, rel=0.01)
    # new orbits that are four and six sigma off along the least certain direction that the parameters leave
    _, axes = np.linalg.eigh(expected[:3, :3])
    sharp = np.diag([1e-2] * 3 + [1e-10] * 3)
    states, covariances = carried(given, np.array([end]))
    total = covariances[0] + sharp
    for sigmas, merged in ((4.0, {0: 1}), (6.0, {})):
        off = total[:, :3] @ axes[:, 2]
        off *= sigmas / np.sqrt(off @ np.linalg.solve(total, off))
        assert off @ np.linalg.solve(without + sharp, off) > 25.0
        new = SimpleNamespace(solution=SimpleNamespace(state=states[0] + off, t0_tai_ns=end, covariance=sharp))
        found, _ = merges_of([((1, 2), cast(Any, new))], {1: given}, UpkeepOptions())
        assert found == merged


def test_an_orbit_that_no_message_describes_is_left_out_and_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    url, out = str(tmp_path / "o.db"), tmp_path / "out"
    store = ObjectStore(url)
    with store.transaction() as writer:
        numbers = writer.add_objects(["G", "AWAY"], T0)
        # the second leaves the Earth
        away = replace(orbit(), state=np.array([42000.0, 900.0, 100.0, 0.0, 6.0, 0.3]))
        writer.add_orbits([replace(one, object_id=k) for one, k in zip((orbit(), away), numbers, strict=True)])
    assert run(["objects", "export", "--as", "omm", "--out", str(out), "--store", url]) == 0
    first, second = capsys.readouterr().out.splitlines()
    assert first == f"1 files in {out}"
    assert second.startswith("left out: AWAY: OMM: ")
    assert [path.name for path in out.iterdir()] == [f"{numbers[0]:06d}.omm"]
    with store.transaction() as writer:
        writer.set_status(numbers[0], "retired", by="t", at_tai_ns=T0, why="t")
    store.close()
    assert run(["objects", "export", "--as", "omm", "--out", str(out), "--store", url]) == 2
    assert "export: no orbit is written: AWAY: OMM: " in capsys.readouterr().err
    assert run(["objects", "export", "--as", "oem", "--days", "31", "--out", str(out), "--store", url]) == 2
    assert "OEM: days: expected" in capsys.readouterr().err


def test_an_orbit_of_a_precise_ephemeris_follows_its_table(tmp_path: Path) -> None:
    """In all that carries orbits: empirical accelerations hold the light, and no other radiation pressure is added."""
    source, url = folder("sp3") / "gbm18432.sp3.Z", str(tmp_path / "o.db")
    add_precise(url, source, ["G01"])
    store = ObjectStore(url)
    (stored,) = store.orbits()
    store.close()
    table = read_sp3(source.read_bytes(), source.name)["G01"].positions(1e-4)
    for forces in (forces_of(stored), known_orbit(stored, UpkeepOptions()).forces):
        states = propagate(stored.state, stored.epoch_tai_ns, table.t_tai_ns, forces).states
        # the fit of a day misses the table by centimetres; radiation pressure counted twice misses it by 100 m and more
        np.testing.assert_allclose(states[:, :3], table.position_km, atol=1e-3)


def test_orbits_of_precise_ephemerides_know_their_error() -> None:
    """Half a day is fitted; the other half of GFZ's table, 3 to 12 h later, is the truth."""
    source, squares, sigmas = folder("sp3") / "gbm18432.sp3.Z", [], []
    table = read_sp3(source.read_bytes(), source.name)
    for name in [k for k in sorted(table) if k.startswith("G")][:12]:
        whole = table[name]
        half = len(whole.t_tai_ns) // 2
        first = replace(whole, t_tai_ns=whole.t_tai_ns[:half], itrs_km=whole.itrs_km[:half])
        fit = free_orbit(first, ForceModel(gravity_degree=20))
        stored = StoredOrbit(
            object_id=1, epoch_tai_ns=fit.t0_tai_ns, state=fit.state, covariance=fit.covariance, made_tai_ns=T0, made_by=name,
            parameters={p: fit.forces.value_of(p) for p in fit.parameters}, chi2_nu=fit.chi2_nu,
        )  # fmt: skip
        chosen = np.array([half + 36, 2 * half - 1])
        states, covariances = carried(stored, whole.t_tai_ns[chosen])
        away = states[:, :3] - whole.positions(1e-4).position_km[chosen]
        squares.append(np.einsum("ni,ni->n", away, np.linalg.solve(covariances[:, :3, :3], away[:, :, None])[:, :, 0]) / 3.0)
        sigmas.append(np.sqrt(np.trace(covariances[-1, :3, :3])))
    # the errors of a satellite at both epochs are one: 36 numbers, and tails that are no Gaussian's
    assert 0.4 < np.mean(squares) < 2.0
    assert max(sigmas) < 0.02


def test_messages_are_taken_by_an_independent_reader() -> None:
    ndm = pytest.importorskip("ccsds_ndm.ndm_io", reason="ccsds-ndm is the oracle")
    for message in (opm(orbit(), "G", "TEST"), oem(orbit(), "G", "TEST", 0.1), omm(orbit(), "G", "TEST")):
        assert ndm.NdmIo().from_string(message) is not None


def test_mean_elements_follow_the_orbit() -> None:
    mean, away = mean_elements(orbit())
    assert away < 5.0
    failed, place, _ = mean.sgp4(*_utc(T0))
    assert failed == 0
    assert np.linalg.norm(teme_to_gcrs(T0) @ np.array(place) - orbit().state[:3]) < 5.0


def _utc(t: int) -> tuple[float, float]:
    from ground.orbit.reference import utc_jd

    day, fraction = utc_jd([t])
    return float(day[0]), float(fraction[0])


def test_the_commands_fill_show_and_export(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    store = str(tmp_path / "o.db")
    source = folder("sp3") / "gbm18432.sp3.Z"
    assert run(["objects", "add", str(source), "--object", "G01", "--object", "E11", "--store", store]) == 0
    assert run(["objects", "list", "--store", store]) == 0
    printed = capsys.readouterr().out
    assert "2 objects" in printed
    assert "E11" in printed
    for kind, files in (("opm", 2), ("oem", 2), ("omm", 2), ("parquet", 2)):
        out = tmp_path / kind
        assert run(["objects", "export", "--as", kind, "--out", str(out), "--store", store]) == 0
        assert len(list(out.iterdir())) == files
    again = ObjectStore(store)
    assert len(again.orbits()) == 2
    again.close()


@pytest.mark.parametrize("status", ["lost", "retired"])
def test_an_ephemeris_makes_its_object_active(tmp_path: Path, status: str) -> None:
    url, source = str(tmp_path / "o.db"), folder("sp3") / "gbm18432.sp3.Z"
    add_precise(url, source, ["G01"])
    store = ObjectStore(url)
    with store.transaction() as writer:
        writer.set_status(1, status, by="t", at_tai_ns=T0, why="t")
    (line,) = add_precise(url, source, ["G01"])
    assert line.endswith(f", {status} until now")
    assert [row["status"] for row in store.objects()] == ["active"]
    assert store.decisions()[-1]["detail"]["why"] == "a precise ephemeris gives its orbit"
    assert len(messages(store, "opm", "T", 1.0)[0]) == 1
    store.close()


def test_an_ephemeris_of_a_merged_object_is_of_the_one_that_it_is(tmp_path: Path) -> None:
    url, source = str(tmp_path / "o.db"), folder("sp3") / "gbm18432.sp3.Z"
    add_precise(url, source, ["G01"])
    store = ObjectStore(url)
    with store.transaction() as writer:
        (kept,) = writer.add_objects(["KEPT"], T0)
        writer.merge(kept, 1, by="t", at_tai_ns=T0, why="t")
    (line,) = add_precise(url, source, ["G01"])
    assert line.startswith("G01 (merged into KEPT): 288 places")
    assert [o.object_id for o in store.orbits()] == [1, kept]
    with store.engine.begin() as connection:
        # as stores of version 1 have it
        connection.execute(sql("UPDATE objects SET merged_into = NULL"))
    with pytest.raises(UserError, match="G01: it was merged, and the store does not say into what"):
        add_precise(url, source, ["G01"])
    store.close()


def test_an_older_ephemeris_replaces_no_newer_orbit(tmp_path: Path) -> None:
    """Of a table, made at its last place, and of tracklets, whose epoch is the last one's."""
    url, source = str(tmp_path / "o.db"), folder("sp3") / "gbm18432.sp3.Z"
    last = int(read_sp3(source.read_bytes(), source.name)["G01"].t_tai_ns[-1])
    later = replace(orbit(), epoch_tai_ns=last - 10**9, made_tai_ns=last + 1)
    seen = replace(orbit(), epoch_tai_ns=last - 1, made_tai_ns=last + 10**15, parameters={"radiation": 0.02})
    store = ObjectStore(url)
    with store.transaction() as writer:
        numbers = writer.add_objects(["G01", "E11", "G02"], T0)
        chosen = (later, replace(seen, epoch_tai_ns=last + 1), seen)
        writer.add_orbits([replace(one, object_id=k) for k, one in zip(numbers, chosen, strict=True)])
    added, *left = add_precise(url, source, ["G01", "E11", "G02"])
    assert added.startswith("G02: 288 places")
    assert [line.split(" the table ends at ")[0] for line in left] == ["left out: G01:", "left out: E11:"]
    assert [o.made_by.startswith("fit to") for o in store.orbits()] == [False, False, True]
    with pytest.raises(UserError, match="no object is added: G01: the table ends at"):
        add_precise(url, source, ["G01"])
    store.close()


def test_objects_that_left_their_orbit_are_not_added_and_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    store, source = str(tmp_path / "o.db"), str(burnt_table("G01", tmp_path / "day.sp3"))
    assert run(["objects", "add", source, "--object", "G01", "--object", "E11", "--store", store]) == 0
    first, second = capsys.readouterr().out.splitlines()
    assert first.startswith("E11: 288 places")
    assert second.startswith("left out: G01: no free orbit fits the places")
    filled = ObjectStore(store)
    assert [row["name"] for row in filled.objects()] == ["E11"]
    filled.close()
    assert run(["objects", "add", source, "--object", "G01", "--store", store]) == 2
    assert "day.sp3: no object is added: G01: no free orbit" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["list", "--store", "none.db"], "no such store"),
        (["add", "none.sp3"], "no such file"),
        (["add", "x.txt"], "neither SP3"),
        (["export", "--as", "csv", "--out", "o", "--store", "x.txt"], "--as: expected opm"),
    ],
)
def test_the_commands_say_what_is_wrong(
    arguments: list[str], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "x.txt").write_text("text")
    assert run(["objects", *arguments]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
