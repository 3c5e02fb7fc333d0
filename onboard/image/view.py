"""The view of a frame that steps look at: calibrated image, background and mask, then its stars, and the sky beside them."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from onboard.guard import guarded
from onboard.image.calibrate import Counts, LineSums, background_in_adu, fill_residual
from onboard.image.glare import mark_glare
from onboard.image.star_free_sky import without_stars
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.results import check_background, check_stars
from sboc_e2e.icd.signals import DetectorView, StarList
from sboc_e2e.icd.steps import BackgroundEstimator, StarExtractor
from sboc_e2e.icd.work import WorkMeter


def calibrated_view(
    header: FrameHeader,
    counts: Counts,
    residual: NDArray[np.float32],
    step: BackgroundEstimator,
    *,
    psf_sigma_px: float,
    history: tuple[Any, ...],
    work: WorkMeter,
) -> tuple[DetectorView, LineSums, int]:
    """The view without stars, the sums of its lines, and how many pixels are masked; `residual` is filled."""
    # The calibrated image is not made yet. Until then its memory holds the whole ADU of the dark.
    dark = counts.dark.whole_adu(residual.reshape(-1).view(np.int16)[: residual.size].reshape(residual.shape))
    given = (counts.pixels, _read_only(dark), _read_only(counts.defects))
    estimated = guarded("background", step, step.estimate, *given)
    guarded("background", step, check_background, estimated, counts.pixels.shape)
    background = background_in_adu(estimated, counts)
    sums, n_masked = fill_residual(counts, background, residual)
    n_masked += mark_glare(residual, counts.defects, background)
    view = DetectorView(
        header=header,
        residual_adu=residual,
        background=background,
        mask=counts.defects,
        stars=StarList.empty(),
        psf_sigma_px=psf_sigma_px,
        history=history,
        work=work,
    )
    return view, sums, n_masked


def with_stars(
    view: DetectorView, residual: NDArray[np.float32], sums: LineSums, step: StarExtractor, quantum_adu: float = 1.0
) -> DetectorView:
    """The view with its star list, and with level and noise of the sky measured beside these stars.

    residual : the memory under the view's read-only image, which is brought to the new level. quantum_adu : of the counts.
    """
    stars = guarded("star_extractor", step, step.extract, view)
    guarded("star_extractor", step, check_stars, stars, view.mask.shape)
    background = without_stars(
        residual,
        view.mask,
        sums,
        stars,
        view.background,
        gain_e_adu=view.header.gain_e_adu or 1.0,
        psf_sigma_px=view.psf_sigma_px,
        quantum_adu=quantum_adu,
    )
    return replace(view, stars=stars, background=background)


def _read_only(array: NDArray[Any]) -> NDArray[Any]:
    """A view that a plug-in cannot write to."""
    view = array.view()
    view.flags.writeable = False
    return view
