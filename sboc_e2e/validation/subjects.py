"""What is compared: one image with what is known of its stars, from a FITS file or from a scenario."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from astropy.wcs import WCS
from numpy.typing import NDArray

from ground.sky.apparent import jyear_of, mid_frame_tai_ns
from sboc_e2e import scenario as scenarios
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd.errors import UserError
from sboc_e2e.outside.fits_frames import SUFFIXES, images_of, read_frame
from sboc_e2e.registry import Registry
from simulator.chain import Simulator
from simulator.scene.stars import sky_catalogue

MIN_SIDE_PX = 64
"""One mesh of the background (`MESH_PX`) and one tile of the spectrum."""


@dataclass(frozen=True, kw_only=True, eq=False)
class KnownStars:
    """Where stars of the catalogue should be. star_id : (n,) of the catalogue; row, col : (n,) px; v_mag : (n,) V;
    origin : how they got there, in words."""

    star_id: NDArray[np.int64]
    row: NDArray[np.float64]
    col: NDArray[np.float64]
    v_mag: NDArray[np.float64]
    origin: str

    def __len__(self) -> int:
        return len(self.row)


@dataclass(frozen=True, kw_only=True, eq=False)
class Picture:
    """An image and its known stars. image : (rows, cols) float32, ADU, NaN where masked. saturation_adu : None if unknown."""

    name: str
    image: NDArray[np.float32]
    known: KnownStars | None = None
    saturation_adu: float | None = None
    notes: tuple[str, ...] = field(default=())

    @property
    def step_adu(self) -> float:
        """Step of the converter: 1 where all pixels are whole numbers, otherwise 0 (continuous)."""
        finite = self.image[np.isfinite(self.image)]
        return 1.0 if bool(np.all(finite == np.rint(finite))) else 0.0


def from_fits(path: Path, hdu: int | None, catalogue: Callable[[], StarCatalogue]) -> Picture:
    """An image of a FITS file, the first one when `hdu` is None; with a celestial WCS its catalogue stars.

    Raises `UserError` for a missing file, one that is not FITS, an HDU without an image, an image without noise.
    """
    if not path.is_file():
        raise UserError(f"{path}: no such FITS file")
    places = images_of(path)
    if not places:
        raise UserError(f"{path}: holds no two-dimensional image")
    chosen = next((p for p in places if hdu is None or p.hdu == hdu), None)
    if chosen is None:
        known = ", ".join(str(p.hdu) for p in places[:20])
        raise UserError(f"{path}: HDU {hdu} holds no two-dimensional image; allowed are {known}")
    sourced = read_frame(chosen, 0)
    header = sourced.frame.header
    image = np.ascontiguousarray(sourced.frame.pixels, dtype=np.float32)
    _refuse_empty(image, f"{path}, HDU {chosen.hdu}")
    epoch_jyear = jyear_of(mid_frame_tai_ns(header))
    stars, notes = None, [note.text for note in sourced.notes]
    if sourced.wcs is not None:
        stars = catalogue_stars(sourced.wcs, image.shape, catalogue(), epoch_jyear)
        if stars is None:
            notes.append("the header's WCS cannot be followed to the sky")
    return Picture(
        name=f"{path.name}[{chosen.hdu}]", image=image, known=stars, saturation_adu=header.saturation_adu, notes=tuple(notes)
    )


def catalogue_stars(wcs: WCS, shape: tuple[int, ...], catalogue: StarCatalogue, epoch_jyear: float) -> KnownStars | None:
    """Catalogue stars inside an image by its WCS, proper motion applied; None when the WCS gives no sky position."""
    rows, cols = shape
    try:
        edge = wcs.all_pix2world([[0.5 * cols, 0.5 * rows], [0, 0], [cols, 0], [0, rows], [cols, rows]], 0)
    except Exception:  # noqa: BLE001 - a WCS of somebody else's header may fail in any way
        return None
    if not np.all(np.isfinite(edge)):
        return None
    ra, dec = np.radians(edge[:, 0]), np.radians(edge[:, 1])
    cosine = np.sin(dec[0]) * np.sin(dec) + np.cos(dec[0]) * np.cos(dec) * np.cos(ra - ra[0])
    radius_deg = float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)).max()))
    stars = catalogue.cone(float(edge[0, 0]), float(edge[0, 1]), radius_deg + 1e-3, epoch_jyear=epoch_jyear)
    if len(stars) == 0:
        place = np.zeros((0, 2))
    else:
        place = wcs.all_world2pix(np.stack([stars.ra_deg, stars.dec_deg], axis=1), 0, quiet=True)
    col, row = place[:, 0], place[:, 1]
    inside = (row > -0.5) & (row < rows - 0.5) & (col > -0.5) & (col < cols - 0.5)
    v_mag = np.asarray(stars.v_mag, dtype=np.float64)[inside]
    return KnownStars(
        star_id=np.asarray(stars.source_id, dtype=np.int64)[inside],
        row=row[inside],
        col=col[inside],
        v_mag=v_mag,
        origin=f"{catalogue.name} through the header's WCS",
    )


def from_scenario(name: str, frame: int, registry: Registry, overrides: tuple[str, ...]) -> Picture:
    """One simulated frame of a scenario; its known stars are the truth's catalogue stars, where they were drawn."""
    resolved = scenarios.load(name, registry=registry, overrides=overrides)
    simulator = Simulator(resolved.simulator, seed=resolved.seed, catalogue=sky_catalogue(resolved.simulator.stars))
    made, truth = simulator.frame(frame)
    catalogued = truth.stars[truth.stars["star_id"] > 0]
    image = np.ascontiguousarray(made.pixels, dtype=np.float32)
    _refuse_empty(image, f"{resolved.name}, frame {frame}")
    return Picture(
        name=f"{resolved.name}, frame {frame}",
        image=image,
        known=KnownStars(
            star_id=catalogued["star_id"].astype(np.int64),
            row=catalogued["row"].astype(np.float64),
            col=catalogued["col"].astype(np.float64),
            v_mag=catalogued["v_mag"].astype(np.float64),
            origin="truth of the simulation, catalogue stars only",
        ),
        saturation_adu=made.header.saturation_adu,
    )


def is_fits(name: str) -> bool:
    """Whether a command-line argument names a FITS file rather than a scenario."""
    return name.lower().endswith(SUFFIXES)


def _refuse_empty(image: NDArray[np.float32], where: str) -> None:
    """`UserError` for an image that has nothing to compare."""
    if min(image.shape) < MIN_SIDE_PX:
        raise UserError(f"{where}: {image.shape[0]} x {image.shape[1]} px; allowed are sides of {MIN_SIDE_PX} px or more")
    finite = np.isfinite(image)
    if finite.mean() < 0.5:
        raise UserError(f"{where}: {100 * finite.mean():.0f} % of the pixels hold a number; allowed is 50 % or more")
    if np.ptp(np.percentile(image[finite], [1.0, 99.0])) <= 0.0:
        raise UserError(f"{where}: the image has no noise: its 1st and 99th percentile are equal; nothing can be compared")
