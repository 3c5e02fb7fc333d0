"""What the benchmark calls a regression, and what not."""

from pathlib import Path

import pytest

from sboc_e2e.bench import yardstick
from sboc_e2e.bench.baseline import read_baseline, regressions, write_baseline
from sboc_e2e.bench.entries import AIMED, AIMS, Entry, flatten
from sboc_e2e.icd.errors import UserError


def entry(name: str, value: float, half: float = 0.0) -> Entry:
    return Entry(name=name, value=value, n=100, low=value - half, high=value + half)


def test_worse_than_noise_is_named(tmp_path: Path) -> None:
    path = tmp_path / "baseline.json"
    write_baseline(path, [entry("run.completeness_snr8", 0.95, 0.02), entry("run.false_per_frame", 0.1, 0.02)])
    found = regressions(
        [entry("run.completeness_snr8", 0.80, 0.02), entry("run.false_per_frame", 0.5, 0.02)], read_baseline(path)
    )
    assert [r.name for r in found] == ["run.completeness_snr8", "run.false_per_frame"]
    assert "0.8" in str(found[0])


def test_better_or_within_noise_is_not(tmp_path: Path) -> None:
    path = tmp_path / "baseline.json"
    write_baseline(path, [entry("run.completeness_snr8", 0.90, 0.05), entry("x.cpu_s", 1.0), entry("note.count", 3.0)])
    now = [entry("run.completeness_snr8", 0.86, 0.05), entry("x.cpu_s", 1.4), entry("note.count", 99.0), entry("new.rms_px", 9.0)]
    assert regressions(now, read_baseline(path)) == []


def test_missing_or_broken_baseline_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no baseline"):
        read_baseline(tmp_path / "none.json")
    (tmp_path / "broken.json").write_text("{")
    with pytest.raises(UserError, match="not a baseline"):
        read_baseline(tmp_path / "broken.json")


def test_nested_results_become_named_entries() -> None:
    tree = {
        "a": {"value": 1.5, "n": 3, "low": 1.0, "high": 2.0},
        "b": {"c": 2},
        "d": "text",
        "e": {"value": None, "n": 0, "reason": "no"},
    }
    entries = {e.name: e for e in flatten("x", tree)}
    assert entries["x.a"].sigma == pytest.approx(0.5 / 1.645)
    assert entries["x.b.c"].value == 2.0
    assert entries["x.a"].measured
    assert not entries["x.b.c"].measured
    assert entries["x.e"].reason == "no"
    assert set(entries) == {"x.a", "x.b.c", "x.e"}


def test_every_form_of_interval_is_noise() -> None:
    tree = {
        "pair": {"value": 0.5, "n": 40, "interval": [0.4, 0.6]},
        "rare": {"value": 0.1, "n_frames": 100, "upper_95": 0.3},
        "ends": {"value": 0.5, "n": 40, "low": 0.4, "high": 0.6},
    }
    entries = {e.name: e for e in flatten("x", tree)}
    assert entries["x.pair"].sigma == pytest.approx(entries["x.ends"].sigma)
    assert entries["x.rare"].sigma == pytest.approx(0.3 / (2 * 1.645))
    assert entries["x.rare"].n == 100


def test_unknown_noise_is_not_judged_but_timings_are(tmp_path: Path) -> None:
    path = tmp_path / "baseline.json"
    write_baseline(path, flatten("x", {"rms_px": 1.0, "cpu_s": 1.0}))
    assert set(read_baseline(path)) == {"x.cpu_s"}
    assert [r.name for r in regressions(flatten("x", {"rms_px": 9.0, "cpu_s": 9.0}), read_baseline(path))] == ["x.cpu_s"]


def test_a_bias_is_judged_by_its_size(tmp_path: Path) -> None:
    path = tmp_path / "baseline.json"
    write_baseline(path, [entry("x.bias_mag", 0.01, 0.01)])
    assert regressions([entry("x.bias_mag", -0.011, 0.01)], read_baseline(path)) == []
    assert [r.name for r in regressions([entry("x.bias_mag", -0.2, 0.01)], read_baseline(path))] == ["x.bias_mag"]


@pytest.mark.parametrize(
    ("name", "good", "bad"),
    [("pull_std", 0.98, (0.7, 1.3)), ("coverage_68", 0.68, (0.5, 0.85)), ("coverage_90.range", 0.9, (0.8, 0.99))],
)
def test_calibration_is_judged_by_its_distance_from_what_it_should_be(
    tmp_path: Path, name: str, good: float, bad: tuple[float, float]
) -> None:
    path = tmp_path / "baseline.json"
    write_baseline(path, [entry(f"x.{name}", good, 0.01)])
    assert regressions([entry(f"x.{name}", good + 0.01, 0.01)], read_baseline(path)) == []
    for value in bad:
        assert [r.name for r in regressions([entry(f"x.{name}", value, 0.01)], read_baseline(path))] == [f"x.{name}"]


