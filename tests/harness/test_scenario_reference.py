"""The reference of all keys, the defaults of the schema, and resolved scenarios with comments."""

import tomllib
from pathlib import Path
from typing import Any

import pytest

from sboc_e2e import scenario
from sboc_e2e.cli.main import run
from sboc_e2e.icd.errors import UserError
from sboc_e2e.registry import SEAMS, Registry, own_names
from sboc_e2e.scenario import document, option_models, reference, schema, shown
from sboc_e2e.scenario.document import HarnessOptions, from_document
from simulator.options import SimulatorOptions

PAGE = Path(__file__).resolve().parents[2] / "docs/scenario-reference.md"
REGISTRY = Registry()


def test_the_page_is_current() -> None:
    made = "python -m sboc_e2e.scenario.reference docs/scenario-reference.md"
    assert PAGE.read_text(encoding="utf-8") == reference.page(), f"run: {made}"


def test_the_page_has_every_key_with_a_meaning() -> None:
    text = reference.page()
    names = list(document.default_texts())
    assert len(names) > 230
    for name in names:
        assert f"| `{name.rpartition('.')[2]}` |" in text, name
    for seam in SEAMS:
        for name in own_names(seam):
            for field in option_models.option_fields(REGISTRY.resolve(seam, name)):
                assert "doc" in field.meta, f"{seam} {name}: {field.name} has no meaning"


def defaults(node: Any) -> list[Any]:
    if isinstance(node, dict):
        own = [node["default"]] if "default" in node and "properties" not in node else []
        return own + [value for below in node.values() for value in defaults(below)]
    return [value for below in node for value in defaults(below)] if isinstance(node, list) else []


def test_the_schema_states_defaults() -> None:
    """All 335 defaults were null, so that an editor showed nothing."""
    tables = schema.schema()
    found = defaults(tables)
    assert len(found) > 300
    assert None not in found
    assert tables["$defs"]["ShutterOptions"]["properties"]["exposure"]["default"] == "0.2 s"


def test_defaults_of_the_schema_are_those_of_a_run() -> None:
    """A scenario that gives the schema's defaults is the scenario that gives nothing."""
    tables = schema.schema()
    given: dict[str, Any] = {}
    for field in (*option_models.option_fields(HarnessOptions), *option_models.option_fields(SimulatorOptions)):
        found = tables["properties"][field.key]
        if option_models.is_options(field.hint):
            properties = tables["$defs"][found["$ref"].rpartition("/")[2]]["properties"]
            given[field.key] = {key: value["default"] for key, value in properties.items() if "default" in value}
        else:
            given[field.key] = found["default"]
    made = from_document(given, name="given", registry=REGISTRY, where="given")
    assert made.simulator == SimulatorOptions()


@pytest.mark.parametrize("name", sorted(scenario.available()))
def test_a_shown_scenario_is_the_same_scenario(name: str) -> None:
    resolved = scenario.load(name, registry=REGISTRY)
    text = shown.text(resolved)
    again = from_document(tomllib.loads(text), name=resolved.name, registry=REGISTRY, where="shown")
    assert again == resolved


def test_a_shown_scenario_says_where_values_are_from(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('frames = 2\n[instrument]\npreset = "smoke_wide"\nrows = 300\n')
    assert run(["scenarios", "show", str(path), "--set", "seed=4", "--use", "onboard.detector=lsd"]) == 0
    lines = capsys.readouterr().out.splitlines()

    def line(start: str) -> str:
        return next(line for line in lines if line.startswith(start))

    assert line("frames =").endswith("from mine.toml")
    assert line("rows =").startswith("rows = 300 ")
    assert line("rows =").endswith("from mine.toml")
    assert line("cols =").endswith("from preset smoke_wide")
    assert line("seed =").endswith("from --set")
    assert line('use = "lsd"').endswith("from --use")
    assert run(["scenarios", "show", "smok"]) == 2


def test_a_shown_scenario_whose_exposure_does_not_fit_is_refused_after_its_keys(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('frame_rate = "2 Hz"\n[shutter]\nexposure = "0.7 s"\n')
    assert run(["scenarios", "show", str(path)]) == 2
    shown_text = capsys.readouterr()
    assert 'exposure = "0.7 s"' in shown_text.out
    assert shown_text.err.splitlines() == [
        "sboc: scenario mine: shutter.exposure: 0.7 s does not fit 2 frames/s; allowed is up to 0.5 s"
    ]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            '[sensor.converter]\ngain = "20 e-/ADU"',
            "(sensor.converter.low_gain is not in the scenario; its default is 10.0 e-/ADU)",
        ),
        ('[instrument]\npreset = "art_like"\nband_short = "900 nm"', "(instrument.band_long is from preset art_like)"),
        ('[sensor]\nfull_well = "3 e-"', "[sensor.converter] has such a key"),
        ('[objects]\npassing = {name = "a"}', "expected an array"),
        ("epoch_utc = 2027-01-29T00:00:00", "a string, in quotes"),
        ('[population]\nnearest = "5000 km"', "population.nearest: 5000.0 km must be below population.farthest, 3000.0 km"),
    ],
)
def test_a_refusal_says_what_the_user_did_not_write(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(UserError) as caught:
        scenario.load(str(path), registry=REGISTRY)
    assert words in str(caught.value)


def test_keys_that_contradict_each_other_in_a_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('frames = 1\nframe_rate = "30 Hz"')
    assert run(["run", str(path), "--out", str(tmp_path / "run")]) == 2
    assert "(shutter.line_time is not in the scenario; its default is 10.0 us)" in capsys.readouterr().err


def test_a_file_beside_the_scenario_is_found_from_anywhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mine.toml").write_text('[objects.satellites]\nfile = "mine.3le"')
    (tmp_path / "mine.3le").write_text("")
    monkeypatch.chdir("/")
    resolved = scenario.load(str(tmp_path / "mine.toml"), registry=REGISTRY)
    assert Path(resolved.simulator.objects.satellites.file) == tmp_path / "mine.3le"
