"""The flight page is the code's: limits, counts, parameters."""

from pathlib import Path

from onboard import work
from sboc_e2e.bench.flight_page import PASSES, page

STORED = Path(__file__).resolve().parents[2] / "docs" / "flight.md"


def test_the_flight_page_is_current() -> None:
    assert STORED.read_text(encoding="utf-8") == page(), "run: python -m sboc_e2e.bench.flight_page docs/flight.md"


def test_every_pass_is_in_a_module_of_the_chain() -> None:
    folder = STORED.parents[1] / "onboard"
    for one in PASSES:
        assert all((folder / f"{name}.py").is_file() for name in one.module.split(", ")), one.name


def test_vector_lanes_make_the_passes_what_the_meter_takes_them_for() -> None:
    """172 scalar operations in 10 counted ones: 17 lanes, between those of float32 (8) and of int8 (32) in 256 bits."""
    assert 8.0 < sum(one.operations for one in PASSES) / work.REGULAR_PER_PX < 32.0
