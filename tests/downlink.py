"""Frames as the ground receives them, for tests that need few of their parts."""

from typing import Any

from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.flags import FrameFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.signals import StarList


def bare_frame(header: FrameHeader, **parts: Any) -> DownlinkFrame:
    """A frame without flags, stars, regions and images but for the given parts."""
    absent = {"flags": FrameFlag(0), "housekeeping": None, "stars": StarList.empty(), "rois": (), "background": None}
    return DownlinkFrame(header=header, **(absent | {"thumbnail_adu": None, "whole_frame": None} | parts))


def frame_of_psf(psf_sigma_px: float) -> DownlinkFrame:
    """A frame of 4096 x 4096 px that says nothing but its PSF: the vetter goes by the fits alone."""
    header = FrameHeader(frame=0, t_start_tai_ns=1, exposure_ns=200_000_000, line_time_ns=0, rows=4096, cols=4096)
    return bare_frame(header, psf_sigma_px=psf_sigma_px)
