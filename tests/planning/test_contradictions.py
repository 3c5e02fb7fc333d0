"""Plans and surveys that cannot be: one line that names the key, what it asks and what there is; nothing is left on the disk."""

import gzip
import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from astropy.table import Table

from sboc_e2e.cli.main import run
from sboc_e2e.planning import make_plan, read_request
from sboc_e2e.registry import Registry
from tests.element_lines import with_checksums

ELEMENTS = (
    "0 RING {1}\n"
    "1 {2:05d}U 16071A   27028.50000000  .00000000  00000-0  00000-0 0  9990\n"
    "2 {2:05d}   0.0500  95.0000 0001000 180.0000 {0:8.4f}  1.00271000 40000\n"
)
DECAYED = (
    "0 GONE\n"
    "1 00007U 16071A   25028.50000000  .90000000  00000-0  90000-1 0  9990\n"
    "2 00007  51.0000  95.0000 0001000 180.0000  10.0000 16.30000000 40000\n"
)
NIGHT = "start_utc,end_utc\n2027-01-28T18:00:00,2027-01-29T08:00:00\n"
SPAN = "start_utc,end_utc\n2027-01-28T00:00:00,2027-01-30T00:00:00\n"


def folder_of(folder: Path) -> Path:
    """A camera in orbit (`orbit.toml`), one on the ground (`site.toml`, from dusk on), targets, calendars."""
    (folder / "ring.3le").write_text(with_checksums("".join(ELEMENTS.format(k * 12.0, k, 41866 + k) for k in range(30))))
    (folder / "empty.3le").write_text("")
    (folder / "words.3le").write_text("nothing here\nis an element set\n")
    (folder / "gone.3le").write_text(with_checksums(DECAYED))
    (folder / "sums.3le").write_text(DECAYED)
    packed = gzip.compress(DECAYED.encode())
    (folder / "damaged.3le.gz").write_bytes(packed[:10] + b"\xff" + packed[11:])
    (folder / "night.csv").write_text(NIGHT)
    (folder / "span.csv").write_text(SPAN)
    common = ['objects = "ring.3le"', "[plan]", 'size = "4 m"']
    (folder / "orbit.toml").write_text("\n".join(['scenario = "geo_survey"', *common, "days = 0.2\n"]))
    start = 'start_utc = "2027-01-28T12:00:00"'
    site = ['scenario = "ground_site_tracking"', start, *common, "days = 1.0", 'visit = "300 s"\n']
    (folder / "site.toml").write_text("\n".join(site))
    return folder


def refusal(folder: Path, capsys: pytest.CaptureFixture[str], plan: str, *keys: str) -> str:
    """The only line that a refused plan writes."""
    name = plan if plan == "geo_fence" else str(folder_of(folder) / plan)
    sets = [text for key in keys for text in ("--set", key)]
    code = run(["plan", name, "--out", str(folder / "out"), *sets])
    shown = capsys.readouterr()
    assert code == 2, shown
    assert shown.out == ""
    assert shown.err.count("\n") == 1, shown.err
    assert not (folder / "out").exists()
    return shown.err


ALONE = [
    # orbit: the Sun, the Moon and the limb cannot be farther away than they are
    ("orbit.toml", "plan.constraints.sun=180 deg", "plan.constraints.sun: no target is ever more than 17"),
    ("orbit.toml", "plan.constraints.moon=180 deg", "plan.constraints.moon: no target is ever more than 17"),
    ("orbit.toml", "plan.constraints.limb=120 deg", "plan.constraints.limb: no target is ever more than 11"),
    ("orbit.toml", "plan.constraints.max_rate=1e-6 deg/s", "plan.constraints.max_rate: no target is ever slower"),
    ("orbit.toml", "plan.faintest_snr=10000", "plan.faintest_snr: no target of 4 m ever reaches S/N 10000"),
    ("orbit.toml", "plan.size=1 mm", "plan.faintest_snr: no target of 0.001 m ever reaches S/N 7"),
    ("orbit.toml", "objects=sums.3le", "line 2: not an element line of 69 characters with a right checksum"),
    ("orbit.toml", "objects=gone.3le", "objects: SGP4 gives no target a position"),
    # site: 38 deg north, the ring culminates at 45 deg; the Sun sinks to -70 deg in January
    ("site.toml", "plan.constraints.elevation=60 deg", "plan.constraints.elevation: no target ever rises above 45"),
    ("site.toml", "plan.constraints.darkness=-80 deg", "plan.constraints.darkness: the Sun never sinks below -69"),
    ("site.toml", "weather=span.csv", "weather: the dome is closed throughout the plan"),
    # fences
    ("geo_fence", "plan.constraints.sun=180 deg", "fence: no meridian .* plan.constraints.sun: no target"),
    ("geo_fence", "plan.constraints.limb=120 deg", "fence: no meridian .* plan.constraints.limb: no target"),
]


@pytest.mark.parametrize(("plan", "key", "words"), ALONE)
def test_a_constraint_that_forbids_everything_is_named_with_what_there_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], plan: str, key: str, words: str
) -> None:
    found = refusal(tmp_path, capsys, plan, key)
    assert re.search(words, found), found


TOGETHER = [
    # On 2027-01-29 the Moon stands 90 deg from the Sun: nothing is 150 deg from both.
    ("orbit.toml", ("plan.constraints.sun=150 deg", "plan.constraints.moon=150 deg"), ("constraints.sun", "constraints.moon")),
    ("orbit.toml", ("plan.constraints.limb=90 deg", "plan.constraints.sun=165 deg"), ("constraints.limb", "constraints.sun")),
    ("site.toml", ("weather=night.csv",), ("plan.constraints.darkness", "weather")),
    ("orbit.toml", ("plan.constraints.moon=155 deg", "plan.size=80 cm"), ("plan.constraints.moon", "plan.faintest_snr")),
]


