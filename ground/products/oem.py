"""CCSDS Orbit Ephemeris Message 2.0 (502.0-B-2), KVN: the smoothed orbit of the observer that orbits are computed with."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ground.options import ProductOptions
from ground.orbit.observer import ObserverArc, observer_orbit
from ground.products.ccsds_covariance import triangle_lines, turned
from ground.products.epochs import utc_text
from ground.sky.eme2000 import frame_bias
from sboc_e2e.icd.frame import FrameHeader

_STEP_NS: Final = 1_000_000_000
"""One second: readers that interpolate linearly err by 1 m in a low orbit (8 m/s^2 / 8), Hermite by far less."""
_COVARIANCE_STEP: Final = 10
"""A covariance for every tenth state, the first and the last."""


def oem_text(headers: Sequence[FrameHeader], names: ProductOptions) -> str | None:
    """The message: a state for each second of each arc, from first frame or fix to last; None when no frame has a state."""
    orbit = observer_orbit(headers)
    if orbit is None:
        return None
    frames_ns = [_exposed_ns(h) for h in headers]
    lines = [
        "CCSDS_OEM_VERS = 2.0",
        f"CREATION_DATE = {utc_text([max(h.t_start_tai_ns for h in headers)], 3)[0]}",
        f"ORIGINATOR = {names.originator}",
        "",
    ]
    for arc in orbit.arcs:
        lines += _segment(arc, _span(arc, frames_ns), names)
    return "\n".join(lines) + "\n"


def metadata_lines(name: str, identifier: str, epochs: Sequence[str], *, degree: int, comments: Sequence[str] = ()) -> list[str]:
    """Metadata of states in EME2000 at UTC epochs, to be interpolated by Hermite polynomials of this degree."""
    return [
        "META_START",
        *(f"COMMENT {text}" for text in comments),
        f"OBJECT_NAME = {name}",
        f"OBJECT_ID = {identifier}",
        "CENTER_NAME = EARTH",
        "REF_FRAME = EME2000",
        "TIME_SYSTEM = UTC",
        f"START_TIME = {epochs[0]}",
        f"STOP_TIME = {epochs[-1]}",
        "INTERPOLATION = HERMITE",
        f"INTERPOLATION_DEGREE = {degree}",
        "META_STOP",
        "",
    ]


def state_lines(epochs: Sequence[str], states: NDArray[np.float64]) -> list[str]:
    """A line an epoch: position (km) to 1 mm and velocity (km/s) to 1 um/s. states : (n, 6)."""
    return [
        f"{epoch} " + " ".join([f"{x:.6f}" for x in state[:3]] + [f"{v:.9f}" for v in state[3:]])
        for epoch, state in zip(epochs, states, strict=True)
    ]


def _exposed_ns(header: FrameHeader) -> tuple[int, int]:
    """First opening and last closing of the shutter on any row, TAI ns. A frame read from its last row opens there first."""
    last_row_ns = header.t_start_tai_ns + header.line_time_ns * (header.rows - 1)
    return min(header.t_start_tai_ns, last_row_ns), max(header.t_start_tai_ns, last_row_ns) + header.exposure_ns


def _span(arc: ObserverArc, frames_ns: Sequence[tuple[int, int]]) -> tuple[int, int]:
    """Whole seconds of TAI (ns) that hold the fixes of an arc and the exposures within its reach."""
    low, high = int(arc.t_tai_ns[0]), int(arc.t_tai_ns[-1])
    first = min([arc.first_tai_ns, *(start for start, _ in frames_ns if low <= start <= high)])
    last = max([arc.last_tai_ns, *(stop for _, stop in frames_ns if low <= stop <= high)])
    return first // _STEP_NS * _STEP_NS, -(-last // _STEP_NS) * _STEP_NS


def _segment(arc: ObserverArc, span_ns: tuple[int, int], names: ProductOptions) -> list[str]:
    """Metadata, states and covariances of an arc; two states at least, so that a reader may interpolate."""
    first, last = span_ns
    t_ns = np.arange(first, max(last, first + _STEP_NS) + 1, _STEP_NS, dtype=np.int64)
    bias = frame_bias()
    states = arc.states(t_ns)
    states = np.hstack([states[:, :3] @ bias.T, states[:, 3:] @ bias.T])
    covariance = [turned(matrix, bias) for matrix in arc.covariances(t_ns)]
    epochs = utc_text(t_ns)
    lines = [
        *metadata_lines(names.observer_name, names.observer_id, epochs, degree=3, comments=_how_made(arc)),
        *state_lines(epochs, states),
    ]
    lines += ["", "COVARIANCE_START"]
    for k in sorted({*range(0, len(t_ns), _COVARIANCE_STEP), len(t_ns) - 1}):
        lines += [f"EPOCH = {epochs[k]}", "COV_REF_FRAME = EME2000", *triangle_lines(covariance[k])]
    return [*lines, "COVARIANCE_STOP", ""]


def _how_made(arc: ObserverArc) -> list[str]:
    """COMMENT lines that describe the states to a reader who has only the message."""
    if arc.kind == "site":
        motion = "a point that turns with the Earth about the pole of date"
    else:
        motion = f"two-body motion, J2, an unmodelled acceleration of {1e6 * arc.push_km_s2:.2g} mm/s2 (one sigma, over 600 s)"
    position, velocity = arc.scatter
    return [
        f"Smoothed orbit of the observer, the one that all orbits were computed with: {motion}",
        f"Least squares (filter and smoother) through {arc.n_fixes} telemetered fixes; {arc.n_rejected} outliers left out",
        f"Fresh errors of the fixes: {position:.2f} (positions), {velocity:.2f} (velocities) of the stated sigma; the rest of it "
        "is taken as common to all and is in the covariance",
        "Epochs are those of the on-board clock",
    ]
