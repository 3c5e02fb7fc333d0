"""The fuzz targets on generated input: nothing but frames, scenarios, values and one-line refusals comes out."""

import io
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from hypothesis import example, given, settings
from hypothesis import strategies as st

from ground.ingest import decode_downlink
from sboc_e2e.icd import layout
from sboc_e2e.icd.errors import UserError
from sboc_e2e.outside.fits_frames import FitsFolder
from sboc_e2e.registry import Registry
from tests.fuzz import codecs, packets, scenario, seeds
from tests.fuzz import fits as fits_target

CARDS = (
    "NAXIS",
    "NAXIS1",
    "BITPIX",
    "BZERO",
    "BSCALE",
    "GAIN",
    "EXPTIME",
    "DATE-OBS",
    "CTYPE1",
    "CRVAL1",
    "CD1_1",
    "ZNAXIS1",
    "MJD-OBS",
)


@given(st.binary(max_size=400))
@example(b"")
def test_any_bytes_are_a_downlink_or_reported(data: bytes) -> None:
    packets.one_input(data)


@given(st.binary(max_size=400))
def test_any_bytes_are_a_block_or_refused(data: bytes) -> None:
    codecs.one_input(data)


@settings(max_examples=30)
@given(st.binary(max_size=300))
@example(b"")
def test_any_bytes_are_a_fits_file_or_refused(data: bytes) -> None:
    fits_target.one_input(data)


TABLES = st.dictionaries(
    st.sampled_from(["seed", "frames", "instrument", "onboard", "ground", "shutter", "x"]),
    st.one_of(
        st.integers(), st.booleans(), st.floats(), st.text(max_size=10),
        st.dictionaries(st.sampled_from(["preset", "rows", "detector", "use", "exposure"]), st.text(max_size=10), max_size=3),
    ),
    max_size=4,
)  # fmt: skip


@given(TABLES)
def test_any_tables_are_a_scenario_or_refused(tables: dict[str, object]) -> None:
    lines = [f"{key} = {_toml(value)}" for key, value in tables.items()]
    scenario.one_input("\n".join(lines).encode("utf-8", errors="replace"))


@given(st.binary(max_size=200))
def test_any_bytes_are_a_scenario_or_refused(data: bytes) -> None:
    scenario.one_input(data)


def _toml(value: object) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {_toml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, bool):
        return str(value).lower()
    return repr(value) if not isinstance(value, str) else '"' + value.replace("\\", "").replace('"', "") + '"'


@settings(max_examples=40)
@given(
    st.lists(
        st.tuples(st.sampled_from(CARDS), st.one_of(st.integers(-(10**6), 10**6), st.floats(), st.text("ab01-:T ", max_size=20)))
    ),
    st.integers(0, 3000),
)
def test_a_damaged_header_is_frames_or_one_line(cards: list[tuple[str, object]], cut: int) -> None:
    stream = io.BytesIO()
    fits.PrimaryHDU(np.arange(400, dtype=np.int16).reshape(20, 20)).writeto(stream)
    data = bytearray(stream.getvalue())
    for k, (key, value) in enumerate(cards[:20]):
        text = f"{key:<8}= {str(value)[:60]:>20}"[:80].ljust(80)
        data[80 * (6 + k) : 80 * (7 + k)] = text.encode("ascii", errors="replace")
    fits_target.one_input(bytes(data[: len(data) - cut]))


def test_an_image_that_claims_to_be_huge_is_refused_before_it_is_read(tmp_path: Path) -> None:
    header = fits.PrimaryHDU(np.zeros((20, 20), np.int16)).header
    header["NAXIS1"], header["NAXIS2"] = 60000, 60000
    path = tmp_path / "huge.fits"
    path.write_bytes(header.tostring().encode())
    with pytest.raises(UserError, match="60000 x 60000; allowed are sides of 16 to 16384 px"):
        FitsFolder(path=path).frames().__next__()


TARGETS = {"packets": packets, "codecs": codecs, "fits": fits_target, "scenario": scenario}
FOUND = sorted(path for path in seeds.FOUND.rglob("*") if path.is_file())


@pytest.mark.parametrize("path", FOUND, ids=[f"{path.parent.name}/{path.name}" for path in FOUND])
def test_inputs_that_once_found_something_find_nothing_more(path: Path) -> None:
    TARGETS[path.parent.name].one_input(path.read_bytes())


@pytest.mark.parametrize("target", sorted(seeds.SEEDS))
def test_fuzzing_begins_with_inputs_that_are_valid_and_short(target: str) -> None:
    inputs = list(seeds.SEEDS[target]())
    assert inputs
    for data in inputs:
        assert 0 < len(data) <= seeds.MAX_BYTES[target]
        TARGETS[target].one_input(data)


def test_packets_that_the_fuzz_target_frames_itself_are_of_this_contract() -> None:
    inputs = list(seeds.packets())
    assert inputs
    for data in inputs:
        stream = packets.packet_around(data) if data[0] < len(layout.Apid) else data
        _, report = decode_downlink(stream, packets.DECODERS)
        assert sum(kind["received"] for kind in report.as_dict()["apids"].values()) == 1


def test_control_characters_of_a_file_do_not_reach_the_terminal() -> None:
    with pytest.raises(UserError) as caught:
        Registry().resolve("onboard.detector", "a\n\x1b[31mred\r:B")
    assert str(caught.value).isprintable()
