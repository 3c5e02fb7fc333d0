"""`sboc objects light`: magnitudes of messages, and bins of trails in their place, become an object's character."""

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("sqlalchemy", reason="the store is on SQLAlchemy (extra `objects`)")

from astropy.table import Table

from ground.characterise.judge import Character
from ground.characterise.period import Period
from ground.characterise.reduced import PhaseFunction
from ground.determination.forces import ForceModel
from ground.determination.propagation import propagate
from ground.products.epochs import utc_text
from ground.sensor_bias.correct import calibration_text
from ground.sensor_bias.estimate import SensorBias
from ground.sky.sphere import spherical_deg
from ground.store.store import Association, ObjectStore, StoredOrbit
from sboc_e2e.cli.main import run
from sboc_e2e.objects.light import character_json
from sboc_e2e.objects.places import place_of_site

T0 = 25_000 * 86400 * 10**9
SITE = "28.3,-16.5,2390"
PERIOD_S = 21.0


def message(path: Path, number: int, t: np.ndarray, state: np.ndarray) -> None:
    """A pass of an object as a Tracking Data Message with a sine of PERIOD_S in its light."""
    line = propagate(state, T0, t, ForceModel(gravity_degree=8, radiation=0.02)).states[:, :3] - place_of_site(SITE)(t)
    ra, dec = spherical_deg(line / np.linalg.norm(line, axis=1, keepdims=True))
    rng = np.random.default_rng(number)
    mag = 12.0 + 0.5 * np.sin(2e-9 * np.pi * (t - T0) / PERIOD_S) + 0.05 * rng.standard_normal(len(t))
    meta = (
        "CCSDS_TDM_VERS = 2.0", "CREATION_DATE = 2026-01-01T00:00:00", "ORIGINATOR = TEST", "META_START", f"TRACK_ID = {number}",
        "TIME_SYSTEM = UTC", "PARTICIPANT_1 = S", f"PARTICIPANT_2 = O{number}", "MODE = SEQUENTIAL", "PATH = 2,1",
        "ANGLE_TYPE = RADEC", "REFERENCE_FRAME = EME2000", "TIMETAG_REF = RECEIVE", "META_STOP", "DATA_START",
    )  # fmt: skip
    rows = [
        f"{key} = {at} {x:.8f}"
        for at, a, d, m in zip(utc_text(t, 6), ra, dec, mag, strict=True)
        for key, x in (("ANGLE_1", a), ("ANGLE_2", d), ("MAG", m))
    ]
    path.write_text("\n".join([*meta, *rows, "DATA_STOP"]) + "\n")


def above_the_site() -> np.ndarray:
    """State of an object at T0, high above the site."""
    place = place_of_site(SITE)(np.array([T0]))[0]
    up = place / np.linalg.norm(place)
    east = np.cross([0.0, 0.0, 1.0], up)
    return np.concatenate([42_164.0 * up, 3.07 * east / np.linalg.norm(east)])


def stored_as_one(url: str, state: np.ndarray, tracklets: int) -> None:
    """Give the first tracklets of a store to an object BODY with an orbit."""
    store = ObjectStore(url)
    numbers = list(store.tracklets(T0 - 10**9, T0 + 10**15))
    with store.transaction() as writer:
        (own,) = writer.add_objects(["BODY"], T0)
        writer.add_orbits([
            StoredOrbit(
                object_id=own, epoch_tai_ns=T0, state=state, covariance=np.eye(6), made_tai_ns=T0, made_by="test",
                parameters={"radiation": 0.02}, chi2_nu=1.0,
            )
        ])  # fmt: skip
        writer.associate([
            Association(
                tracklet_id=n, object_id=own, probability=1.0, state="accepted", decided_by="test", decided_tai_ns=T0
            )
            for n in numbers[:tracklets]
        ])  # fmt: skip
    store.close()


