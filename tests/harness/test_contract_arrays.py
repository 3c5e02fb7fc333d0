"""Arrays of the contract: what their dtype does not hold is refused by name, and what it holds arrives unchanged."""

from typing import Any

import numpy as np
import pytest

from sboc_e2e.icd import validate
from sboc_e2e.icd.errors import ContractError
from sboc_e2e.icd.signals import Strip


@pytest.mark.parametrize(
    ("value", "dtype"),
    [
        ([1.5, 2.0], np.int32),
        (np.array([0.0, np.nan]), np.int64),
        (np.array([np.inf]), np.int64),
        (np.array([-np.inf, 1.0], np.float32), np.uint8),
        (np.array([260]), np.uint8),
        ([260], np.uint8),
        ([-1], np.uint16),
        (np.array([-1.0]), np.uint16),
        ([2**31], np.int32),
        (np.array([2.0**63]), np.int64),
        (np.array([2**63], np.uint64), np.int64),
        ([2**70], np.int64),
        ([2**70], np.uint8),
        (["1"], np.int32),
        ([[1, 2], [3]], np.int32),
        ([None], np.int32),
        (["a"], np.float32),
        ([10**400], np.float64),
    ],
)
def test_what_a_dtype_does_not_hold_is_refused_by_name(value: Any, dtype: Any) -> None:
    with pytest.raises(ContractError, match=rf"^record\.column: expected .*{np.dtype(dtype)}"):
        validate.array("record.column", value, dtype, (None,))


@pytest.mark.parametrize(
    ("value", "dtype"),
    [
        (np.array([0, 255]), np.uint8),
        (np.array([0.0, 255.0]), np.uint8),
        ([-(2**63), 2**63 - 1], np.int64),
        (np.array([-(2.0**63), 2.0**62]), np.int64),
        (np.array([2**63 - 1], np.uint64), np.int64),
        (np.array([True, False]), np.uint8),
        (np.array([1, 2], ">u2"), np.uint16),
        ([], np.int32),
        (np.array([0.1, np.nan]), np.float32),
    ],
)
def test_what_a_dtype_holds_arrives_unchanged(value: Any, dtype: Any) -> None:
    out = validate.array("record.column", value, dtype, (None,))
    assert out.dtype == dtype
    assert not out.flags.writeable
    np.testing.assert_array_equal(out, np.asarray(value, dtype))
    if out.dtype.kind != "f":
        assert out.tolist() == [int(v) for v in value]


def test_an_array_of_the_wanted_dtype_is_neither_read_nor_copied(monkeypatch: pytest.MonkeyPatch) -> None:
    """A frame's mask has 16 million values: a pass over them would cost milliseconds a record."""
    monkeypatch.setattr(validate, "_refuse_other_numbers", None)
    mask = np.zeros((4, 3), np.uint8)
    assert np.shares_memory(validate.array("view.mask", mask, np.uint8, (4, 3)), mask)
    assert mask.flags.writeable


@pytest.mark.parametrize(("given", "kept"), [("f2", "f4"), ("f4", "f4"), ("f8", "f4"), (">f4", "f4"), ("i2", "i4"), ("i8", "i4")])
def test_strips_keep_halves_of_adu_whatever_the_width_of_their_floats(given: str, kept: str) -> None:
    values = np.array([[1, 2], [-3, 4]], given)
    if values.dtype.kind == "f":
        values += values.dtype.type(0.5)
    strip = Strip(axis=0, major0=0, minor0_fp=0, slope_fp=0, level_adu=0, values_adu=values)
    assert strip.values_adu.dtype == np.dtype(kept)
    np.testing.assert_array_equal(strip.values_adu, values)
