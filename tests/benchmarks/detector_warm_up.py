"""Compile the detectors' kernels once, on a frame small enough to cost nothing."""

from dataclasses import replace

import numpy as np

from onboard.detect import LineIntegralDetector, ThresholdDetector
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.signals import BackgroundModel, DetectorView, StarList


def warm_up() -> None:
    """Run every compiled kernel on a 96 x 96 frame with one trail and a few stars; the machine code is cached on disk."""
    size = 96
    row, col = np.mgrid[:size, :size].astype(np.float64)
    residual = 3.0 * np.exp(-0.5 * ((row - 20.0 - 0.6 * col) / 0.9) ** 2)
    residual += np.where((row.astype(np.int64) + col.astype(np.int64)) % 2 == 0, 0.5, -0.5)
    row_star, col_star = np.array([70.0, 80.0, 75.0, 85.0, 66.0, 88.0]), np.array([80.0, 70.0, 20.0, 30.0, 40.0, 12.0])
    snr = np.array([40.0, 9.0, 30.0, 20.0, 10.0, 7.0])
    stars = StarList(row=row_star, col=col_star, flux_e=snr, snr=snr, flags=np.zeros(6, np.uint8))
    mesh = np.ones((2, 2), np.float32)
    view = DetectorView(
        header=FrameHeader(frame=0, t_start_tai_ns=0, exposure_ns=1, line_time_ns=0, rows=size, cols=size),
        residual_adu=residual.astype(np.float32),
        background=BackgroundModel(tile_px=64, level_adu=mesh, sigma_adu=mesh),
        mask=np.zeros((size, size), np.uint8),
        stars=stars,
        psf_sigma_px=0.85,
    )
    LineIntegralDetector().detect(view)
    LineIntegralDetector().detect(replace(view, history=(view,)))
    ThresholdDetector().detect(view)
