"""Frames of real telescopes through the on-board chain, without calibration: nothing breaks, the noise is the sky's."""

from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits

from ground.ingest import decode_downlink
from ground.ingest.codecs import PlanesDecoder
from sboc_e2e.icd.frame import Frame, FrameHeader
from tests.onboard.small_run import start_run

NAMES = (
    "decam_raw_cutouts.fits.fz",
    "gmos_stars_cosmics.fits",
    "hsc_wide_defocused_streak.fits",
    "opd_control.fits",
    "sdss_control.fits",
)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.filterwarnings("ignore")  # real headers break FITS rules in many small ways
def test_real_frame_comes_down(shared_data: Path, name: str) -> None:
    """Complete packets; noise of the mesh within a factor 1.6 of that of neighbouring pixels, overscan and stars or not."""
    with fits.open(shared_data / "real" / name) as hdus:
        images = [hdu.data for hdu in hdus if hdu.data is not None and hdu.data.ndim == 2][:4]
    for data in images:
        whole = data.dtype.kind in "iu" and data.min() >= 0 and data.max() < 65536
        pixels = np.ascontiguousarray(data.astype(np.uint16 if whole else np.float32))
        header = FrameHeader(frame=0, t_start_tai_ns=0, exposure_ns=10**9, line_time_ns=0, rows=data.shape[0], cols=data.shape[1])
        run = start_run(with_calibration=False, detections=())
        result = run.feed(Frame(header=header, pixels=pixels))
        frames, report = decode_downlink(run.downlink, [PlanesDecoder()])
        assert report.frames_complete == (0,)
        assert len(frames[0].stars) > 0
        steps = np.abs(np.diff(pixels.astype(np.float64), axis=1))
        local = 1.4826 * float(np.median(steps[np.isfinite(steps)])) / np.sqrt(2.0)
        assert local / 1.6 < result.housekeeping.sigma_adu < 1.6 * local + 0.5 * whole
