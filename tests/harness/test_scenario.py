"""Scenario files: keys, ranges, presets, overrides, and the one line that says what is wrong."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sboc_e2e import scenario
from sboc_e2e.icd.errors import UserError
from sboc_e2e.registry import Registry
from sboc_e2e.scenario import option_models, schema, shown, toml_files
from sboc_e2e.scenario.document import bare, from_document

REGISTRY = Registry()


def written(folder: Path, text: str) -> str:
    path = folder / "mine.toml"
    path.write_text(text)
    return str(path)


def refusal(folder: Path, text: str, *overrides: str) -> str:
    with pytest.raises(UserError) as caught:
        scenario.load(written(folder, text), registry=REGISTRY, overrides=overrides)
    message = str(caught.value)
    assert "\n" not in message
    return message


@pytest.mark.parametrize("name", ["smoke", "sso_antisun"])
def test_the_shipped_scenarios_resolve(name: str) -> None:
    resolved = scenario.load(name, registry=REGISTRY)
    assert resolved.name == name
    assert resolved.description


def test_a_resolved_scenario_gives_itself_back() -> None:
    resolved = scenario.load("smoke", registry=REGISTRY, overrides=["shutter.exposure=0.1234567890123 s"])
    tables = json.loads(json.dumps(resolved.document()))
    again = from_document(tables, name="smoke", registry=REGISTRY, where="manifest")
    assert again.document() == resolved.document()
    assert again.simulator == resolved.simulator
    assert again.components == resolved.components


def test_options_that_the_program_gives_a_step_go_with_the_step() -> None:
    """`sboc process` gives the default detector a limit of its own, which another detector need not know."""
    tables = {"onboard": {"detector": {"max_detections": 1000}, "roi": {"max_per_frame": 7}}}
    plain = bare("frames", tables, registry=REGISTRY)
    other = bare("frames", tables, registry=REGISTRY, overrides=('onboard.detector.use="threshold"',))
    tuned = bare("frames", tables, registry=REGISTRY, overrides=("onboard.detector.n_sigma=8.0",))
    assert [one.step("onboard.detector").max_detections for one in (plain, other, tuned)] == [1000, 200, 1000]
    assert type(other.step("onboard.detector")).__name__ == "ThresholdDetector"
    assert [one.onboard.roi.max_per_frame for one in (plain, other)] == [7, 7]


def test_own_keys_win_over_a_preset_and_overrides_over_both(tmp_path: Path) -> None:
    text = '[instrument]\npreset = "smoke_wide"\nrows = 300\n'
    assert scenario.load(written(tmp_path, text), registry=REGISTRY).simulator.instrument.rows == 300
    assert scenario.load(written(tmp_path, text), registry=REGISTRY).simulator.instrument.cols == 512
    over = scenario.load(written(tmp_path, text), registry=REGISTRY, overrides=["instrument.rows=128", "seed=9"])
    assert (over.simulator.instrument.rows, over.seed) == (128, 9)


def test_a_preset_can_be_chosen_on_the_command_line(tmp_path: Path) -> None:
    """It lies under the file's own keys as the file's preset does, and takes its place; other overrides win over it."""
    path = written(tmp_path, "[sensor.structure]\nlag = 0.25\n")
    chosen = "psf.preset=as_measured"
    made = scenario.load(path, registry=REGISTRY, overrides=["psf.aureole.share=0.5", chosen]).simulator
    named = scenario.load(written(tmp_path, '[psf]\npreset = "as_measured"\n'), registry=REGISTRY).simulator
    assert made.psf.wavefront == named.psf.wavefront
    assert (made.sensor.structure.lag, made.psf.aureole.share) == (0.25, 0.5)
    assert made.sky == named.sky
    assert made.sky.galaxies.density == 1.0
    other = scenario.load("smoke", registry=REGISTRY, overrides=["instrument.preset=art_like"]).simulator
    assert other.instrument.name == "art_like"
    with pytest.raises(UserError, match="there is no preset"):
        scenario.load(path, registry=REGISTRY, overrides=["psf.preset=as_measures"])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("sed = 1", ('unknown key "sed"', 'did you mean "seed"?')),
        ("[shutter]\nexposur = 1", ('unknown key "exposur" in [shutter]', 'did you mean "exposure"?')),
        ("[psf]\npreest = 'ideal'", ('unknown key "preest" in [psf]', 'did you mean "preset"?')),
        ("[sensor.dark]\nmedin = 1", ('"medin" in [sensor.dark]', 'did you mean "median"?')),
        ("[shutter]\nexposure = 0.2", ("shutter.exposure", "a quantity in s", "got 0.2")),
        ('[shutter]\nexposure = "0.2 m"', ("shutter.exposure", "a quantity in s", "length")),
        ('[shutter]\nexposure = "-1 s"', ("shutter.exposure", "1e-05 to 3600 s")),
        ('[shutter]\ndirection = "left"', ("shutter.direction", "one of down, up, alternating")),
        ("frames = 2.5", ("frames: expected an integer", "2.5")),
        ("frames = true", ("frames: expected an integer", "True")),
        ('frames = "6"', ("frames: expected an integer", "'6'")),
        ("seed = -1", ("seed", "0 to")),
        ("shutter = 3", ("shutter: expected a table",)),
        ("[sensor]\nprnu = inf", ("sensor.prnu", "finite")),
        (
            '[population]\npreset = "smoke_wide"',
            ('population.preset: "smoke_wide" is a preset of [instrument]', "presets of [population]: none"),
        ),
        (
            '[instrument]\npreset = "extremadura"',
            ('"extremadura" is a preset of [platform]', "presets of [instrument]: art_like"),
        ),
        (
            '[instrument]\npreset = "nonsuch"',
            ('there is no preset "nonsuch"', "presets of [instrument]: art_like, sboc_like, smoke"),
        ),
        ('preset = "sboc_like"', ("preset: stands outside of a table", "inside one, such as [instrument]")),
        ("[instrument]\nfocal_length = 750", ("instrument.focal_length", '(1 to 100000 mm), such as "750 mm", got 750')),
        ("[pointing]\nra = 150 deg", ("at line 2", ": ra = 150 deg; texts and", 'are written in quotes: ra = "150 deg"')),
        ("[pointing]\nlaw = inertial", ('are written in quotes: law = "inertial"',)),
        ("frames = 1 2", ("not valid TOML", ": frames = 1 2")),
        ('[instrument]\npreset = "../../etc/passwd"', ("there is no preset",)),
        ('[onboard.detector]\nuse = "nonsuch"', ('no step is called "nonsuch"', "line_integral", "lsd")),
        ('[onboard.detector]\nuse = "lsd"\nn_sgma = 3', ('[onboard.detector] use = "lsd"', 'unknown key "n_sgma"')),
        ("[onboard]\ndetecter = 3", ('unknown key "detecter" in [onboard]', 'did you mean "detector"?', "star_extractor", "roi")),
        ("[ground.linkr]\nuse = 3", ('unknown key "linkr" in [ground]', 'did you mean "linker"?')),
        ("[onboard]\ndetector = 3", ("onboard.detector: expected a table",)),
        ("[onboard.detector]\nuse = 3", ("onboard.detector.use: expected the name of a step",)),
        ("", ("holds no key", "frames = 6")),
        ("# frames = 6\n", ("holds no key",)),
        (
            '[ground.orbit]\nnearest = "100 km"\nfarthest = "50 km"',
            ("[ground.orbit]: nearest: 100 km; allowed is less than farthest, 50 km",),
        ),
        (
            "[ground.orbit]\ntail_share = 0.7\nring_share = 0.4",
            ("[ground.orbit]: tail_share and ring_share: 0.7 and 0.4; allowed is a sum of 1 at most",),
        ),
        ("a = [", ("not valid TOML",)),
        ("a = 1\na = 2", ("not valid TOML",)),
    ],
)
def test_what_is_wrong_is_said_in_one_line(tmp_path: Path, text: str, words: tuple[str, ...]) -> None:
    message = refusal(tmp_path, text)
    assert message.startswith(str(tmp_path))
    for word in words:
        assert word in message


@pytest.mark.parametrize(
    ("override", "words"),
    [("frames", "expected key=value"), ("=3", "expected key=value"), ("seed.x=3", '"seed" in "seed.x" is not a table')],
)
def test_a_wrong_override_is_said_in_one_line(tmp_path: Path, override: str, words: str) -> None:
    assert words in refusal(tmp_path, "seed = 1", override)


@pytest.mark.parametrize(
    ("typed", "words"),
    [
        ({"overrides": ["seed=2", "frames=abc", "frame_rate=1 Hz"]}, "--set frames=abc: frames: expected an integer, got 'abc'"),
        ({"overrides": ["onboard.detector.n_sgma=7"]}, "--set onboard.detector.n_sgma=7: [onboard.detector]"),
        (
            {"use": {"onboard.detector": "treshold"}},
            '--use onboard.detector=treshold: onboard.detector: no step is called "tresh',
        ),
        ({"seed": -1, "overrides": ["frames=2"]}, "--seed -1: seed: "),
    ],
)
def test_a_refusal_names_what_was_typed(tmp_path: Path, typed: dict[str, Any], words: str) -> None:
    with pytest.raises(UserError) as caught:
        scenario.load(written(tmp_path, "seed = 1"), registry=REGISTRY, **typed)
    assert str(caught.value).startswith(words)
    with pytest.raises(UserError) as caught:
        scenario.load(written(tmp_path, "sed = 1"), registry=REGISTRY, **typed)
    assert str(caught.value).startswith(f"{tmp_path}/mine.toml: ")


def test_a_preset_that_was_typed_is_named_as_typed(tmp_path: Path) -> None:
    assert refusal(tmp_path, "seed = 1", "psf.preset=nope").startswith('--set psf.preset=nope: there is no preset "nope"')
    assert refusal(tmp_path, "seed = 1", "psf.preset=smoke_wide").startswith('--set psf.preset=smoke_wide: "smoke_wide" is a')
    assert refusal(tmp_path, '[psf]\npreset = "nope"').startswith(f"{tmp_path}/mine.toml: psf.preset: there is no preset")


def test_without_a_file_a_preset_is_refused_by_its_reason() -> None:
    with pytest.raises(UserError, match=r"^--set psf\.preset=ideal: a preset is not taken here"):
        bare("process", {}, registry=REGISTRY, overrides=["psf.preset=ideal"])


def test_a_step_that_was_typed_hides_the_options_of_the_files(tmp_path: Path) -> None:
    path = written(tmp_path, '[onboard.detector]\nuse = "threshold"\nn_sigma = 7.5\n')
    chosen = {"onboard.detector": "threshold"}
    own = shown.text(scenario.load(path, registry=REGISTRY))
    used = shown.text(scenario.load(path, registry=REGISTRY, use=chosen))
    tuned = shown.text(scenario.load(path, registry=REGISTRY, use=chosen, overrides=["onboard.detector.n_sigma=6"]))
    texts = (text.partition("[onboard.detector]")[2].splitlines() for text in (own, used, tuned))
    lines = [next(line for line in text if line.startswith("n_sigma = ")) for text in texts]
    assert lines[0].startswith("n_sigma = 7.5")
    assert lines[0].endswith("; from mine.toml")
    assert lines[1].startswith("n_sigma = 3.5")
    assert "from" not in lines[1]
    assert lines[2].startswith("n_sigma = 6.0")
    assert lines[2].endswith("; from --set")


def test_missing_large_and_binary_files_are_refused(tmp_path: Path) -> None:
    for path, words in (
        (tmp_path / "none.toml", "no such scenario file"),
        (tmp_path / "large.toml", "larger than"),
        (tmp_path / "binary.toml", "not a text file"),
    ):
        if path.stem == "large":
            path.write_bytes(b"#" * (toml_files.MAX_FILE_BYTES + 1))
        if path.stem == "binary":
            path.write_bytes(b"\xff\xfe\x00")
        with pytest.raises(UserError, match=words):
            scenario.load(str(path), registry=REGISTRY)
    with pytest.raises(UserError, match='did you mean "smoke"'):
        scenario.load("smok", registry=REGISTRY)


def test_recreated_frames_are_listed_and_found_by_name() -> None:
    assert {"smoke", "validation/saao_ystar", "validation/opd_ixon"} <= set(scenario.available())
    assert scenario.load("validation/saao_ystar", registry=REGISTRY).name == "saao_ystar"
    with pytest.raises(UserError, match="no such scenario file"):
        scenario.load("validation/nothing", registry=REGISTRY)


def test_deep_nesting_is_refused_without_a_traceback(tmp_path: Path) -> None:
    assert refusal(tmp_path, "a = " + "[" * 5000 + "]" * 5000)
    assert refusal(tmp_path, "[" + ".".join("a" * 5000) + "]\nb = 1")


def test_the_committed_schema_is_current() -> None:
    assert schema.COMMITTED.read_text() == schema.text(), "run: sboc schema > scenarios/schema.json"


def test_the_schema_knows_every_key_of_the_resolved_scenarios() -> None:
    tables = schema.schema()
    for name in scenario.available():
        for key in scenario.load(name, registry=REGISTRY).document():
            assert key in tables["properties"]


@dataclass(frozen=True, kw_only=True)
class Inner:
    size_mm: float = 1.0


@dataclass(frozen=True, kw_only=True)
class Everything:
    """All kinds of options."""

    count: int = field(default=3, metadata={"min": 1, "max": 9, "doc": "how many"})
    width_px: int = 4
    rate_hz: float = 2.0
    share: float | None = None
    name: str = "a"
    on: bool = True
    pair_km: tuple[float, float] = (1.0, 2.0)
    inner: Inner = field(default_factory=lambda: Inner(size_mm=7.0))
    many: tuple[Inner, ...] = ()
    drift_s: float = 1.0
    drift_px: float = 1.0


def built(table: dict[str, object]) -> Everything:
    model = option_models.validate(option_models.model_of(Everything), table, "here")
    result: Everything = option_models.build(Everything, model, "here")
    return result


def test_every_kind_of_option_is_read() -> None:
    assert built({}) == Everything()
    everything = built(
        {
            "count": 5, "width": "8 px", "rate": "2 kHz", "share": 1, "name": "b", "on": False, "pair": ["3 km", "4000 m"],
            "inner": {}, "many": [{"size": "1 cm"}, {}], "drift_s": "3 s", "drift_px": "2 px",
        }
    )  # fmt: skip
    assert everything == Everything(
        count=5, width_px=8, rate_hz=2000.0, share=1.0, name="b", on=False, pair_km=(3.0, 4.0),
        inner=Inner(size_mm=7.0), many=(Inner(size_mm=10.0), Inner()), drift_s=3.0, drift_px=2.0,
    )  # fmt: skip
    assert built(option_models.to_document(everything)) == everything


def test_fractions_of_whole_units_are_refused() -> None:
    with pytest.raises(UserError, match="whole number of px"):
        built({"width": "8.5 px"})


@given(
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
        max_leaves=8,
    ),
    st.sampled_from(["count", "width", "rate", "share", "name", "on", "pair", "inner", "many", "what"]),
)
def test_any_table_is_options_or_one_line(value: object, key: str) -> None:
    try:
        assert isinstance(built({key: value}), Everything)
    except UserError as error:
        assert str(error).startswith("here: ")
