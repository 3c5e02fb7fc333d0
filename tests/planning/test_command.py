"""`sboc plan` as a user meets it."""

from pathlib import Path

import numpy as np
import pytest
from astropy.table import Table
from matplotlib.image import imread

from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd.errors import UserError
from sboc_e2e.planning import make_plan, read_request
from sboc_e2e.registry import Registry
from sboc_e2e.scenario import load
from simulator.chain import Simulator
from simulator.platform.earth import tai_ns_of_utc
from simulator.platform.pointing import scheduled_direction
from tests.element_lines import with_checksums

ELEMENTS = (
    "0 RING 1\n"
    "1 41866U 16071A   27028.50000000  .00000000  00000-0  00000-0 0  9990\n"
    "2 41866   0.0500  95.0000 0001000 180.0000 {0:8.4f}  1.00271000 40000\n"
)


def ring() -> str:
    """Thirty element sets."""
    return with_checksums("".join(ELEMENTS.format(k * 12.0) for k in range(30)))


def plan_file(folder: Path, *lines: str) -> str:
    (folder / "ring.3le").write_text(ring())
    path = folder / "ring.toml"
    text = ['scenario = "geo_survey"', 'objects = "ring.3le"', *lines, "[plan]", "days = 0.2", 'size = "4 m"']
    path.write_text("\n".join(text) + "\n")
    return str(path)


@pytest.mark.slow
def test_a_plan_is_a_folder_that_the_chain_can_fly(tmp_path: Path) -> None:
    request, path = read_request(plan_file(tmp_path))
    schedule = make_plan(request, path, tmp_path / "out", Registry())
    table = Table.read(tmp_path / "out" / "schedule.ecsv", format="ascii.ecsv")
    assert len(table) == len(schedule.visits) > 10
    assert Table.read(tmp_path / "out" / "windows.ecsv", format="ascii.ecsv").colnames == [
        "target",
        "name",
        "start_utc",
        "end_utc",
    ]
    flown = load(str(tmp_path / "out" / "scenario.toml"), registry=Registry())
    visits = flown.simulator.pointing.visits
    assert len(visits) == 3
    for k, visit in enumerate(visits):
        at = scheduled_direction(visits, 0.5 * (visit.start_s + visit.end_s))
        assert at == pytest.approx(np.array(schedule.visits[k].boresight), abs=1e-7)
    between = scheduled_direction(visits, 0.5 * (visits[0].end_s + visits[1].start_s))
    middle = visits[0].direction + visits[1].direction
    assert between == pytest.approx(middle / np.linalg.norm(middle), abs=1e-9)
    for picture in ("timeline.png", "sky.png"):
        shades = imread(tmp_path / "out" / picture)
        assert min(shades.shape[:2]) > 300
        assert shades[..., :3].std() > 0.02  # not blank


@pytest.mark.slow
def test_the_chain_sees_the_targets_that_a_visit_promises(tmp_path: Path) -> None:
    request, path = read_request(plan_file(tmp_path))
    schedule = make_plan(request, path, tmp_path / "out", Registry())
    flown = load(str(tmp_path / "out" / "scenario.toml"), registry=Registry())
    chain = Simulator(flown.simulator, seed=flown.seed, catalogue=StarCatalogue.embedded())
    first = flown.simulator.pointing.visits[0]
    _, truth = chain.frame(int(0.5 * (first.start_s + first.end_s) * flown.simulator.frame_rate_hz))
    # nothing flies but the targets; those of the visit lie in the circle inside the field, others may show in its corners
    seen = np.unique(truth.streaks["object_id"][truth.streaks["snr"] >= request.plan.faintest_snr])
    assert len(seen) >= len(schedule.visits[0].targets) > 0


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        (['goal = "tea"'], "goal"),
        (["least_mean_motion = 5.0"], "none of 30 element sets"),
        (['start_utc = "1950-01-01T00:00:00"'], "start_utc: .* lies outside the Earth-orientation data"),
    ],
)
def test_what_cannot_be_planned_is_said_in_one_line(tmp_path: Path, lines: list[str], expected: str) -> None:
    file = plan_file(tmp_path, *lines)
    with pytest.raises(UserError, match=expected) as found:
        make_plan(*read_request(file), tmp_path / "out", Registry())
    assert "\n" not in str(found.value)
    assert not (tmp_path / "out").exists()


def site_plan(folder: Path, calendar: str, scenario: str = "ground_site_tracking") -> str:
    (folder / "ring.3le").write_text(ring())
    (folder / "closed.csv").write_text(calendar)
    path = folder / "site.toml"
    text = [
        f'scenario = "{scenario}"', 'objects = "ring.3le"', 'weather = "closed.csv"', 'start_utc = "2027-01-28T12:00:00"',
        "[plan]", "days = 1.0", 'size = "4 m"', 'visit = "300 s"',
    ]  # fmt: skip
    path.write_text("\n".join(text) + "\n")
    return str(path)


@pytest.mark.slow
def test_a_closed_dome_ends_windows_to_a_second_and_takes_no_visits(tmp_path: Path) -> None:
    shut, opens = "2027-01-28T22:00:30", "2027-01-29T01:10:10"
    request, path = read_request(site_plan(tmp_path, f"start_utc,end_utc\n{shut},{opens}\n"))
    schedule = make_plan(request, path, tmp_path / "out", Registry())
    closed = [tai_ns_of_utc(text) for text in (shut, opens)]
    assert schedule.windows is not None
    starts, ends = schedule.windows.start_tai_ns, schedule.windows.end_tai_ns
    assert not ((starts < closed[1] - 10**9) & (ends > closed[0] + 10**9)).any()
    assert (np.abs(ends - closed[0]) < 1e9).any()
    assert (np.abs(starts - closed[1]) < 1e9).any()
    middles = np.array([(visit.start_tai_ns + visit.end_tai_ns) // 2 for visit in schedule.visits])
    assert (middles < closed[0]).any()
    assert (middles > closed[1]).any()
    assert not ((middles >= closed[0]) & (middles < closed[1])).any()
    assert schedule.forbidden["weather"] == pytest.approx((closed[1] - closed[0]) * 1e-9 / 86400.0, abs=300.0 / 86400.0)


@pytest.mark.parametrize(
    ("calendar", "scenario", "expected"),
    [
        ("start_utc,end_utc\n2027-01-28T22:00:00,2027-01-29T01:00:00\n", "geo_survey", "in orbit"),
        ("from,to\n1,2\n", "ground_site_tracking", "no column start_utc and end_utc"),
        ("start_utc,end_utc\n2027-01-29T22:00:00,2027-01-28T22:00:00\n", "ground_site_tracking", "row 1: .* is not after"),
        ("start_utc,end_utc\nsoon,2027-01-28T22:00:00\n", "ground_site_tracking", "row 1, start_utc: 'soon' is not"),
        ("", "ground_site_tracking", "has no column"),
        ("start_utc,end_utc\n2027-01-28T00:00:00,2027-01-30T00:00:00\n", "ground_site_tracking", "weather: the dome is closed"),
    ],
)
def test_a_calendar_that_is_none_is_refused_in_one_line(tmp_path: Path, calendar: str, scenario: str, expected: str) -> None:
    file = site_plan(tmp_path, calendar, scenario)
    with pytest.raises(UserError, match=expected) as found:
        make_plan(*read_request(file), tmp_path / "out", Registry())
    assert "\n" not in str(found.value)
    assert not (tmp_path / "out").exists()
