"""Expected reasons why the pixels of a region allow no fit."""

from enum import StrEnum

from sboc_e2e.icd.errors import SbocError


class Reason(StrEnum):
    """Reason of a failed fit."""

    NO_LINE = "no line near the detection"
    TOO_FEW_PIXELS = "too few usable pixels along the line"
    SINGULAR = "pixels that leave the line undetermined"
    NO_ENDS = "no lit part of the line"
    IRREGULAR = "an iteration that ran away"
    NO_SOURCE = "no point source"


class NoTrailError(SbocError):
    """The pixels allow no fit; anything else that a fit raises is a defect and stops the run."""

    def __init__(self, reason: Reason) -> None:
        super().__init__(str(reason))
        self.reason = reason
