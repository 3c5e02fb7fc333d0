"""Quantity strings: units of the right dimension, exact round trips, messages that name the expected unit."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sboc_e2e.scenario import quantities
from sboc_e2e.scenario.quantities import QuantityError, parse, split_name, write


@pytest.mark.parametrize(
    ("name", "key", "unit"),
    [
        ("exposure_s", "exposure", "s"),
        ("stray_light_e_px_s", "stray_light", "electron / (pix s)"),
        ("photons_v0_m2_s", "photons_v0", "1 / (m2 s)"),
        ("gain_e_adu", "gain", "electron / adu"),
        ("n_sigma", "n_sigma", None),
        ("rows", "rows", None),
        ("m", "m", None),
    ],
)
def test_the_key_is_the_name_without_its_longest_unit_suffix(name: str, key: str, unit: str | None) -> None:
    assert split_name(name) == (key, unit)


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("200 ms", "s", 0.2),
        ("0.2s", "s", 0.2),
        ("-5 deg", "deg", -5.0),
        ("3600 arcsec", "deg", 1.0),
        ("1.2 e-/ADU", "electron / adu", 1.2),
        ("4 px", "pix", 4.0),
        ("2 /deg2", "1 / deg2", 2.0),
        ("1e3 m", "km", 1.0),
        ("150 ppm", "1e-6", 150.0),
    ],
)
def test_a_quantity_is_converted(text: str, unit: str, value: float) -> None:
    assert math.isclose(parse(text, unit), value, rel_tol=1e-14)


@pytest.mark.parametrize("unit", sorted(set(quantities.UNIT_SUFFIXES.values())))
@given(value=st.floats(allow_nan=False, allow_infinity=False, min_value=-1e30, max_value=1e30))
def test_what_is_written_reads_back_to_the_same_number(unit: str, value: float) -> None:
    assert parse(write(value, unit), unit) == value


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (0.2, 'such as "0.2 s", got 0.2'),
        (5, 'such as "5 s", got 5'),
        ("5", 'such as "5 s", got "5" without a unit'),
        ("0.2 m", 'such as "1 s", got "0.2 m" (length)'),
        ("0.2 furlongs", "unknown unit"),
        ("1 s^999999999", "unknown unit"),
        ("1e999 s", "got '1e999 s'"),
        ("", "expected a quantity in s"),
        (True, "got True"),
        ("nan s", "expected a quantity in s"),
        ("1 " + "s*" * 100, "expected a quantity in s"),
    ],
)
def test_a_wrong_value_is_refused_in_one_line(value: object, words: str) -> None:
    with pytest.raises(QuantityError) as caught:
        parse(value, "s")
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 300


def test_a_refusal_names_the_range() -> None:
    with pytest.raises(QuantityError, match=r'a quantity in mm \(1 to 100000 mm\), such as "750 mm", got 750'):
        parse(750, "mm", "1 to 100000 mm")


@given(st.text(max_size=120))
def test_any_text_is_a_number_or_a_refusal(text: str) -> None:
    try:
        assert math.isfinite(parse(text, "deg / s"))
    except QuantityError as error:
        assert "\n" not in repr(str(error)).strip("'")
