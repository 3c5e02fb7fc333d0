"""Records that the ground chain hands from step to step: results of one frame, results of a run."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ground.ingest import IngestReport
from ground.photometry.sky_memory import SkyMemory
from ground.photometry.star_memory import EarlierStars
from ground.streaks.psf_field import PsfField
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import FrameSolution, OrbitEstimate, PhotometricSolution, StreakMeasurement, Tracklet
from sboc_e2e.icd.signals import BackgroundModel


@dataclass(frozen=True, kw_only=True, eq=False)
class GroundState:
    """State of the chain between frames.

    astrometry : state of the astrometry step. psf : learned width of the PSF. growth_known : whether a star list has
    shown how it grows over the field. sky : level of the sky on the mesh, None before the first frame. stars : stars under
    the regions of the last frames.
    """

    astrometry: Any
    psf: PsfField
    growth_known: bool = False
    sky: SkyMemory | None = None
    stars: tuple[EarlierStars, ...] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class FrameProducts:
    """Results of one frame before linking.

    streaks : all measured streaks; rejected ones are flagged VETOED. mean_flat : response at each streak relative to the axis.
    psf : width of the PSF over the field, as the run knew it when this frame came.
    background : mesh of the sky with the level that the frames so far give.
    wcs : the astropy WCS that came with the frame and was used, None when the frame was solved.
    fit_failures : reason of each fit that is flagged FIT_FAILED.
    """

    header: FrameHeader
    solution: FrameSolution
    photometry: PhotometricSolution
    streaks: Sequence[StreakMeasurement]
    mean_flat: tuple[float, ...]
    psf: PsfField
    background: BackgroundModel | None
    wcs: Any = None
    fit_failures: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class GroundProducts:
    """Results of a run, in frame order; streaks carry tracklet ids, resolved directions and final magnitudes.

    members : the streaks of each tracklet. Sequences as long as the run may be made on demand; read them in order.
    """

    headers: Sequence[FrameHeader]
    solutions: Sequence[FrameSolution]
    photometry: Sequence[PhotometricSolution]
    streaks: Sequence[StreakMeasurement]
    tracklets: tuple[Tracklet, ...]
    members: tuple[Sequence[StreakMeasurement], ...]
    orbits: tuple[OrbitEstimate, ...]
    ingest: IngestReport | None = None
