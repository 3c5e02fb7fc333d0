"""Objects with names in surveys: the same crossings as prediction, the same bytes again, a cloud by hand."""

import gzip
import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from sgp4 import omm
from sgp4.api import Satrec
from sgp4.exporter import export_tle

from sboc_e2e import scenario
from sboc_e2e.registry import Registry
from sboc_e2e.survey import response as responses
from sboc_e2e.survey.engine import run_survey
from sboc_e2e.survey.named import NamedPassages, cloud_of, named_page, seen_probability
from simulator.camera import Camera
from simulator.platform.kepler import elements_deg, state_of
from simulator.scene.cast import make_cast
from simulator.scene.prediction import Watch, predict_crossings
from simulator.scene.satellites import propagate, read_satellites
from simulator.survey.flight import Flight
from simulator.survey.named import fleet_block, series

SHARED = Path(__file__).resolve().parents[3] / "shared" / "data"
CATALOGUE = SHARED / "tle" / "catalogue_2022-01.3le.gz"
SIZES = SHARED / "orbits" / "hbr_mass_2026-06-01.csv.gz"
NOBODY = "population.classes=[]"
TARGET = 'objects.orbit=[{name="target", size="3 m", semi_major_axis="7171 km", inclination="98.6 deg", node="60 deg"}]'
BREAKUP = (
    'objects.breakup=[{object="target", cause="collision", when="1 h", mass="950 kg", projectile="10 kg", impact="10 km/s"}]'
)
SHELL = (
    'objects.walker=[{name="shell", satellites=264, planes=12, phasing=1, altitude="1200 km", inclination="87.9 deg", '
    'spread="180 deg"}]'
)


def load(*overrides: str) -> scenario.Scenario:
    return scenario.load("sso_antisun", registry=Registry(), overrides=[NOBODY, *overrides])


def flight(*overrides: str) -> Flight:
    found = load(*overrides)
    return Flight.of(found.simulator, found.seed)


@pytest.mark.slow  # 25 CPU-s: the only proof on a real catalogue
@pytest.mark.skipif(not CATALOGUE.is_file(), reason="needs ../shared/data/tle: a real catalogue")
def test_crossings_of_a_catalogue_are_those_of_the_prediction() -> None:
    f = flight(
        'epoch_utc="2022-01-22T06:00:00"', f'objects.satellites.file="{CATALOGUE}"', f'objects.satellites.sizes_file="{SIZES}"'
    )
    assert f.fleet is not None
    found = fleet_block(f, f.fleet, 0, 50_000.0)
    watch = Watch(
        observer=f.carrier.observer, attitude=f.carrier.attitude, projection=f.camera.projection, shape=f.camera.shape,
        epoch_tai_ns=f.carrier.epoch_tai_ns, from_s=600.0, to_s=1_200.0, farthest_km=50_000.0,
    )  # fmt: skip
    theirs = predict_crossings(list(f.fleet.satellites), watch).crossings
    number = {id(s): k for k, s in enumerate(f.fleet.satellites)}
    inside = [c for c in theirs if c.rate_deg_s > 0.11 and c.enter_s > 610.0 and c.leave_s < 1_190.0]
    assert len(inside) > 30
    time_s = found.at.time_s[found.passages.instant]
    for c in inside:
        mine = np.flatnonzero((found.object == number[id(c.satellite)]) & (time_s > c.enter_s - 6.0) & (time_s < c.leave_s + 6.0))
        assert len(mine) == 1
        # a frame belongs to the passage where its exposure touches it: half a second at both ends
        assert found.looks.frames[mine[0]] == pytest.approx(4.0 * (c.leave_s - c.enter_s) + 0.7, abs=1.2)
    known = {number[id(c.satellite)] for c in theirs}
    here = (time_s > 640.0) & (time_s < 1_160.0) & (found.passages.rate_deg_s > 0.12)
    assert set(found.object[here]) <= known


def test_the_series_of_a_minute_is_good_to_a_metre() -> None:
    position, velocity = state_of(elements_deg(6_900.0, 0.01, 50.0, 10.0, 20.0, 30.0))
    later, faster = state_of(elements_deg(6_900.0, 0.01, 50.0, 10.0, 20.0, 30.0), 30.0)
    place, speed = series(np.concatenate([position, velocity])[None], np.array([30.0]))
    assert np.linalg.norm(place[0] - later) < 1e-3
    assert np.linalg.norm(speed[0] - faster) < 1e-4


def test_pixels_show_the_members_that_the_survey_sees() -> None:
    f = flight(SHELL)
    assert f.fleet is not None
    found = fleet_block(f, f.fleet, 0, 50_000.0)
    first = int(np.argmin(found.at.time_s[found.passages.instant]))
    when = float(found.at.time_s[found.passages.instant[first]])
    options = load(SHELL, "objects.passing=[]").simulator
    camera: Camera = f.camera
    cast = make_cast(options.objects, options.population, f.carrier, camera, options.light, 1.0, when + 3.0)
    name = f.fleet.names[found.object[first]]
    assert name in {thing.identity.name for thing in cast.objects}