@pytest.mark.parametrize(("plan", "keys", "names"), TOGETHER)
@pytest.mark.slow
def test_constraints_that_contradict_each_other_are_both_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], plan: str, keys: tuple[str, ...], names: tuple[str, ...]
) -> None:
    found = refusal(tmp_path, capsys, plan, *keys)
    assert "and together they forbid all" in found
    assert all(name in found for name in names), found
    if len(keys) == 2:
        for key in keys:  # each alone can be kept
            request, path = read_request(str(tmp_path / plan), [key])
            make_plan(request, path, tmp_path / key.partition("=")[0], Registry())


IMPOSSIBLE = [
    ("orbit.toml", ("plan.visit=10 s",), "plan.slew.settling: 20 s leaves nothing of a visit of 10 s"),
    ("orbit.toml", ("plan.exposures=10000",), "plan.visit: 10000 exposures take"),
    ("orbit.toml", ("plan.days=0.001",), "plan.days: 86.4 s are shorter than a visit of 120 s"),
    ("orbit.toml", ("plan.daily_visits=0.5",), "plan.daily_visits: expected an integer"),
    ("orbit.toml", ("least_mean_motion=3", "most_mean_motion=2"), "least_mean_motion: 3 is above most_mean_motion, 2"),
    ("orbit.toml", ("least_mean_motion=5",), "objects: none of 30 element sets has a mean motion of 5 to 20"),
    ("orbit.toml", ('names=["RING 3", "RING 99"]',), 'is named RING 99; did you mean "RING 9"? known: RING 0,'),
    ("orbit.toml", ('names=["RING 3"]', "least_mean_motion=5"), "objects: none of 1 element sets"),
    ("orbit.toml", ("objects=empty.3le",), "empty.3le holds no element set"),
    ("orbit.toml", ("objects=words.3le",), "words.3le holds no element set"),
    ("orbit.toml", ("objects=none.3le",), "none.3le cannot be read"),
    ("orbit.toml", ("objects=damaged.3le.gz",), "damaged.3le.gz cannot be read"),
    ("orbit.toml", ("objects=",), "the goal `orbits` needs a file of element sets"),
    ("orbit.toml", ("scenario=none",), 'there is no scenario "none"'),
    ("orbit.toml", ("start_utc=soon",), "start_utc: 'soon' is not an ISO-8601 date"),
    ("orbit.toml", ("start_utc=2090-01-01T00:00:00",), "start_utc: "),
    ("orbit.toml", ("weather=span.csv",), "weather: the camera is in orbit"),
    ("orbit.toml", ("plan.constraints.sum=90 deg",), 'unknown key "sum" in [plan.constraints]; did you mean "sun"?'),
    ("geo_fence", ("plan.slew.rate=0.01 deg/s",), "plan.visit: slew, settling and exposures of a fence take"),
]


@pytest.mark.parametrize(("plan", "keys", "words"), IMPOSSIBLE)
def test_what_no_plan_can_hold_is_said_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], plan: str, keys: tuple[str, ...], words: str
) -> None:
    assert words in refusal(tmp_path, capsys, plan, *keys)


def test_only_the_named_targets_are_planned_and_flown(tmp_path: Path) -> None:
    request, path = read_request(str(folder_of(tmp_path) / "orbit.toml"), ['names=["RING 3", "41870"]'])
    make_plan(request, path, tmp_path / "out", Registry())
    assert list(Table.read(tmp_path / "out" / "targets.ecsv", format="ascii.ecsv")["name"]) == ["RING 3", "RING 4"]
    assert 'names = ["RING 3", "41870"]' in (tmp_path / "out" / "scenario.toml").read_text()


@pytest.mark.parametrize("limit", [1, 3])
def test_a_plan_keeps_the_downlink_of_each_day(tmp_path: Path, limit: int) -> None:
    request, path = read_request(str(folder_of(tmp_path) / "orbit.toml"), [f"plan.daily_visits={limit}"])
    schedule = make_plan(request, path, tmp_path / "out", Registry())
    assert 1 <= len(schedule.visits) <= limit  # of less than a day
    for one, other in pairwise(schedule.visits):
        turn = np.degrees(np.arccos(np.clip(np.dot(one.boresight, other.boresight), -1.0, 1.0)))
        assert (other.start_tai_ns - one.end_tai_ns) * 1e-9 >= turn / 0.5 + 20.0 - 1e-6


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["survey", "sso_antisun", "--days", "1", "--set", "population.classes=[]"], "there is nothing to survey"),
        (["response", "sso_antisun", "--runs", "1", "--set", "population.classes=[]"], "so there is nothing to measure"),
        (["survey", "sso_antisun", "--days", "0"], "--days: expected more than 0"),
        (["survey", "ground_site_tracking", "--days", "1"], "ground_site_tracking"),
        (["survey", "sso_antisun", "--days", "1", "--response", "none.json"], "none.json: no such response"),
        (["survey", "sso_antisun", "--days", "1", "--set", "instrument.aperture=0.1 m"], "another instrument than that"),
    ],
)
def test_an_empty_sky_and_a_response_of_another_instrument_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], words: str
) -> None:
    assert run([*arguments, "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1, error
    assert words in error
    assert not (tmp_path / "out").exists()
