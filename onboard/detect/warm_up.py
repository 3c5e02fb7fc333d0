"""Compile the detectors' kernels once, on a frame small enough to cost nothing."""

import numpy as np

from onboard.detect.line_integral import LineIntegralDetector
from onboard.detect.threshold import ThresholdDetector
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.signals import BackgroundModel, DetectorView, StarList


def warm_up() -> None:
    """Run every compiled kernel on a 96 x 96 frame with one trail and two stars; the machine code is cached on disk."""
    size = 96
    row, col = np.mgrid[:size, :size].astype(np.float64)
    residual = 3.0 * np.exp(-0.5 * ((row - 20.0 - 0.6 * col) / 0.9) ** 2)
    residual += np.where((row.astype(np.int64) + col.astype(np.int64)) % 2 == 0, 0.5, -0.5)
    two = np.array([70.0, 80.0])
    stars = StarList(row=two, col=two[::-1], flux_e=two, snr=np.array([40.0, 9.0]), flags=np.zeros(2, np.uint8))
    mesh = np.ones((2, 2), np.float32)
    view = DetectorView(
        header=FrameHeader(frame=0, t_start_tai_ns=0, exposure_ns=1, line_time_ns=0, rows=size, cols=size),
        residual_adu=residual.astype(np.float32), background=BackgroundModel(tile_px=64, level_adu=mesh, sigma_adu=mesh),
        mask=np.zeros((size, size), np.uint8), stars=stars, psf_sigma_px=0.85,
    )
    LineIntegralDetector().detect(view)
    ThresholdDetector().detect(view)
