"""Schedules as CCSDS Pointing Request Messages, read by a reader that knows the standard only (CCSDS 509.0-B-1)."""

from pathlib import Path
from xml.etree import ElementTree as Xml

import numpy as np
import pytest
from astropy.time import Time

from ground.options import ProductOptions
from ground.planning.prm import prm_xml
from ground.planning.schedule import Schedule, Visit
from sboc_e2e.planning import make_plan, read_request
from sboc_e2e.registry import Registry
from sboc_e2e.scenario import load
from simulator.platform.rotation import matrix_of_boresight
from tests.planning.test_contradictions import folder_of


def child(parent: Xml.Element, path: str) -> Xml.Element:
    found = parent.findall(path)
    assert len(found) == 1, path
    return found[0]


def vector(element: Xml.Element, frame: str) -> np.ndarray:
    """A direction vector of table 3-10 in a frame."""
    assert element.get("frame") == frame
    numbers = [float(word) for word in (element.text or "").split()]
    if element.get("coord") == "raDec":
        assert element.get("units") == "deg"
        return direction(*numbers)
    assert element.get("coord") == "cartesian"
    return np.array(numbers) / np.linalg.norm(numbers)


def requests(message: bytes) -> list[tuple[Time, Time, np.ndarray]]:
    """Start, end and attitude (3, 3), root frame to spacecraft frame, of each block; the rules of sections 3.2 and 4.2 hold."""
    root = Xml.fromstring(message)  # noqa: S314  the message was written a moment ago
    assert root.tag == "prm"
    assert root.attrib == {"id": "CCSDS_PRM_VERS", "version": "1.0"}
    assert [part.tag for part in root] == ["header", "body"]
    assert {"CREATION_DATE", "ORIGINATOR"} <= {part.tag for part in root[0]}
    segment = child(root, "body/segment")
    assert [part.tag for part in segment] == ["metadata", "data"]
    metadata = child(segment, "metadata")
    assert child(metadata, "TIME_SYSTEM").text == "UTC"
    assert child(metadata, "OBJECT_ID").text
    assert child(metadata, "OBJECT_NAME").text
    frames = metadata.findall("definition/frame")
    base, body = str(frames[0].get("name")), str(frames[1].get("name"))
    assert [frame.get("baseFrame") for frame in frames] == ["none", base]
    block = child(metadata, "definition/block")
    named = {e.get("localName"): e.tag for e in block.iter() if e.get("localName")}
    timeline = child(segment, "data/timeline")
    assert timeline.get("frame") == body
    phase = child(block, "attitude/phaseAngle")
    out = []
    for request in timeline.findall("block"):
        assert request.get("ref") == block.get("name")
        assert {part.tag for part in request} == set(named)  # every parameter has a value (3.4.3.2.8)
        start, end = (Time(child(request, tag).text, scale="utc") for tag in ("blockStart", "blockEnd"))
        axis, towards = vector(child(request, "boresight"), body), vector(child(request, "target"), base)
        other, reference = vector(child(phase, "frameDir"), body), vector(child(phase, "baseFrameDir"), base)
        angle = np.radians(float(child(request, "phaseAngle").text or "nan"))
        assert child(request, "phaseAngle").get("units") == "deg"
        out.append((start, end, attitude(axis, towards, other, reference, angle)))
    assert all(out[k][1] <= out[k + 1][0] for k in range(len(out) - 1))  # chronological order
    assert Time(child(metadata, "START_TIME").text, scale="utc") == out[0][0]
    assert Time(child(metadata, "STOP_TIME").text, scale="utc") == out[-1][1]
    return out


def attitude(axis: np.ndarray, towards: np.ndarray, other: np.ndarray, reference: np.ndarray, angle: float) -> np.ndarray:
    """4.2.1 d: the angle from the projected reference to the projected axis, positive about the target's direction."""
    across = reference - (reference @ towards) * towards
    across /= np.linalg.norm(across)
    turned = np.cos(angle) * across + np.sin(angle) * np.cross(towards, across)
    mine = other - (other @ axis) * axis
    mine /= np.linalg.norm(mine)
    there = np.stack([towards, turned, np.cross(towards, turned)])
    here = np.stack([axis, mine, np.cross(axis, mine)])
    return np.asarray(here.T @ there)


def direction(ra_deg: float, dec_deg: float) -> np.ndarray:
    ra, dec = np.radians([ra_deg, dec_deg])
    return np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])


def test_the_reader_turns_a_spacecraft_as_annex_j_says() -> None:
    """Its inertial pointing: X to Vega, Y in the plane of Vega and Aldebaran at a phase of 0."""
    vega, aldebaran = direction(279.23334, 38.78361), direction(68.97917, 16.50917)
    turn = attitude(np.array([1.0, 0.0, 0.0]), vega, np.array([0.0, 1.0, 0.0]), aldebaran, 0.0)
    assert turn @ vega == pytest.approx([1.0, 0.0, 0.0], abs=1e-12)
    seen = turn @ aldebaran
    assert seen[2] == pytest.approx(0.0, abs=1e-12)
    assert seen[1] > 0.0


@pytest.mark.parametrize("roll_deg", [0.0, 30.0, 180.0, -75.0])
def test_a_message_asks_for_the_attitude_that_the_simulator_flies(roll_deg: float) -> None:
    rng = np.random.default_rng(1)
    start, visits = 10**18, []
    for k in range(20):
        place = rng.normal(size=3)
        place /= np.linalg.norm(place)
        begin = start + k * 120_000_000_000
        boresight = (float(place[0]), float(place[1]), float(place[2]))
        visits.append(Visit(start_tai_ns=begin, end_tai_ns=begin + 20_500_000_000, boresight=boresight, targets=(), gain=0.0))
    schedule = Schedule(visits=tuple(visits), gain_nats=np.zeros(0), forbidden={}, n_slots=20, notes=())
    found = requests(prm_xml(schedule, roll_deg, start, ProductOptions()))
    assert len(found) == 20
    for visit, (begins, ends, turn) in zip(visits, found, strict=True):
        want = matrix_of_boresight(np.array(visit.boresight), np.radians(roll_deg))
        assert np.degrees(np.abs(turn @ want.T - np.eye(3)).max()) * 3600.0 < 0.01  # arcsec
        assert (ends - begins).sec == pytest.approx(20.5, abs=1e-6)


@pytest.mark.slow
def test_a_plan_in_orbit_writes_a_message_and_one_on_the_ground_does_not(tmp_path: Path) -> None:
    folder = folder_of(tmp_path)
    request, path = read_request(str(folder / "orbit.toml"))
    schedule = make_plan(request, path, tmp_path / "out", Registry())
    found = requests((tmp_path / "out" / "prm.xml").read_bytes())
    assert len(found) == len(schedule.visits)
    flown = load(str(tmp_path / "out" / "scenario.toml"), registry=Registry()).simulator
    assert Time(flown.epoch_utc, scale="utc") == found[0][0]
    for visit, (begins, _, turn) in zip(flown.pointing.visits, found, strict=False):
        want = matrix_of_boresight(visit.direction, np.radians(flown.pointing.roll_deg))
        assert np.degrees(np.abs(turn @ want.T - np.eye(3)).max()) * 3600.0 < 0.01
        assert (begins - found[0][0]).sec == pytest.approx(visit.start_s, abs=2e-3)
    request, path = read_request(str(folder / "site.toml"))
    make_plan(request, path, tmp_path / "site", Registry())
    assert not (tmp_path / "site" / "prm.xml").exists()
