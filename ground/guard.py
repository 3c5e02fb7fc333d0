"""Calls of swappable steps. An exception, or a result that breaks the Protocol, stops the run and names the step."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ground.streak_rows import STREAKS_PER_FRAME
from sboc_e2e.icd.errors import ContractError, PluginError, UserError
from sboc_e2e.icd.products import Tracklet


def guarded(seam: str, step: object, where: str, returns: type, call: Callable[..., Any], *arguments: Any) -> Any:
    """Call a method of a step and return its result.

    seam : such as "linker". where : such as "frame 12", or empty. returns : type the result must have. Errors: a `PluginError`
    with the seam, the class and the place for what the step raises, records that break the contract included, and for other
    types; a `UserError` about something that the user can mend passes.
    """
    try:
        result = call(*arguments)
    except PluginError:  # of a step within this one, by name
        raise
    except Exception as error:  # a plug-in may raise anything; it is reported by name
        if isinstance(error, UserError) and not isinstance(error, ContractError):
            raise
        raise fault(seam, step, where, f"{type(error).__name__}: {error}") from error
    if not isinstance(result, returns):
        raise fault(seam, step, where, f"expected {returns.__name__}, got {type(result).__name__}")
    return result


def fault(seam: str, step: object, where: str, what: str) -> PluginError:
    """The error that names a step and the place."""
    name = f"ground.{seam} {type(step).__module__}:{type(step).__qualname__}"
    return PluginError(f"{name}, {where}: {what}" if where else f"{name}: {what}")


def probabilities_of(step: object, where: str, values: Any, n: int) -> NDArray[np.float64]:
    """Probabilities (n,) from a vetter, checked."""
    array = np.asarray(values, dtype=np.float64) if getattr(values, "dtype", None) is not None else None
    if array is None or array.shape != (n,) or not ((array >= 0.0) & (array <= 1.0)).all():
        raise fault("vetter", step, where, f"expected {n} probabilities from 0 to 1")
    return array


def all_of(seam: str, step: object, where: str, values: Any, kind: type) -> tuple[Any, ...]:
    """A sequence whose members are all of a type, as a tuple."""
    if not isinstance(values, tuple | list):
        raise fault(seam, step, where, f"expected a tuple of {kind.__name__}, got {type(values).__name__}")
    for value in values:
        if not isinstance(value, kind):
            raise fault(seam, step, where, f"expected {kind.__name__}, got {type(value).__name__}")
    return tuple(values)


def links_of(step: object, values: Any, counts: Mapping[int, int]) -> tuple[Tracklet, ...]:
    """Tracklets from a linker, checked against the rules of its Protocol.

    counts : streaks of each frame, by frame number.
    """
    tracklets: tuple[Tracklet, ...] = all_of("linker", step, "", values, Tracklet)
    owner: dict[int, int] = {}
    numbers: set[int] = set()
    for tracklet in tracklets:
        where = f"tracklet {tracklet.tracklet_id}"
        if tracklet.tracklet_id in numbers:
            raise fault("linker", step, where, "the id of two tracklets")
        numbers.add(tracklet.tracklet_id)
        frames, streaks = np.asarray(tracklet.frames), np.asarray(tracklet.streak_ids)
        if (
            frames.ndim != 1
            or frames.shape != streaks.shape
            or not {frames.dtype.kind, streaks.dtype.kind} <= {"i", "u"}
            or not len(frames)
        ):
            raise fault("linker", step, where, "expected one or more members, each with integers for frame and streak")
        for frame, streak in zip(frames.tolist(), streaks.tolist(), strict=True):
            if not 0 <= streak - frame * STREAKS_PER_FRAME < counts.get(frame, 0):
                raise fault("linker", step, where, f"streak {streak} of frame {frame} is none of those given")
            if streak in owner:
                raise fault("linker", step, where, f"streak {streak} is in tracklet {owner[streak]} already")
            owner[streak] = tracklet.tracklet_id
        _said_of_members(tracklet, set(streaks.tolist()), step, where)
    return tracklets


def _said_of_members(tracklet: Tracklet, members: set[int], step: object, where: str) -> None:
    """Check the fields of a tracklet that describe its members as a whole. Raises `PluginError` for a contradiction."""
    strangers = sorted(set(np.asarray(tracklet.pieces).tolist()) - members)
    if strangers:
        raise fault("linker", step, where, f"pieces: streak {strangers[0]} is none of its members")
    if not 0.0 <= tracklet.probability <= 1.0:
        raise fault("linker", step, where, f"probability: expected 0 to 1, got {tracklet.probability}")
    if tracklet.direction_resolved and len(set(np.asarray(tracklet.frames).tolist())) == 1:
        t, ra, dec = (np.asarray(values) for values in (tracklet.t_tai_ns, tracklet.ra_deg, tracklet.dec_deg))
        stated = t.shape == ra.shape == dec.shape and t.ndim == 1
        if not stated or len(np.unique(t[np.isfinite(ra) & np.isfinite(dec)])) < 2:
            raise fault(
                "linker", step, where, "direction_resolved: members of one frame do not tell the direction; expected two or more "
                "finite t_tai_ns, ra_deg, dec_deg at different epochs, or False",
            )  # fmt: skip
