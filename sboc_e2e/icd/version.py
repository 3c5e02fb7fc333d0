"""Version of the contract, stamped into every packet and product, with its history."""

from typing import Final

CONTRACT_MAJOR: Final = 2  # Grows with what an earlier decoder would misinterpret; written into every packet (ICD.md).
CONTRACT_MINOR: Final = 4  # Grows with what an earlier decoder would only miss; 4 is the last entry of `HISTORY`.
CONTRACT_VERSION: Final = f"{CONTRACT_MAJOR}.{CONTRACT_MINOR}"

HISTORY: Final = (
    ("1.0", "first contract: frames, packets, products, steps, flags"),
    (
        "2.0",
        "remembered stars are item 1 of the star packets and no measurements of the frame; near-lossless strips decode to the "
        "mean of a code's integers, float32; the header's PSF width is the measured one, NaN when it was not measured",
    ),
    ("2.1", "codec 4, rans; mirrored frame solutions; detectors that choose what their history holds; cameras of unknown PSF"),
    (
        "2.2",
        "frame solutions carry a camera of any model (pixel to direction and back) instead of Brown-Conrady numbers; the table "
        "of frames has the directions of a 9 x 9 grid of pixels, and the columns that the camera's model names; orbit estimates "
        "have node, perigee, anomaly, argument of latitude, what they lack, and a state with covariance and samples; tracklets "
        "have their pieces, the source of each row, its correlation, motion angle, shared and pointing errors, interval and "
        "scatter of the magnitude; they and the table of angles say what the camera's turning puts into both ends of a frame; "
        "streak fits say why they failed",
    ),
    (
        "2.3",
        "track packets: members of objects seen over several frames, with their pixels where no region was sent of them; regions "
        "and streaks have the number of their track; frames say where tracking could not go on",
    ),
    (
        "2.4",
        "header packets say which set of parameters flew, how many operations the frame took, and how many items of each kind of "
        "work were left undone; `FrameFlag.WORK_SHED`; views have a meter of the frame's work; streak fits have the PSF's width "
        "at their place, the light of flashes and the intervals of their light's ends, tracklets half of the 68 % interval along "
        "the motion; trackers may say what they find when no frame follows (packets as before)",
    ),
)
"""The major number grows if a decoder of the previous version would misinterpret something. The minor number grows if it would
only miss or refuse new content. Decoders skip and count packets of another major version."""
