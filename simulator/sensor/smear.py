"""Frame-transfer smear of a CCD: the image keeps falling while charge moves into the store."""

import numpy as np
from numpy.typing import NDArray


def add_smear(mean_e: NDArray[np.float32], row_transfer_s: float, exposure_s: float) -> None:
    """Add to an image (rows, cols) of mean electrons what its charge collects on the way, in place.

    Charge of row r passes the rows below it when the frame is moved into the store, and came past those above it when the
    frame before was moved: of every other row in its column it collects the light of one transfer step. Light that came in
    during the exposure stands for that of the transfers, and the read-out window for the whole column.
    """
    share = row_transfer_s / exposure_s
    column_e = mean_e.sum(axis=0, dtype=np.float64)
    mean_e *= np.float32(1.0 - share)
    mean_e += (share * column_e).astype(np.float32)