def test_light_of_an_object_from_messages_and_trails(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    state = above_the_site()
    url, passes = str(tmp_path / "store.db"), [T0 + (k * 10_000 + 2 * np.arange(150)) * 10**9 for k in range(3)]
    paths = [tmp_path / f"{k}.tdm" for k in range(3)]
    for k, t in enumerate(passes):
        message(paths[k], k, t, state)
    names = [str(p) for p in paths]
    assert run(["objects", "observe", *names, "--site", SITE, "--store", url]) == 0
    stored_as_one(url, state, 2)
    capsys.readouterr()
    where = ["--site", SITE, "--store", url]
    assert run(["objects", "light", "BODY", *names, *where, "--mag-err", "0.05", "--out", str(tmp_path / "out")]) == 0
    assert "BODY: tumbling, 2 passes" in capsys.readouterr().out
    report = json.loads((tmp_path / "out" / "BODY.json").read_text())
    assert report["period"]["period_s"] == pytest.approx(PERIOD_S, rel=0.005)
    assert (tmp_path / "out" / "BODY.png").stat().st_size > 10_000
    # bins of trails instead of the magnitudes of the first message, constant ones
    table = tmp_path / "light_curves.ecsv"
    t = passes[0]
    mag = 12.0 + 0.05 * np.random.default_rng(1).standard_normal(len(t))
    columns = {"tracklet_id": np.zeros(len(t), dtype=int), "t_tai_ns": t, "mag": mag, "mag_err": np.full(len(t), 0.05)}
    Table(columns).write(table, format="ascii.ecsv")
    assert run(["objects", "light", "BODY", names[0], *where, "--trails", str(table)]) == 0
    assert "BODY: stable, 1 passes, 150 samples" in capsys.readouterr().out
    broken = tmp_path / "x.ecsv"
    broken.write_text("no table\n")
    for wrong, words in (
        (["BODY", *names], "give either --observer"),
        (["OTHER", *names, *where], "no object OTHER"),
        (["BODY", names[2], *where], "no magnitudes in the messages"),
        (["BODY", *names, *where, "--mag-err", "0"], "--mag-err: expected"),
        (["BODY", *names, *where, "--trails", str(table)], "one table for each message"),
        (["BODY", names[0], *where, "--trails", str(broken)], "expected a table with"),
        (["BODY", str(tmp_path / "none.tdm"), *where], "no such file"),
    ):
        assert run(["objects", "light", *wrong]) == 2
        assert words in capsys.readouterr().err


def test_tracklets_that_a_calibration_has_moved_are_the_same_tracklets(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """They are not stored again, with the calibration or without it, and their magnitudes are found."""
    state, url, night, file = above_the_site(), str(tmp_path / "store.db"), tmp_path / "night.tdm", tmp_path / "calibration.json"
    t = T0 + 2 * 10**9 * np.arange(150)
    message(night, 0, t, state)
    bias = SensorBias(
        first_tai_ns=T0, last_tai_ns=T0 + 10**12, time_s=0.02, east_arcsec=3.0, north_arcsec=-1.5,
        covariance=np.diag([1e-6, 1e-2, 1e-2]), noise_along_arcsec=1.0, noise_cross_arcsec=1.0, common_along_arcsec=0.1,
        common_cross_arcsec=0.1, along_arcsec=0.0, cross_arcsec=0.0, n_tracks=10, n_used=100, n_clipped=0, objects=("G01",),
        degrees=np.full(3, 20.0),
    )  # fmt: skip
    file.write_text(calibration_text("t", [bias]))
    where = ["--site", SITE, "--store", url]
    for more, new in ((["--calibration", str(file)], 1), ([], 0), (["--calibration", str(file)], 0)):
        assert run(["objects", "observe", str(night), *where, *more]) == 0
        assert f"1 tracklets read, {new} of them new, 1 in the store" in capsys.readouterr().out
    store = ObjectStore(url)
    (stored,) = store.tracklets(0, 2**62).values()
    store.close()
    assert int(stored.t_tai_ns[0]) == T0 - 20_000_000
    stored_as_one(url, state, 1)
    assert run(["objects", "light", "BODY", str(night), *where]) == 0
    assert "BODY: tumbling, 1 passes, 150 samples" in capsys.readouterr().out


def test_numbers_that_are_not_known_are_null_and_names_stay_as_they_are() -> None:
    nan = float("nan")
    period = Period(
        period_s=nan,
        period_err_s=float("inf"),
        best_s=3.0,
        false_alarm=1.0,
        string_alarm=1.0,
        left=1.0,
        amplitude_mag=0.1,
        terms=1,
    )
    phase = PhaseFunction(absolute_mag=nan, mirror_share=0.5, fitted=False)
    found = Character(kind="stable", period=period, phase=phase, flashes=0, scatter_mag=0.1, passes=1, samples=9)
    report = json.loads(character_json("NaNoSat-Infinity", found), parse_constant=pytest.fail)
    assert report["object"] == "NaNoSat-Infinity"
    assert (report["period"]["period_s"], report["period"]["period_err_s"], report["period"]["best_s"]) == (None, None, 3.0)
    assert report["phase"]["absolute_mag"] is None
