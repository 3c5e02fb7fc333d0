"""Campaign files: points, seeds that depend on nothing but the task, and errors of one line."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from astropy.table import Table

from sboc_e2e.campaign import read_campaign
from sboc_e2e.campaign.aggregate import against_first
from sboc_e2e.campaign.resolve import overrides
from sboc_e2e.icd.errors import UserError
from sboc_e2e.scenario.toml_files import FOLDER

GRID = """
scenario = "smoke"
replicas = 2
[set]
frames = 3
[vary]
"instrument.aperture" = ["15 cm", "20 cm"]
"onboard.detector.n_sigma" = [6.0, 7.0, 8.0]
"""
UNPAIRED = GRID.replace("replicas = 2", "replicas = 2\npaired = false")


def written(folder: Path, text: str) -> Path:
    path = folder / "campaign.toml"
    path.write_text(text)
    return path


def test_grid_has_every_point_and_replica(tmp_path: Path) -> None:
    tasks = read_campaign(written(tmp_path, GRID)).tasks()
    assert len(tasks) == 12
    assert len({(t.point, t.replica) for t in tasks}) == 12
    assert [t.number for t in tasks] == list(range(12))


def test_seeds_belong_to_the_task_not_to_its_place(tmp_path: Path) -> None:
    one = {
        (dict(t.point)["instrument.aperture"], t.replica): t.seed
        for t in read_campaign(written(tmp_path, UNPAIRED)).tasks()
        if dict(t.point)["onboard.detector.n_sigma"] == 7.0
    }
    swapped = UNPAIRED.replace('["15 cm", "20 cm"]', '["20 cm", "30 cm", "15 cm"]').replace("[6.0, 7.0, 8.0]", "[7.0]")
    other = {(dict(t.point)["instrument.aperture"], t.replica): t.seed
             for t in read_campaign(written(tmp_path, swapped)).tasks()}  # fmt: skip
    assert all(other[key] == seed for key, seed in one.items())
    assert len(set(other.values())) == len(other)


def test_points_share_the_seeds_of_their_replicas(tmp_path: Path) -> None:
    """A difference between points is then that of their settings, not of their skies."""
    tasks = read_campaign(written(tmp_path, GRID)).tasks()
    by_replica = {replica: {t.seed for t in tasks if t.replica == replica} for replica in (0, 1)}
    assert all(len(seeds) == 1 for seeds in by_replica.values())
    assert by_replica[0] != by_replica[1]


def test_more_draws_leave_the_first_as_they_are(tmp_path: Path) -> None:
    text = 'scenario = "smoke"\ndraws = {}\n[vary]\nframes = [2, 3]\nframe_rate = {{low = "1 Hz", high = "8 Hz"}}\n'
    few, many = ({t.point for t in read_campaign(written(tmp_path, text.format(n))).tasks()} for n in (3, 5))
    assert few < many
    assert len(many) == 10


def test_shipped_campaigns_are_found_by_name(tmp_path: Path) -> None:
    assert read_campaign("threshold_froc") == read_campaign(FOLDER / "campaigns" / "threshold_froc.toml")
    with pytest.raises(UserError, match=r"one of: .*threshold_froc"):
        read_campaign("treshold_froc")


def test_overrides_are_those_of_the_command_line(tmp_path: Path) -> None:
    campaign = read_campaign(written(tmp_path, GRID))
    texts = overrides(campaign, campaign.tasks()[0].point)
    assert texts == ["frames=3", "instrument.aperture=15 cm", "onboard.detector.n_sigma=6.0"]


def test_random_draws_stay_inside_and_repeat(tmp_path: Path) -> None:
    text = 'scenario = "smoke"\ndraws = 50\n[vary]\nframe_rate = {low = "1 Hz", high = "8 Hz", scale = "log"}\n'
    tasks = read_campaign(written(tmp_path, text)).tasks()
    rates = [float(dict(t.point)["frame_rate"].split()[0]) for t in tasks]
    assert len(rates) == 50
    assert min(rates) >= 1.0
    assert max(rates) <= 8.0
    assert tasks == read_campaign(written(tmp_path, text)).tasks()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("scenario = 'smoke'\nreplica = 2\n", 'did you mean "replicas"'),
        ("replicas = 2\n", "scenario: expected a name"),
        ("scenario = 'smoke'\nreplicas = -1\n", "replicas: expected a whole number"),
        ("scenario = 'smoke'\n[vary]\nx = {low = '1 Hz'}\n", "vary.x: expected a list"),
        ("scenario = 'smoke'\ndraws = 2\n[vary]\nx = {low = '1 Hz', high = '2 m'}\n", "same dimension"),
        ("scenario = 'smoke'\n[vary]\nx = {low = 1, high = 2}\n", "draws must be 1 or more"),
        ("scenario = \n", "not a TOML file"),
        ("scenario = 'smoke'\n[set]\nseed = 4\n", r"set\.seed: .*write seed = N above \[set\]"),
        ("scenario = 'smoke'\n[vary]\nseed = [4, 5]\n", r"vary\.seed: .*write seed = N above \[vary\]"),
        ("scenario = 'smoke'\n[vary]\nframes = [2, 3, 2]\n", r"vary\.frames: 2 is given twice"),
        ("scenario = 'smoke'\n[vary]\nx = [6, 7.0, 6.0]\n", r"vary\.x: 6\.0 is given twice"),
        ("scenario = 'smoke'\n[vary]\nx = ['4 cm', '4 cm']\n", r'vary\.x: "4 cm" is given twice'),
        ("scenario = 'smoke'\n[vary]\nx = [[1, 2], [1, 2]]\n", r"vary\.x: \[1, 2\] is given twice"),
        ("scenario = 'smoke'\ndraws = 2\n[vary]\nx = {low = '4 cm', high = '40 mm'}\n", "low must be less than high"),
        ("scenario = 'smoke'\n[set]\nx = 2026-03-01\n", r'set\.x: a date is a text in quotes, such as "2026-03-01"'),
        ("scenario = 'smoke'\n[vary]\nx = ['a', 2026-03-01T12:00:00Z]\n", r'vary\.x: .*"2026-03-01T12:00:00\+00:00"'),
        ("scenario = 'smoke'\n[set]\nx = [{y = 12:30:00}]\n", r'set\.x: .*"12:30:00"'),
    ],
)
def test_errors_name_the_key_in_one_line(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(UserError, match=words) as caught:
        read_campaign(written(tmp_path, text)).tasks()
    assert "\n" not in str(caught.value)


def test_shipped_campaigns_are_readable() -> None:
    paths = sorted((FOLDER / "campaigns").glob("*.toml"))
    assert len(paths) >= 3
    for path in paths:
        assert read_campaign(path).tasks()


def test_a_campaign_can_be_tried_in_a_reduced_form(tmp_path: Path) -> None:
    campaign = read_campaign(written(tmp_path, GRID))
    small = campaign.reduced(1, ("frames=1",))
    assert len(small.tasks()) == 6
    assert overrides(small, small.tasks()[0].point)[0] == "frames=1"
    assert small.tasks()[0].seed == campaign.tasks()[0].seed
    with pytest.raises(UserError, match=r"varies instrument\.aperture"):
        campaign.reduced(None, ("instrument.aperture=1 m",))
    with pytest.raises(UserError, match="--replicas"):
        campaign.reduced(0, ())


def test_another_seed_is_the_campaigns_own(tmp_path: Path) -> None:
    """The seed of each run follows from it, so that as a scenario's key it would be overwritten without a word."""
    other = read_campaign(written(tmp_path, GRID)).reduced(None, (" seed = 4",))
    assert other == read_campaign(written(tmp_path, GRID.replace("replicas = 2", "replicas = 2\nseed = 4")))
    assert other.tasks()[0].seed != read_campaign(written(tmp_path, GRID)).tasks()[0].seed
    for wrong in ("-1", "4.5", "four", "²"):
        with pytest.raises(UserError, match="seed: expected a whole number"):
            other.reduced(None, (f"seed={wrong}",))


