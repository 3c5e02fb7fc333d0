"""Checks of contract fields: each returns the accepted value or raises a `ContractError` that names the field."""

import math
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from sboc_e2e.icd.errors import ContractError


def array(field: str, value: Any, dtype: DTypeLike, shape: tuple[int | None, ...]) -> NDArray[Any]:
    """A read-only array of the wanted dtype and shape (None: any length); views are not copied.

    Numbers that are no integers of the wanted dtype are refused, and none is cut to fit. Of floats precision may be lost.
    """
    target = np.dtype(dtype)
    try:
        given = np.asarray(value)
        if target.kind in "iu" and not np.can_cast(given.dtype, target, "safe"):
            _refuse_other_numbers(field, given, target)
        out = given.astype(target, copy=False)
    except (TypeError, ValueError, OverflowError) as error:
        raise ContractError(f"{field}: expected an array of {target}, got {type(value).__name__}") from error
    fits = out.ndim == len(shape) and all(want is None or want == got for want, got in zip(shape, out.shape, strict=True))
    if not fits:
        wanted = "(" + ", ".join("any" if n is None else str(n) for n in shape) + ")"
        raise ContractError(f"{field}: expected shape {wanted}, got {out.shape}")
    if out.flags.writeable:
        out = out.view()
        out.flags.writeable = False
    return out


def _refuse_other_numbers(field: str, given: NDArray[Any], target: np.dtype[Any]) -> None:
    """Raises ContractError unless the integer dtype holds every given number exactly, and TypeError for what is no number."""
    if given.dtype.kind not in "iuf":
        raise TypeError(given.dtype)
    if not given.size:
        return
    limits = np.iinfo(target)
    # As Python numbers: 2**63 and the largest int64 compare equal as float64. NaN is in no range.
    low, high = given.min().item(), given.max().item()
    if not (limits.min <= low and high <= limits.max):
        raise ContractError(f"{field}: expected {target}, {limits.min} to {limits.max}, got {low} to {high}")
    if given.dtype.kind == "f" and (fractions := np.count_nonzero(given != np.trunc(given))):
        raise ContractError(f"{field}: expected {target}, got {fractions} numbers that are not whole")


def same_length(record: str, **columns: NDArray[Any]) -> int:
    """The common length of a record's columns."""
    lengths = {name: len(column) for name, column in columns.items()}
    if len(set(lengths.values())) > 1:
        raise ContractError(f"{record}: columns differ in length: {lengths}")
    return next(iter(lengths.values()), 0)


def finite(field: str, value: float) -> float:
    """A finite float."""
    if not math.isfinite(value):
        raise ContractError(f"{field}: expected a finite number, got {value}")
    return float(value)


def finite_array(field: str, value: Any, shape: tuple[int | None, ...]) -> NDArray[np.float64]:
    """A read-only float64 array without NaN or infinity."""
    out = array(field, value, np.float64, shape)
    if not np.isfinite(out).all():
        raise ContractError(f"{field}: expected finite numbers, got {int((~np.isfinite(out)).sum())} that are not")
    return out


def within(field: str, value: float, low: float, high: float) -> float:
    """A number of the closed interval [low, high]."""
    if not low <= value <= high:
        raise ContractError(f"{field}: expected a value in [{low}, {high}], got {value}")
    return value


def unit_quaternion(field: str, value: Any) -> NDArray[np.float64]:
    """A scalar-last quaternion whose norm is 1 to 1e-6."""
    out = finite_array(field, value, (4,))
    norm = float(np.sqrt(np.sum(out * out)))
    if abs(norm - 1.0) > 1e-6:
        raise ContractError(f"{field}: expected a quaternion of norm 1, got norm {norm:.9f}")
    return out
