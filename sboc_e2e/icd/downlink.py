"""A frame as ground knows it once its packets are decoded."""

from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.flags import FrameFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.signals import BackgroundModel, RoiGroup, StarList


@dataclass(frozen=True, kw_only=True)
class Housekeeping:
    """Counters of the on-board software for one frame.

    parameter_set : number of the set of parameters that flew; 0: unknown. operations : work of the frame. shed_stars ...
    shed_regions : items left undone for want of work (`sboc_e2e.icd.work.Work`).
    """

    flags: FrameFlag
    n_stars_found: int
    n_stars_sent: int
    n_detections: int
    n_rois_sent: int
    n_rois_dropped: int
    bytes_dropped: int
    threshold_sigma: float
    background_adu: float
    sigma_adu: float
    n_masked: int
    parameter_set: int = 0
    operations: int = 0
    shed_stars: int = 0
    shed_halos: int = 0
    shed_candidates: int = 0
    shed_points: int = 0
    shed_trails: int = 0
    shed_regions: int = 0

    @property
    def shed(self) -> dict[str, int]:
        """Items that the work limit left undone, by kind (`stars` to `regions`); kinds without any are left out."""
        counts = {
            field.name.removeprefix("shed_"): getattr(self, field.name)
            for field in fields(self)
            if field.name.startswith("shed_")
        }
        return {kind: n for kind, n in counts.items() if n > 0}


@dataclass(frozen=True, kw_only=True, eq=False)
class DownlinkFrame:
    """A frame rebuilt from intact packets; absent parts are None or empty and flagged.

    adu_scale, adu_offset : one transmitted unit is ``adu_scale`` ADU and zero is ``adu_offset`` (1 and 0 for uint16 frames).
    psf_sigma_px : width of the PSF in the middle of the frame as measured on board, without the pixel; None: unknown.
    stars : as measured in this frame. remembered : stars under its ROIs as the frames before showed them.
    """

    header: FrameHeader
    flags: FrameFlag
    housekeeping: Housekeeping | None
    stars: StarList
    rois: tuple[RoiGroup, ...]
    background: BackgroundModel | None
    thumbnail_adu: NDArray[np.float32] | None
    whole_frame: NDArray[np.int32] | NDArray[np.float32] | None
    adu_scale: float = 1.0
    adu_offset: float = 0.0
    remembered: StarList = field(default_factory=StarList.empty)
    psf_sigma_px: float | None = None
