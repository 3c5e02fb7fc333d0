"""Dark, flat and defects of the window that a frame covers."""

from dataclasses import replace

import numpy as np

from sboc_e2e.icd.frame import Calibration, FrameHeader, NominalCamera


def calibration_of(given: Calibration | None, camera: NominalCamera, header: FrameHeader | None) -> Calibration:
    """Calibration of the window that a frame covers.

    Without a header it covers the whole camera. If no calibration was given, it is an ideal one.
    """
    if given is None:
        rows, cols = (camera.rows, camera.cols) if header is None else (header.rows, header.cols)
        return ideal_calibration(replace(camera, rows=rows, cols=cols))
    rows, cols = given.dark_adu.shape
    if header is None or (header.rows, header.cols) == (rows, cols):
        return given
    whole, (row0, col0) = given.camera, header.corner_in((rows, cols))
    window = np.s_[row0 : row0 + header.rows, col0 : col0 + header.cols]
    return Calibration(
        camera=replace(
            whole,
            rows=header.rows,
            cols=header.cols,
            center_row=whole.center_row - row0,
            center_col=whole.center_col - col0,
        ),
        dark_adu=given.dark_adu[window],
        flat=given.flat[window],
        defects=given.defects[window],
        provenance=given.provenance,
    )


def ideal_calibration(camera: NominalCamera) -> Calibration:
    """No dark, a flat of 1, no defects, without holding a frame's worth of memory."""
    shape = (camera.rows, camera.cols)
    return Calibration(
        camera=camera,
        dark_adu=np.broadcast_to(np.float32(0.0), shape),
        flat=np.broadcast_to(np.float32(1.0), shape),
        defects=np.broadcast_to(np.uint8(0), shape),
        provenance="none",
    )
