"""One table of flags: bit, name, one line. `FLAG_TEXT` has the meaning of each flag; documentation is generated from it."""

from enum import IntFlag
from typing import Final


class FrameFlag(IntFlag):
    """State of a frame, set on board (low 16 bits travel in the header packet) and on ground."""

    GAIN_ASSUMED = 1 << 0
    READ_NOISE_ASSUMED = 1 << 1
    NO_ATTITUDE = 1 << 2
    NO_OBSERVER = 1 << 3
    NO_STARS = 1 << 4
    ALL_MASKED = 1 << 5
    SATURATED = 1 << 6
    TIME_BACKWARDS = 1 << 7
    BUDGET_CUT = 1 << 8
    STORM = 1 << 9
    REPEATED_FRAME = 1 << 10
    EMPTY_SIGNAL = 1 << 11
    WORK_SHED = 1 << 12
    TRACKS_ENDED = 1 << 13
    PACKETS_MISSING = 1 << 16
    NO_SOLUTION = 1 << 17
    ATTITUDE_FROM_SOLVER = 1 << 18
    FEW_STARS = 1 << 19
    HEADER_REBUILT = 1 << 20


class StarFlag(IntFlag):
    """State of one entry of the star list (8 bits in the packet)."""

    SATURATED = 1 << 0
    EDGE = 1 << 1
    BLENDED = 1 << 2
    DEFECT = 1 << 3
    TRAILED = 1 << 4
    COSMIC_LIKE = 1 << 5
    REMEMBERED = 1 << 7


class StreakFlag(IntFlag):
    """State of a detection, ROI group or streak measurement (low 16 bits travel in the ROI packet)."""

    EDGE0 = 1 << 0
    EDGE1 = 1 << 1
    POINT_LIKE = 1 << 2
    CURVED = 1 << 3
    SATURATED = 1 << 4
    CROSSES_STAR = 1 << 5
    COSMIC_LIKE = 1 << 6
    ROI_CUT = 1 << 7
    SPIKE_LIKE = 1 << 8
    STATIC = 1 << 9
    LOSSY = 1 << 10
    DIRECTION_RESOLVED = 1 << 16
    ENDS_NOT_GAUSSIAN = 1 << 17
    FIT_FAILED = 1 << 18
    VARIABLE = 1 << 19
    DEFOCUSED = 1 << 20
    VETOED = 1 << 21
    NO_SKY = 1 << 22
    NO_MAGNITUDE = 1 << 23
    PIXELS_MISSING = 1 << 24
    SINGLE_FRAME = 1 << 25
    REFIT = 1 << 26
    GAIN_ASSUMED = 1 << 27
    FAST_ROWS = 1 << 28


class MaskBit(IntFlag):
    """Bits of a pixel mask (uint8, one per pixel)."""

    DEAD = 1 << 0
    HOT = 1 << 1
    SATURATED = 1 << 2
    GLARE = 1 << 3
    MISSING = 1 << 4
    LEARNED_HOT = 1 << 5


FLAG_TEXT: Final[dict[str, dict[str, str]]] = {
    "FrameFlag": {
        "GAIN_ASSUMED": "no gain was given; that of the nominal camera was used",
        "READ_NOISE_ASSUMED": "no read noise was given; noise is what the background mesh says, 5 e- without one",
        "NO_ATTITUDE": "telemetry carries no attitude",
        "NO_OBSERVER": "telemetry carries no observer state",
        "NO_STARS": "no star was found on board",
        "ALL_MASKED": "fewer than 10 % of the pixels are usable",
        "SATURATED": "more than half of the pixels are saturated",
        "TIME_BACKWARDS": "the frame starts before its predecessor ended",
        "BUDGET_CUT": "something did not fit into the downlink budget",
        "STORM": "particle storm: the detection threshold or rate limit was adapted",
        "REPEATED_FRAME": "same pixels or frame number as the frame before",
        "EMPTY_SIGNAL": "all pixels are equal",
        "WORK_SHED": "work beyond the frame's limit was left undone; the header packet says how much of which kind",
        "TRACKS_ENDED": "nothing is tracked across from the frame before: gap, repeated frame, slew, other exposure or no stars",
        "PACKETS_MISSING": "packets of this frame did not arrive intact",
        "NO_SOLUTION": "the attitude could not be solved; no sky positions",
        "ATTITUDE_FROM_SOLVER": "attitude found without telemetry",
        "FEW_STARS": "fewer matched stars than the camera fit has parameters; the priors hold what stars leave open",
        "HEADER_REBUILT": "header packet lost; values come from other packets of this or the next frame",
    },
    "StarFlag": {
        "SATURATED": "a pixel of the core is saturated",
        "EDGE": "the window touches the frame's edge",
        "BLENDED": "a neighbour lies inside the window",
        "DEFECT": "a defective pixel lies inside the window",
        "TRAILED": "elongated by motion of the pointing",
        "COSMIC_LIKE": "sharper than the PSF",
        "REMEMBERED": "place and flux from the frames before, because a region of interest lies over it",
    },
    "StreakFlag": {
        "EDGE0": "end 0 lies on the frame's edge: not an end of the exposure",
        "EDGE1": "end 1 lies on the frame's edge: not an end of the exposure",
        "POINT_LIKE": "shorter than about two PSF widths",
        "CURVED": "the trail is curved",
        "SATURATED": "saturated pixels in the trail",
        "CROSSES_STAR": "a catalogue or listed star lies under the trail",
        "COSMIC_LIKE": "sharper than the PSF",
        "ROI_CUT": "the budget cut the margin or part of the trail",
        "SPIKE_LIKE": "points at a bright star: diffraction spike or bleeding",
        "STATIC": "seen at the same pixel or star position in earlier frames",
        "LOSSY": "pixels were coded with loss",
        "DIRECTION_RESOLVED": "end 0 is where the exposure began",
        "ENDS_NOT_GAUSSIAN": "ends are change points; use the intervals, not the covariance",
        "FIT_FAILED": "no fit; values are the on-board detection's",
        "VARIABLE": "brightness changes along the trail",
        "DEFOCUSED": "wider than the PSF",
        "VETOED": "rejected by the vetter",
        "NO_SKY": "no frame solution",
        "NO_MAGNITUDE": "no zero point, or no exposure time on the rows",
        "PIXELS_MISSING": "ROI packets are missing",
        "SINGLE_FRAME": "not linked to any other frame; with EDGE0 and EDGE1: crossed the field within one exposure",
        "REFIT": "refitted jointly with the other frames of its tracklet",
        "GAIN_ASSUMED": "electrons by an assumed gain: the frame gave none",
        "FAST_ROWS": "moves about as fast as the rolling shutter or faster",
    },
    "MaskBit": {
        "DEAD": "no response",
        "HOT": "dark current too high or unstable",
        "SATURATED": "at or above the saturation level",
        "GLARE": "beside a large saturated area, in light that is not sky",
        "MISSING": "NaN in the delivered frame, or outside the window",
        "LEARNED_HOT": "found hot by the on-board software",
    },
}
