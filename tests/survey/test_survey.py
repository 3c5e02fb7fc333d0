"""Responses and survey runs: fits, refusals, the same bytes whatever runs them."""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from sboc_e2e import scenario
from sboc_e2e.cli.main import run as cli
from sboc_e2e.icd.errors import UserError
from sboc_e2e.registry import Registry
from sboc_e2e.survey import engine, instrument
from sboc_e2e.survey import response as responses
from sboc_e2e.survey.block import BlockJob, BlockTables, run_block
from sboc_e2e.survey.curve import WITH_NOISE, fitted, found_share, mean_share, shifts
from sboc_e2e.survey.engine import run_survey
from sboc_e2e.survey.measure import judge_response
from sboc_e2e.survey.rows import OBJECT_COLUMNS, STREAK_COLUMNS, columns
from simulator.survey.flight import Flight

SMALL = ['population.classes=[{from="1 mm", to="3 mm", count=1}]']
TRUE_CURVE = np.array([7.3, -0.6, 0.4, -0.4, 4.0, 0.0, 0.5, 8.0, -0.7])


def load(*overrides: str) -> scenario.Scenario:
    return scenario.load("sso_antisun", registry=Registry(), overrides=overrides)


def synthetic_samples(runs: int, rng: np.random.Generator) -> list[dict[str, object]]:
    """Trails found with a known curve, and tracklets whose residuals of range and size are one."""
    made = []
    for _ in range(runs):
        snr, length, cut = rng.uniform(3.0, 15.0, 120), 10.0 ** rng.uniform(0.7, 2.7, 120), rng.random(120) < 0.3
        shift = shifts(TRUE_CURVE, 20, rng)[np.arange(120) % 20]
        found = rng.random(120) < found_share(TRUE_CURVE, snr, length, 1.0, cut, shift)
        streaks = []
        for k in range(120):
            row = dict.fromkeys(STREAK_COLUMNS, 0.0) | {"object": k % 20, "frame": 1 + k // 20, "snr": snr[k]}
            row |= {"length_px": length[k], "noise_e": 3.0, "onboard": float(found[k]), "ground": float(found[k])}
            row |= {"edges": float(cut[k])}
            streaks.append([float(row[name]) for name in STREAK_COLUMNS])
        objects = []
        for k in range(20):
            n, error = 2 + k % 9, float(rng.standard_normal())
            row = dict.fromkeys(OBJECT_COLUMNS, 0.01) | {"object": k, "detected": n, "linked": n, "snr_all": 10.0 * n}
            row |= {"arc_deg": 0.1 * n, "ln_range_error": error, "ln_size_error": error, "i_error_deg": -error}
            objects.append([float(row[name]) for name in OBJECT_COLUMNS])
        made.append(
            {
                "streaks": streaks, "objects": objects, "frames": 24, "frame_rate_hz": 4.0, "false_streaks": 0,
                "false_tracklets": 0, "duplicate_tracklets": 0, "packets_lost": 0, "downlink_bytes": 24_000,
            }
        )  # fmt: skip
    return made


@cache
def content() -> dict[str, object]:
    return responses.made_of(load(), synthetic_samples(20, np.random.default_rng(3)), "code", "commit", range(20))


def write_response(path: Path, found: scenario.Scenario) -> responses.Response:
    responses.write(path, content())
    return responses.read(path, found)


def test_the_curve_of_trails_is_found_again_and_its_interval_is_its_scatter() -> None:
    """Eight samples of 20 runs: their mean is the true curve, and resampled runs of one scatter as the eight do."""
    snr, fits = np.array([6.0, 7.0, 8.0, 10.0]), []
    for seed in range(8):
        made = synthetic_samples(20, np.random.default_rng(40 + seed))
        runs = [columns(m["streaks"], STREAK_COLUMNS) for m in made]
        fits.append(fitted(responses.trails_of(runs, 3.0), sky=False))
    for length in (10.0, 30.0, 200.0):
        here = np.array([mean_share(c, snr, np.full(4, length)) for c in fits])
        error = here.std(axis=0, ddof=1) / np.sqrt(len(here))
        # of Student's t with 7 degrees of freedom 12 values stay below 5.2 in 99 of 100 sets
        assert (np.abs(here.mean(axis=0) - mean_share(TRUE_CURVE, snr, np.full(4, length))) <= 5.2 * error).all()
    resampled = np.array([mean_share(np.array(c), snr, np.full(4, 30.0)) for c in content()["detection"]["curves"]])
    thirty = np.array([mean_share(c, snr, np.full(4, 30.0)) for c in fits])
    assert (resampled.std(axis=0) / thirty.std(axis=0) > 0.4).all()
    assert (resampled.std(axis=0) / thirty.std(axis=0) < 2.5).all()


@pytest.mark.slow
def test_the_course_with_length_and_sky_is_found_again() -> None:
    """2,400 trails below three skies, half of them of the scenario's own: all parameters within 3 sigma of resampled runs."""
    true = TRUE_CURVE.copy()
    true[WITH_NOISE] = -2.0
    rng = np.random.default_rng(8)
    made = synthetic_samples(20, rng)
    for number, sample in enumerate(made):
        sky, ratio = (("own", 1.0), ("bright", 2.0), ("own", 1.0), ("dense", 1.2))[number % 4]
        sample["sky"] = responses.OWN_SKY if sky == "own" else sky
        names, shift = {name: k for k, name in enumerate(STREAK_COLUMNS)}, shifts(true, 20, rng)
        for row in sample["streaks"]:
            snr, length, cut, owner = (row[names[n]] for n in ("snr", "length_px", "edges", "object"))
            share = found_share(true, np.array([snr]), np.array([length]), ratio, cut > 0.0, shift[int(owner)])
            row[names["noise_e"]], row[names["ground"]] = 3.0 * ratio, float(rng.random() < share[0])
    found = responses.made_of(load(), made, "code", "commit", range(20))
    spread = np.std(found["detection"]["curves"], axis=0)
    assert (np.abs(np.array(found["detection"]["curve"]) - true) <= 3.0 * spread + 0.02).all()
    slope = found["detection"]["slope_with_log10_noise"]
    assert slope["high"] - slope["low"] > 0.3  # a fit that stays at its start would have none
    assert found["noise_e"] == pytest.approx(3.0)
    assert [sky["runs"] for sky in found["skies"]] == [10, 5, 5]
    for sky in found["skies"]:
        _, low, high = sky["found_over_expected"]
        assert low - (high - low) < 1.0 < high + (high - low)  # intervals of five runs, widened to three of their own


def test_residuals_of_a_tracklet_stay_together(tmp_path: Path) -> None:
    made = write_response(tmp_path / "r.json", load())
    n = 2000
    drawn = made.residuals(np.full(n, 4.0), np.full(n, 40.0), np.full(n, 0.4), np.ones(n), np.random.default_rng(1))
    assert np.array_equal(drawn["ln_range_error"], drawn["ln_size_error"])
    assert np.allclose(drawn["i_error_deg"], -drawn["ln_range_error"])
    assert drawn["ln_range_error"].std() == pytest.approx(1.0, abs=0.5)


def test_residuals_of_near_objects_are_not_given_to_far_ones() -> None:
    """Alike in frames, S/N and arc: sizes of near ones err by a factor, of far ones by a hundredth."""
    rng, names = np.random.default_rng(4), responses.BANK_COLUMNS
    rows = []
    for k in range(80):
        spread, range_km = (1.0, 20.0) if k % 2 else (0.01, 800.0)
        row = dict.fromkeys(names, 0.0) | {"linked": 4.0, "snr_all": 40.0, "arc_deg": 0.4, "range_km": range_km}
        row["ln_size_error"] = spread * rng.standard_normal()
        rows.append([row[name] for name in names])
    made, n = responses.Response(content={"tracklets": rows}), 500
    drawn = made.residuals(np.full(n, 4.0), np.full(n, 41.0), np.full(n, 0.4), np.full(n, 700.0), rng)["ln_size_error"]
    assert np.abs(drawn).max() < 0.05


def test_a_response_of_another_instrument_is_refused_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "r.json"
    write_response(path, load())
    responses.read(path, load("sensor.window.rows=1024", "population.albedo=0.2", "platform.altitude=600 km"))
    for change, key in (("instrument.aperture=0.1 m", "instrument.aperture"), ("frame_rate=2 Hz", "frame_rate")):
        with pytest.raises(UserError, match=f"another instrument than that of sso_antisun: {key}"):
            responses.read(path, load(change))
    code = cli(["survey", "sso_antisun", "--days", "1", "--response", str(path), "--set", "shutter.exposure=0.1 s",
                "--out", str(tmp_path / "o")])  # fmt: skip
    error = capsys.readouterr().err
    assert code == 2
    assert error.count("\n") == 1
    assert "shutter.exposure" in error
    assert not (tmp_path / "o").exists()


def test_the_shipped_response_fits_its_scenario() -> None:
    found = load()
    assert responses.read(responses.shipped(found), found).content["runs"] >= 20


def test_a_key_younger_than_the_response_counts_as_its_default() -> None:
    theirs, defaults = {"sensor.a": 1.0}, {"sensor.a": 2.0, "sensor.b": 0.0}
    assert instrument.first_difference({"sensor.a": 1.0, "sensor.b": 0.0}, theirs, defaults) is None
    assert "sensor.b is 0.1 here" in str(instrument.first_difference({"sensor.a": 1.0, "sensor.b": 0.1}, theirs, defaults))
    assert "onboard.c is 0.0 here" in str(instrument.first_difference({"sensor.a": 1.0, "onboard.c": 0.0}, theirs, defaults))


@pytest.mark.parametrize(
    ("text", "words"), [("{}", "not a response file"), ("nonsense", "not a response file"), (None, "no such response")]
)
def test_what_is_no_response_is_refused(tmp_path: Path, text: str | None, words: str) -> None:
    path = tmp_path / "r.json"
    if text is not None:
        path.write_text(text)
    with pytest.raises(UserError, match=words):
        responses.read(path, load())


def test_another_version_is_refused_in_one_line_and_before_any_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "response.json"
    older = json.loads(responses.shipped(load()).read_text()) | {"version": responses.VERSION - 1}
    path.write_text(json.dumps(older))
    words = f"a response of version {responses.VERSION - 1}; this program reads version {responses.VERSION}: measure it again"
    assert cli(["survey", "sso_antisun", "--days", "1", "--response", str(path), "--out", str(tmp_path / "o")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert words in error
    with pytest.raises(UserError, match=words):
        judge_response(load(), 20, tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["response.json"]


def shards(folder: Path) -> dict[str, bytes]:
    names = [p for kind in ("tracklets", "truth", "sums") for p in sorted((folder / kind).iterdir())]
    return {f"{p.parent.name}/{p.name}": p.read_bytes() for p in names}


@pytest.mark.slow
def test_an_interrupted_survey_ends_with_the_same_bytes(tmp_path: Path) -> None:
    found = load(*SMALL)
    made = write_response(tmp_path / "r.json", found)
    result = run_survey(found, made, 0.5, tmp_path / "one", here=True)
    assert (result.done, result.skipped, result.failed) == (2, 0, ())
    assert len(shards(tmp_path / "one")) == 6
    run_survey(found, made, 0.25, tmp_path / "two", here=True)
    # killed between the two tables of a block: the sums are written last
    (tmp_path / "two" / "truth" / "000001.parquet").write_bytes(b"half")
    assert run_survey(found, made, 0.5, tmp_path / "two", here=True).skipped == 1
    assert shards(tmp_path / "one") == shards(tmp_path / "two")


@pytest.mark.slow
def test_two_processes_give_the_bytes_of_one(tmp_path: Path) -> None:
    found = load(*SMALL)
    made = write_response(tmp_path / "r.json", found)
    run_survey(found, made, 1.0, tmp_path / "one", here=True)
    run_survey(found, made, 1.0, tmp_path / "two", workers=2)
    assert shards(tmp_path / "one") == shards(tmp_path / "two")


@pytest.mark.slow
def test_a_folder_of_another_survey_is_refused(tmp_path: Path) -> None:
    found = load(*SMALL)
    made = write_response(tmp_path / "r.json", found)
    run_survey(found, made, 0.25, tmp_path / "one", here=True)
    with pytest.raises(UserError, match="holds a survey with another seed"):
        run_survey(replace(found, seed=5), made, 0.25, tmp_path / "one", here=True)
    with pytest.raises(UserError, match="holds a survey with another options"):
        run_survey(load(*SMALL, "population.albedo=0.2"), made, 0.25, tmp_path / "one", here=True)


@pytest.mark.parametrize("force", [False, True])
@pytest.mark.parametrize(
    "name", ["truth/objects.ecsv", "failed/notes.txt", "tracklets/pottery.jpg", "sums/tax.json", "survey.json"]
)
def test_files_of_a_stranger_stay(tmp_path: Path, name: str, force: bool) -> None:
    """A folder is a survey's by its identity, not by what its folders are called; a run has a truth/, too."""
    own, bystander = tmp_path / "out" / name, tmp_path / "out" / "truth" / "light.ecsv"
    for path in (own, bystander):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text('{"identity": "of somebody"}')
    found = load(*SMALL)
    with pytest.raises(UserError, match="--out goes elsewhere") as caught:
        run_survey(found, write_response(tmp_path / "r.json", found), 0.25, tmp_path / "out", here=True, force=force)
    assert "\n" not in str(caught.value)
    assert {path for path in (tmp_path / "out").rglob("*") if path.is_file()} == {own, bystander}
    assert own.read_text() == '{"identity": "of somebody"}'


def test_force_begins_a_survey_anew(tmp_path: Path) -> None:
    """The folders of a survey, known by its identity, are emptied; other files beside them stay."""
    found, out = load(*SMALL), tmp_path / "out"
    response = write_response(tmp_path / "r.json", found)
    engine._begun(out, found, response, 0.25, (7,))
    for name in ("sums/000000.json", "truth/000000.parquet", "notes.txt"):
        (out / name).write_text("earlier")
    assert engine._known(out, found, response, 0.25, force=False) == (7,)
    assert engine._known(out, found, response, 0.25, force=True) is None
    assert [path.name for path in out.rglob("*")] == ["notes.txt"]


@pytest.mark.parametrize(
    ("days", "overrides", "words"),
    [
        (0.0, SMALL, "--days: expected more than 0"),
        (1.0, ["population.classes=[]"], "there is nothing to survey"),
        (100_000.0, SMALL, "where the ephemeris of the Sun ends"),
    ],
)
def test_what_cannot_be_surveyed_is_refused(tmp_path: Path, days: float, overrides: list[str], words: str) -> None:
    found = load(*overrides)
    made = write_response(tmp_path / "r.json", found)
    with pytest.raises(UserError, match=words):
        run_survey(found, made, days, tmp_path / "o", here=True)


def test_a_scenario_without_a_response_says_how_to_measure_one(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli(["survey", "near_field_mm", "--days", "1"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "`sboc response near_field_mm` measures one" in error


READERS = {
    "pandas": lambda module, files: module.read_parquet([str(p) for p in files]).to_dict("list"),
    "polars": lambda module, files: module.read_parquet([str(p) for p in files]).to_dict(as_series=False),
    "duckdb": lambda module, files: module.read_parquet([str(p) for p in files]).fetchnumpy(),
}


@pytest.mark.parametrize("name", sorted(READERS))
@pytest.mark.slow
def test_shards_are_read_as_they_are(tmp_path: Path, name: str) -> None:
    module = pytest.importorskip(name, reason=f"{name} is not installed")
    from pyarrow import parquet

    found = load(*SMALL)
    run_survey(found, write_response(tmp_path / "r.json", found), 0.5, tmp_path / "one", here=True)
    for kind in ("tracklets", "truth"):
        files = sorted((tmp_path / "one" / kind).iterdir())
        read = READERS[name](module, files)
        parts = [parquet.read_table(path, use_threads=False).to_pydict() for path in files]
        assert sorted(read) == sorted(parts[0])
        assert len(read["tracklet_id"]) == len(set(read["tracklet_id"])) > 0
        for column in read:
            expected = np.concatenate([np.asarray(part[column], dtype=np.float64) for part in parts])
            assert np.array_equal(np.asarray(read[column], dtype=np.float64), expected, equal_nan=True)


@pytest.mark.slow
def test_failed_blocks_are_listed_and_tried_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = load(*SMALL)
    made = write_response(tmp_path / "r.json", found)
    run_survey(found, made, 0.5, tmp_path / "one", here=True)

    def fails_once(job: BlockJob) -> BlockTables:
        if job.block == 0:
            raise ArithmeticError("no luck")
        return run_block(job)

    lines: list[str] = []
    monkeypatch.setattr(engine, "run_block", fails_once)
    result = run_survey(found, made, 0.5, tmp_path / "two", here=True, report=lines.append)
    assert result.failed == ((0, "ArithmeticError: no luck"),)
    assert result.done == 1
    assert any("FAILED block 0: ArithmeticError: no luck" in line for line in lines)
    assert (tmp_path / "two" / "failed" / "000000.txt").read_text() == "ArithmeticError: no luck\n"
    monkeypatch.setattr(engine, "run_block", run_block)
    result = run_survey(found, made, 0.5, tmp_path / "two", here=True)
    assert (result.done, result.skipped, result.failed) == (1, 1, ())
    assert not list((tmp_path / "two" / "failed").iterdir())
    assert shards(tmp_path / "one") == shards(tmp_path / "two")


@pytest.mark.slow  # a dask cluster of two processes takes 20 s to start
def test_a_dask_cluster_gives_the_bytes_of_one_process(tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="distributed is not installed")
    found = load(*SMALL)
    made = write_response(tmp_path / "r.json", found)
    run_survey(found, made, 0.5, tmp_path / "one", here=True)
    run_survey(found, made, 0.5, tmp_path / "two", workers=2, scheduler="local")
    assert shards(tmp_path / "one") == shards(tmp_path / "two")


@pytest.mark.parametrize(
    "overrides",
    [("shutter.exposure=1 s",), ("pointing.roll_rate=300 deg/s", "shutter.exposure=2 s", "frame_rate=0.4 Hz")],
    ids=["exposure longer than a frame", "half a turn within a frame"],
)
def test_what_a_run_refuses_no_survey_accepts(tmp_path: Path, overrides: tuple[str, ...]) -> None:
    found = load(*SMALL, *overrides)
    with pytest.raises(UserError) as of_run:
        found.simulator.refuse_bad_timing()
    response = write_response(tmp_path / "response.json", load())
    with pytest.raises(UserError) as of_survey:
        run_survey(found, response, 0.25, tmp_path / "out", here=True)
    assert str(of_survey.value) == str(of_run.value)
    assert not (tmp_path / "out").exists()
    with pytest.raises(UserError):
        Flight.of(found.simulator, 1)