def test_timings_are_compared_in_units_of_the_yardstick(tmp_path: Path) -> None:
    """On a machine of half the speed twice the CPU seconds are no regression, and the same seconds hide one of a factor two."""
    path = tmp_path / "baseline.json"
    write_baseline(
        path, [entry("x.yardstick_s", 0.1), entry("x.cpu_s", 1.0), entry("x.encode_mb_s", 400.0), entry("x.rss_mb", 300.0)]
    )
    slow = [entry("x.yardstick_s", 0.2), entry("x.cpu_s", 2.0), entry("x.encode_mb_s", 200.0), entry("x.rss_mb", 300.0)]
    assert regressions(slow, read_baseline(path)) == []
    fast = [entry("x.yardstick_s", 0.05), entry("x.cpu_s", 1.0), entry("x.encode_mb_s", 390.0), entry("x.rss_mb", 340.0)]
    assert [(r.name, r.before) for r in regressions(fast, read_baseline(path))] == [
        ("x.cpu_s", 0.5),
        ("x.encode_mb_s", 800.0),
        ("x.rss_mb", 300.0),
    ]


def test_speed_in_real_time_follows_the_machine_and_wall_seconds_are_not_judged(tmp_path: Path) -> None:
    """Half the machine is half as fast; programs beside a part stretch its wall seconds and not its CPU seconds."""
    path = tmp_path / "baseline.json"
    names = ("yardstick_s", "timing.realtime_factor_onboard", "timing.onboard_s_per_frame", "timing.onboard_cpu_s_per_frame")
    write_baseline(path, [entry(f"x.{name}", value) for name, value in zip(names, (0.1, 4.0, 0.06, 0.06), strict=True)])
    slow = [entry(f"x.{name}", value) for name, value in zip(names, (0.2, 2.0, 0.5, 0.12), strict=True)]
    assert regressions(slow, read_baseline(path)) == []
    worse = [entry(f"x.{name}", value) for name, value in zip(names, (0.1, 1.5, 0.06, 0.12), strict=True)]
    assert [r.name for r in regressions(worse, read_baseline(path))] == [f"x.{names[1]}", f"x.{names[3]}"]


def test_one_part_is_written_anew_and_the_others_stay(tmp_path: Path) -> None:
    path = tmp_path / "baseline.json"
    write_baseline(path, [entry("x.cpu_s", 1.0), entry("x.old_cpu_s", 1.0), entry("y.cpu_s", 1.0)])
    write_baseline(path, [entry("x.cpu_s", 2.0)], kept=read_baseline(path))
    assert {name: figure["value"] for name, figure in read_baseline(path).items()} == {"x.cpu_s": 2.0, "y.cpu_s": 1.0}


@pytest.mark.parametrize("name", ["camera.40_percent_false.bias_x_arcsec", "camera.40_percent_false.zero_point_bias_mag"])
def test_a_bias_among_false_stars_is_a_bias(name: str, tmp_path: Path) -> None:
    """It was judged as a rate of false ones: the more negative the better."""
    path = tmp_path / "baseline.json"
    write_baseline(path, [entry(name, 0.01, 0.01)])
    assert [r.name for r in regressions([entry(name, -0.2, 0.01)], read_baseline(path))] == [name]
    assert regressions([entry(name, -0.01, 0.01)], read_baseline(path)) == []


@pytest.mark.parametrize(("pattern", "aim"), AIMS)
def test_what_has_an_aim_is_judged_by_its_distance_from_there(pattern: str, aim: float) -> None:
    for words in ("false", "snr50", "rms", "_ratio", "error", "_ms"):
        figure = entry(f"x.{words}.{pattern.strip('*')}", 1.0)
        assert (figure.better, figure.aim) == (AIMED, aim)


def test_errors_of_epochs_are_no_timings_of_the_machine(tmp_path: Path) -> None:
    """An rms of 0.06 +- 0.002 ms that became 0.08 is worse on any machine; half as much again is allowed for timings."""
    path, before, now = tmp_path / "baseline.json", 0.06, 0.08
    names = ("x.products.angles.epoch_rms_ms", "x.products.angles.epoch_bias_ms")
    yardsticks = [entry(f"x.{yardstick.NAME}", seconds) for seconds in (1.0, 2.0)]
    write_baseline(path, [yardsticks[0], *(entry(name, before, 0.002) for name in names)])
    found = regressions([yardsticks[1], *(entry(name, now, 0.002) for name in names)], read_baseline(path))
    assert [(r.name, r.before) for r in found] == [(name, before) for name in names]
    assert regressions([yardsticks[1], *(entry(name, before, 0.002) for name in names)], read_baseline(path)) == []
