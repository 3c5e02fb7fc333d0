"""CCSDS Orbit Ephemeris Message 2.0 (502.0-B-2), KVN: where the observer was, as telemetered."""

from collections.abc import Sequence

import numpy as np

from ground.options import ProductOptions
from ground.products.eme2000 import frame_bias
from ground.products.epochs import utc_text
from sboc_e2e.icd.frame import FrameHeader


def oem_text(headers: Sequence[FrameHeader], names: ProductOptions) -> str | None:
    """The message with one state for each distinct telemetry epoch; None when no frame has a state."""
    states = {h.observer.tai_ns: h.observer for h in headers if h.observer is not None}
    if not states:
        return None
    t_ns = sorted(states)
    epochs = utc_text(t_ns)
    bias = frame_bias()
    lines = [
        "CCSDS_OEM_VERS = 2.0",
        f"CREATION_DATE = {utc_text([max(h.t_start_tai_ns for h in headers)], 3)[0]}",
        f"ORIGINATOR = {names.originator}",
        "",
        "META_START",
        f"OBJECT_NAME = {names.observer_name}",
        f"OBJECT_ID = {names.observer_id}",
        "CENTER_NAME = EARTH",
        "REF_FRAME = EME2000",
        "TIME_SYSTEM = UTC",
        f"START_TIME = {epochs[0]}",
        f"STOP_TIME = {epochs[-1]}",
    ]
    if len(t_ns) >= 2:
        lines += ["INTERPOLATION = HERMITE", "INTERPOLATION_DEGREE = 3"]
    lines += ["META_STOP", ""]
    for epoch, t in zip(epochs, t_ns, strict=True):
        position_km = bias @ np.asarray(states[t].position_m) / 1e3
        velocity_km_s = bias @ np.asarray(states[t].velocity_m_s) / 1e3
        numbers = [f"{x:.6f}" for x in position_km] + [f"{v:.9f}" for v in velocity_km_s]
        lines.append(f"{epoch} " + " ".join(numbers))
    return "\n".join(lines) + "\n"