def test_values_that_differ_are_different_points(tmp_path: Path) -> None:
    text = 'scenario = "smoke"\n[vary]\nx = [true, 1, "1", [1], 2, false]\n'
    assert len(read_campaign(written(tmp_path, text)).tasks()) == 6


def test_draws_that_coincide_are_one_point(tmp_path: Path) -> None:
    """Within nine digits the range has eleven values."""
    text = 'scenario = "smoke"\nreplicas = 3\ndraws = 200\n[vary]\nframe_rate = {low = "1 Hz", high = "1.0000001 Hz"}\n'
    tasks = read_campaign(written(tmp_path, text)).tasks()
    assert len({(t.point, t.replica) for t in tasks}) == len(tasks)
    assert len(tasks) == 3 * 11


def test_points_on_the_same_frames_are_compared_streak_by_streak() -> None:
    """Ten objects of five streaks each; the second point finds two objects more, the third has other frames."""

    def shard(point: str, frames: str, objects: int) -> Table:
        table = Table({"snr": np.full(50, 9.0), "length_px": np.full(50, 30.0), "object_id": np.repeat(np.arange(10), 5)})
        table["detected_ground"] = np.asarray(table["object_id"]) < objects
        table.meta = {"point": point, "frames": frames}
        return table

    gains = against_first({"a": [shard("a", "f", 4)], "b": [shard("b", "f", 6)], "c": [shard("c", "g", 9)]})
    assert list(gains) == ["b"]
    assert gains["b"]["completeness"]["value"] == pytest.approx(0.2)
    assert gains["b"]["mcnemar"]["objects_disagreeing"] == 2
    assert gains["b"]["mcnemar"]["p_value"] == pytest.approx(0.5)


def test_values_of_a_campaign_arrive_as_they_are_in_its_file(tmp_path: Path) -> None:
    """Texts outside the first plane of Unicode, tables in lists and infinity have no common form in JSON and TOML."""
    values = {"a.texts": ["café 😀", "b"], "a.tables": [{"from": "1 mm", "count": 3}], "a.largest": float("inf"), "a.on": True}
    path = tmp_path / "c.toml"
    path.write_text(
        'scenario = "smoke"\ndescription = "texts"\nreplicas = 1\nseed = 1\n[set]\n"a.texts" = ["café 😀", "b"]\n'
        '"a.tables" = [{from = "1 mm", count = 3}]\n"a.largest" = inf\n"a.on" = true\n[vary]\nframes = [1, 2]\n'
    )
    texts = overrides(read_campaign(path), (("frames", 2),))
    read = tomllib.loads("\n".join(f'"{key}" = {text}' for key, _, text in (each.partition("=") for each in texts)))
    assert read == {**values, "frames": 2}
