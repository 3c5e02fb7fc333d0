"""Frames and annotations in the layout of SatSim (ssc-ai/satsim, satsim/io: fits.py, satnet.py), written by the test itself."""

import json
from pathlib import Path

import numpy as np
from astropy.io import fits
from scipy.special import erf

ROWS, COLS, SIGMA_PX, SKY_E, READ_E, EXPOSURE_S = 200, 240, 1.1, 60.0, 6.0, 0.5
ELECTRONS_S = (24_000.0, 9_000.0)
"""Of the two satellites."""


def ends(frame: int, satellite: int) -> tuple[float, float, float, float]:
    """row and col at shutter open and close, centre of the first pixel (0, 0); the second moves against the columns."""
    if satellite == 0:
        return 40.3 + 9.0 * frame, 30.7 + 55.0 * frame, 46.8 + 9.0 * frame, 70.2 + 55.0 * frame
    return 170.1 - 12.0 * frame, 200.4 - 50.0 * frame, 160.9 - 12.0 * frame, 158.8 - 50.0 * frame


def trail(row0: float, col0: float, row1: float, col1: float, electrons: float) -> np.ndarray:
    """A uniform Gaussian trail, integrated over pixels, in steps of a fifth of a pixel."""
    n = int(5 * np.hypot(row1 - row0, col1 - col0)) + 5
    phase = (np.arange(n) + 0.5) / n
    edges_row, edges_col = np.arange(ROWS + 1) - 0.5, np.arange(COLS + 1) - 0.5
    image = np.zeros((ROWS, COLS))
    for p in phase:
        across = np.diff(erf((edges_row - row0 - p * (row1 - row0)) / (SIGMA_PX * np.sqrt(2.0)))) / 2.0
        along = np.diff(erf((edges_col - col0 - p * (col1 - col0)) / (SIGMA_PX * np.sqrt(2.0)))) / 2.0
        image += np.outer(across, along) * electrons / n
    return image


def write(folder: Path, n_frames: int = 3) -> Path:
    """A set of frames: <set>/ImageFiles/*.fits and <set>/Annotations/*.json; returns the set."""
    rng = np.random.default_rng(12)
    made = folder / "2027-01-29T00-00-00.0"
    for name in ("ImageFiles", "Annotations"):
        (made / name).mkdir(parents=True)
    stars = np.column_stack([rng.uniform(3, ROWS - 3, 40), rng.uniform(3, COLS - 3, 40), rng.uniform(600, 6000, 40)])
    for frame in range(n_frames):
        sky = np.full((ROWS, COLS), SKY_E)
        for row, col, electrons in stars:
            sky += trail(row, col, row + 0.01, col, electrons)
        objects = []
        for satellite, electrons_s in enumerate(ELECTRONS_S):
            places = ends(frame, satellite)
            sky += trail(*places, electrons_s * EXPOSURE_S)
            objects.append(annotation(places, satellite, electrons_s))
        objects += [annotation((row, col, row, col), -1, electrons / EXPOSURE_S) for row, col, electrons in stars]
        counts = np.rint(rng.poisson(sky) + rng.normal(200.0, READ_E, sky.shape)).clip(0, 65535).astype(np.uint16)
        name = f"sat_{0:05d}.{frame:04d}"
        save_fits(made / "ImageFiles" / f"{name}.fits", counts, frame)
        document = {
            "data": {
                "file": {"dirname": made.name, "sequence": 0, "filename": f"{name}.fits", "sequence_id": frame},
                "sensor": {"height": ROWS, "width": COLS, "iFOVy": 2e-3, "iFOVx": 2e-3},
                "objects": objects, "stats": {"num_obs_initial": 2, "num_obs": 2}, "metadata": {},
            }
        }  # fmt: skip
        (made / "Annotations" / f"{name}.json").write_text(json.dumps(document, separators=(",", ":")))
    (made / "config.json").write_text("{}")
    return made


def annotation(places: tuple[float, float, float, float], satellite: int, electrons_s: float) -> dict[str, object]:
    """An entry of data.objects; places are shares of the image between its outer edges."""
    y0, x0, y1, x1 = ((place + 0.5) / size for place, size in zip(places, (ROWS, COLS, ROWS, COLS), strict=True))
    name = f"sat {satellite}" if satellite >= 0 else None
    return {
        "class_name": "Satellite" if name else "Star", "class_id": 1 if name else 2,
        "y_min": min(y0, y1), "x_min": min(x0, x1), "y_max": max(y0, y1), "x_max": max(x0, x1),
        "y_center": (y0 + y1) / 2, "x_center": (x0 + x1) / 2, "bbox_height": abs(y1 - y0), "bbox_width": abs(x1 - x0),
        "source": "satsim", "magnitude": 11.0, "pe_per_sec": electrons_s, "y_start": y0, "x_start": x0,
        "y_mid": (y0 + y1) / 2, "x_mid": (x0 + x1) / 2, "y_end": y1, "x_end": x1, "seg_id": -1,
        "object_name": name, "object_id": None, "pixels": [], "snr": [],
    }  # fmt: skip


def save_fits(path: Path, counts: np.ndarray, frame: int) -> None:
    """A frame with the header keys that matter; the WCS is there and says nothing, as when no site was given."""
    hdu = fits.PrimaryHDU(counts)
    hdu.header.update(
        {
            "DATE-OBS": f"2027-01-29T00:00:{2 * frame:02d}.250000", "TIME-OBS": f"00:00:{2 * frame:02d}.250000",
            "EXPTIME": EXPOSURE_S, "EXPOSURE": EXPOSURE_S, "IMAGETYP": "Light Frame", "XBINNING": 2, "CTYPE1": "RA---TAN",
            "CTYPE2": "DEC--TAN", "CRVAL1": 0, "CRVAL2": 0, "CRPIX1": ROWS / 2, "CRPIX2": COLS / 2, "CD1_1": 0, "CD1_2": 0.0,
            "CD2_1": 0.0, "CD2_2": 0, "EQUINOX": 2000.0,
        }
    )  # fmt: skip
    hdu.writeto(path)