def test_element_sets_of_all_usual_files_are_the_same(tmp_path: Path) -> None:
    """TLE, 3LE and OMM in csv, json and xml, plain and gzipped; written by sgp4's exporter and by hand."""
    fields = {
        "OBJECT_NAME": "INVENTED", "OBJECT_ID": "2020-001A", "EPOCH": "2022-01-22T06:00:00.000000", "MEAN_MOTION": 14.5,
        "ECCENTRICITY": 0.001, "INCLINATION": 98.2, "RA_OF_ASC_NODE": 12.0, "ARG_OF_PERICENTER": 40.0, "MEAN_ANOMALY": 7.0,
        "EPHEMERIS_TYPE": 0, "CLASSIFICATION_TYPE": "U", "NORAD_CAT_ID": 90001, "ELEMENT_SET_NO": 999, "REV_AT_EPOCH": 1,
        "BSTAR": 1e-5, "MEAN_MOTION_DOT": 0.0, "MEAN_MOTION_DDOT": 0.0,
    }  # fmt: skip
    satellite = Satrec()
    omm.initialize(satellite, {name: str(value) for name, value in fields.items()})
    lines = "\n".join(export_tle(satellite)) + "\n"
    metadata = ("OBJECT_NAME", "OBJECT_ID")
    parameters = (
        "EPHEMERIS_TYPE", "CLASSIFICATION_TYPE", "NORAD_CAT_ID", "ELEMENT_SET_NO", "REV_AT_EPOCH", "BSTAR", "MEAN_MOTION_DOT",
        "MEAN_MOTION_DDOT",
    )  # fmt: skip

    def tags(names: Iterable[str]) -> str:
        return "".join(f"<{name}>{fields[name]}</{name}>" for name in names)

    mean = [name for name in fields if name not in (*metadata, *parameters)]
    texts = {
        "a.tle": lines,
        "a.3le": "0 INVENTED\n" + lines,
        "a.csv": ",".join(fields) + "\n" + ",".join(str(v) for v in fields.values()) + "\n",
        "a.json": json.dumps([fields]),
        "a.xml": f"<ndm><omm><body><segment><metadata>{tags(metadata)}</metadata><data><meanElements>{tags(mean)}</meanElements>"
        f"<tleParameters>{tags(parameters)}</tleParameters></data></segment></body></omm></ndm>",
    }
    found = {}
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
        (tmp_path / f"{name}.gz").write_bytes(gzip.compress(text.encode()))
        for file in (name, f"{name}.gz"):
            (read,) = read_satellites(tmp_path / file)
            assert name == "a.tle" or read.name == "INVENTED"
            found[file] = propagate([read], 2_021_600_000 * 10**9, np.zeros(1))[0]
    assert len(found) == 10
    for file, place in found.items():
        # lines of elements hold eight decimals of revolutions a day and four of degrees: these numbers are whole in both
        assert np.abs(place - found["a.csv"]).max() < 1e-6, file
    (tmp_path / "b.json").write_text("[1, 2]")
    with pytest.raises(Exception, match=r"element set 1 cannot be read"):
        read_satellites(tmp_path / "b.json")


def test_a_broken_object_is_there_before_and_its_pieces_after() -> None:
    f = flight(TARGET, BREAKUP)
    assert f.fleet is not None
    assert f.fleet.names[0] == "target"
    assert f.fleet.to_s[0] == 3_600.0
    assert (f.fleet.from_s[1:] == 3_600.0).all()
    # 885 pieces above 10 cm but those above 1 m, and the rest of the mass in large ones; some fall at once
    assert 780 < len(f.fleet) - 1 < 900
    rows = np.arange(len(f.fleet))
    place, _ = f.fleet.states(rows, np.array([3_600.0]))
    assert np.linalg.norm(place[1:, 0] - place[0, 0], axis=1) == pytest.approx(np.zeros(len(rows) - 1), abs=30.0)


@pytest.mark.slow
def test_a_survey_of_named_objects_repeats_and_reports(tmp_path: Path) -> None:
    found = load(SHELL, TARGET, BREAKUP)
    made = responses.read(responses.shipped(found), found)
    run_survey(found, made, 0.5, tmp_path / "one", here=True)
    run_survey(found, made, 0.25, tmp_path / "two", here=True)
    run_survey(found, made, 0.5, tmp_path / "two", here=True)
    for kind in ("tracklets", "truth", "sums"):
        for path in (tmp_path / "one" / kind).iterdir():
            assert path.read_bytes() == (tmp_path / "two" / kind / path.name).read_bytes()
    f = Flight.of(found.simulator, found.seed)
    assert f.fleet is not None
    page = named_page(tmp_path / "one", f.fleet, found.simulator.objects.breakup, 1)
    assert "| walker | 264 |" in page
    assert "Break-up of target, 1 h after the epoch" in page
    from pyarrow import parquet

    table = parquet.read_table(tmp_path / "one" / "truth" / "000000.parquet", use_threads=False).to_pydict()
    assert set(table["kind"]) <= {3, 4, 5}
    assert {f.fleet.names[k].split("-")[0].split(" ")[0] for k in table["object"]} <= {"shell", "target"}


def test_a_cloud_of_two_pieces_by_hand() -> None:
    found = NamedPassages(
        object=np.array([1, 2, 1]), time_s=np.array([3_600.0, 7_200.0, 10_800.0]), linked=np.array([0.5, 0.5, 0.5]), too_slow=0,
        span_s=1.0,
    )  # fmt: skip
    assert seen_probability(found, 4) == pytest.approx([0.0, 0.75, 0.5, 0.0])
    cloud = cloud_of(found, np.array([1, 2, 3]), 0.0, np.random.default_rng(1))
    # 0.5 after 1 h, 0.75 after 2 h, 0.875 after 3 h: the last twentieth never comes
    assert cloud.first_h[0] == 1.0
    assert cloud.first_h[1] in (1.0, 2.0)
    assert cloud.first_h[2] == np.inf
    assert (cloud.passing, cloud.drawn) == (2, 3)
    assert cloud.pieces == (0.0, 1.0, 2.0)
