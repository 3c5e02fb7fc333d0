"""A camera derived from its frames: PSF from stars, gain and noise by photon transfer, saturation, plate scale by solving.

Photon transfer (Janesick 2007, Photon Transfer, ch. 5): of two frames of one field the variance of the difference, halved,
grows with the level above the bias by 1/gain, from (read noise / gain)^2 on; what stays on its pixels cancels.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
from astropy.io import fits
from numpy.typing import NDArray

from ground.astrometry import lost_in_space
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd.errors import UserError
from sboc_e2e.icd.frame import NominalCamera
from sboc_e2e.icd.results import LARGEST_COUNT
from sboc_e2e.outside.camera import PIXELS_TIMES
from sboc_e2e.outside.fits_frames import images_of, read_frame
from sboc_e2e.outside.frame_source import SourcedFrame
from sboc_e2e.outside.guessed_camera import ASSUMED_FOCAL_PX, ASSUMED_PSF_SIGMA_PX, ASSUMED_SATURATION_ADU, camera_of_frame
from sboc_e2e.outside.one_step import Found, detect
from sboc_e2e.outside.overscan import without_sky
from sboc_e2e.outside.pixel_unit import CameraUnits, in_unit
from sboc_e2e.score.figures import MEDIAN_OF_CHI2

TILE_PX: Final = 32
"""Side of the tiles of photon transfer: a variance is known to 4.4 % (sqrt(2 / 1024)). With 16 and 64 px, the gains of three
synthetic fields change by less than 0.2 %."""
CLIP_SIGMAS: Final = 4.0
"""Of three synthetic fields of gain 1.700 +- 0.005, four sigmas find 1.701 to 1.704, six 1.700 to 1.703, three 1.751: they cut
noise."""
CLIPPINGS: Final = 5
"""Three and ten find the same gain of three synthetic fields to the fourth digit."""
STAR_SIGMAS: Final = 1.5
"""Of the difference; pixels so far above their tile's sky are of stars (2.1 sigma of one frame, 3 of the mean of two)."""

WORST_GAIN: Final = 0.1
"""One sigma of ln gain above which the levels lie too close together to tell it."""

FEWEST_TILES: Final = 8
"""Tiles that a line is fitted through. Chosen, not measured: fewer tell slope and scatter badly; 96 x 96 px have nine."""
FEWEST_OVERSCAN: Final = 8
"""Covered columns; a few at the border are only dimmer than the others."""

FULL_PIXELS: Final = 10
"""Pixels of one and the same highest value that make it the saturation level."""

FRAMES_USED: Final = 8
"""Seven pairs; the error of the gain falls with their root, memory grows with their number. Chosen, not measured."""

CAMERA_CHARACTERS: Final = 60
"""Of the words of a header that name a camera, in an error."""


@dataclass(frozen=True, kw_only=True)
class PhotonTransfer:
    """gain_e_adu with its error; read_noise_e with its error, NaN where no bias is known or no variance is left at its level;
    bias_adu (NaN: unknown).
    """

    gain_e_adu: float
    gain_err: float
    read_noise_e: float
    read_noise_err: float
    bias_adu: float


@dataclass(frozen=True, kw_only=True)
class MadeCamera:
    """Properties of a camera derived from its frames; None where the frames do not determine them.

    assumed : what `sboc process` takes where frames tell no gain: that of the first header, or a guess.
    unit : ADU here are the numbers of the files times this, as `sboc process` takes them, see `pixel_unit`.
    sources : files and HDUs of the images that were used. n_left_out : images beyond `FRAMES_USED`.
    """

    rows: int
    cols: int
    psf_sigma_px: float | None
    transfer: PhotonTransfer | None
    saturation_adu: float | None
    focal_px: float | None
    scale_from: str
    assumed: NominalCamera | None = None
    unit: float = 1.0
    sources: tuple[tuple[str, int], ...] = ()
    n_left_out: int = 0

    def words(self) -> list[str]:
        """One line for each finding, and one on images that were left out; ADU are the numbers of the files."""
        t, unit = self.transfer, self.unit
        psf = "unknown: too few stars" if self.psf_sigma_px is None else f"sigma {self.psf_sigma_px:.2f} px"
        gain, noise = "unknown: frames of different levels tell it, two of each", "unknown, as the gain is"
        if t is None and self.assumed is not None:
            gain += f"; {self.assumed.gain_e_adu * unit:.4g} e-/ADU is taken, from the first header or its noise"
            noise += f"; {self.assumed.read_noise_e:g} e- is taken" if self.assumed.read_noise_e > 0.0 else ""
        if t is not None:
            of_file, bias_adu = t.gain_e_adu * unit, t.bias_adu / unit
            digits = ".3f" if 0.1 <= of_file < 1e4 else ".4g"
            gain = f"{of_file:{digits}} +- {t.gain_err * unit:{digits}} e-/ADU"
            bias = f"bias {bias_adu:{'.1f' if abs(bias_adu) >= 10.0 else '.4g'}} ADU"
            if math.isnan(t.bias_adu):
                noise = "unknown: needs the bias (an overscan in the frames, or --bias)"
            elif math.isnan(t.read_noise_e):
                noise = f"unknown: no noise is left at the level of the {bias}, which may be too low, or the read noise too small"
            else:
                noise = f"{t.read_noise_e:.2f} +- {t.read_noise_err:.2f} e- ({bias})"
        full = "not reached" if self.saturation_adu is None else f"{self.saturation_adu / unit:g} ADU"
        scale = "unknown"
        if self.focal_px is not None:
            width = lost_in_space.width_of(self.focal_px, self.cols)
            scale = f"{math.degrees(1.0 / self.focal_px) * 3600.0:.4f} arcsec/px, field {width:.4f} deg ({self.scale_from})"
        pairs = (("PSF", psf), ("gain", gain), ("read noise", noise), ("saturation", full), ("plate scale", scale))
        lines = [f"{name}: {text}" for name, text in pairs]
        if self.n_left_out:
            n = len(self.sources)
            lines.append(f"images: the first {n} of {n + self.n_left_out} were used, {self.n_left_out} left out")
        return lines


def made_camera(
    paths: Sequence[Path],
    *,
    hdus: Sequence[int] = (),
    width_deg: float | None = None,
    bias_adu: float | None = None,
    search: bool = False,
) -> MadeCamera:
    """A camera of the images in FITS files. hdus : of each file take these alone, as frames of one camera; without them all
    images must be of one HDU. bias_adu : in the numbers of the files. search : try all widths of the field where nothing tells
    it (minutes).

    Raises `UserError` for files that cannot be read or lack an HDU, for images of different sizes or cameras, and for a width or
    bias that no camera has.
    """
    if width_deg is not None and not 0.0 < width_deg < 180.0:
        raise UserError(f"--width: expected more than 0 and less than 180 deg, got {width_deg:g}")
    if bias_adu is not None and not abs(bias_adu) <= LARGEST_COUNT:
        raise UserError(f"--bias: expected -{LARGEST_COUNT:.0f} to {LARGEST_COUNT:.0f} ADU, got {bias_adu:g}")
    given = [place for path in paths for place in _images(path, hdus)]
    places = given[:FRAMES_USED]
    units = CameraUnits()
    frames = [read_frame(place, number, use_wcs=False, units=units) for number, place in enumerate(places)]
    sizes = {(place.rows, place.cols) for place in places}
    if len(sizes) != 1:
        raise UserError(f"camera make: frames of one size are needed, got {', '.join(f'{r} x {c}' for r, c in sorted(sizes))}")
    ((rows, cols),) = sizes
    _require_one_camera(frames, told=bool(hdus))
    unit = frames[0].unit
    images = [in_unit(sourced.frame.pixels, unit / sourced.unit) for sourced in frames]
    known_bias = _overscan_of(places[0], unit) if bias_adu is None else bias_adu * unit
    found = [detect(image) for image in images[:3]]
    widths = [f.stars.meta["psf_sigma_px"] for f in found if math.isfinite(f.stars.meta["psf_sigma_px"])]
    focal_px, scale_from = _scale(frames, found, rows, cols, width_deg, search=search)
    return MadeCamera(
        rows=rows,
        cols=cols,
        psf_sigma_px=float(np.median(widths)) if widths else None,
        transfer=photon_transfer(images, known_bias),
        saturation_adu=saturation_of(images),
        focal_px=focal_px,
        scale_from=scale_from,
        assumed=camera_of_frame(frames[0], None),
        unit=unit,
        sources=tuple((place.path.name, place.hdu) for place in places),
        n_left_out=len(given) - len(places),
    )


def photon_transfer(images: Sequence[NDArray[np.float32]], bias_adu: float | None) -> PhotonTransfer | None:
    """Gain and read noise of frames of one field, each paired with the next; None where they do not tell the gain.

    images : (rows, cols) ADU, NaN for pixels without number. bias_adu : level without light; None: unknown.
    """
    level, variance = [], []
    for one, other in pairwise(images):
        mean, spread = _tiles(one, other)
        level.append(mean)
        variance.append(spread)
    if not level:
        return None
    m, v = np.concatenate(level), np.concatenate(variance)
    keep = np.isfinite(m) & np.isfinite(v) & (v > 0.0)
    m, v = m[keep], v[keep]
    n = TILE_PX**2
    expected = np.full(len(m), float(np.median(v)) if len(v) else 1.0)
    scatter, line = 1.0, np.zeros(2)
    for _ in range(CLIPPINGS):
        if len(m) < FEWEST_TILES or not np.ptp(m) > 0.0:
            return None
        # the error of a variance goes with the variance, which the line itself tells best
        line = np.polyfit(m, v, 1, w=1.0 / expected)
        expected = np.maximum(np.polyval(line, m), 0.2 * np.median(v))
        pull = (v / expected - 1.0) / math.sqrt(2.0 / n)
        scatter = max(1.4826 * float(np.median(np.abs(pull - np.median(pull)))), 1.0)
        keep = np.abs(pull - np.median(pull)) < CLIP_SIGMAS * scatter
        m, v, expected = m[keep], v[keep], expected[keep]
    weight = 1.0 / (expected * math.sqrt(2.0 / n) * scatter) ** 2
    middle = float(np.sum(weight * m) / np.sum(weight))
    slope_err = 1.0 / math.sqrt(float(np.sum(weight * (m - middle) ** 2)) + 1e-300)
    slope = float(line[0])
    if not slope > 0.0 or slope_err / slope > WORST_GAIN:
        return None
    gain = 1.0 / slope
    bias = math.nan if bias_adu is None else float(bias_adu)
    noise2 = float(np.polyval(line, bias)) if math.isfinite(bias) else math.nan
    noise2_err = math.hypot(1.0 / math.sqrt(float(np.sum(weight))), slope_err * (bias - middle))
    noise = gain * math.sqrt(noise2) if noise2 > 0.0 else math.nan
    return PhotonTransfer(
        gain_e_adu=gain,
        gain_err=gain * slope_err / slope,
        read_noise_e=noise,
        read_noise_err=noise * math.hypot(0.5 * noise2_err / noise2, slope_err / slope) if noise2 > 0.0 else math.nan,
        bias_adu=bias,
    )


def saturation_of(images: Sequence[NDArray[np.float32]]) -> float | None:
    """Level at which pixels are full: a highest value that many pixels share; None where none do."""
    top = max(float(np.nanmax(image)) for image in images)
    return top if sum(int(np.count_nonzero(image >= top)) for image in images) >= FULL_PIXELS else None


def toml_text(made: MadeCamera) -> str:
    """The camera file: a table `camera`, keys as fields of the nominal camera; comments say what was measured."""
    camera = nominal(made)
    sources = ", ".join(f"{file} (HDU {hdu})" if hdu else file for file, hdu in made.sources)
    lines = [f"# Made by `sboc camera make` of {sources}.", *(f"# {words}" for words in made.words())]
    if made.unit != 1.0:
        lines.append(f"# Numbers of the files are tiny: gain and saturation below are of these numbers times {made.unit:g}.")
    lines += ["", "[camera]", f"{PIXELS_TIMES} = {made.unit!r}"]
    for each in fields(NominalCamera):
        value = getattr(camera, each.name)
        if value is None:
            continue
        if isinstance(value, bool):
            lines.append(f"{each.name} = {str(value).lower()}")
        elif isinstance(value, int | float):
            lines.append(f"{each.name} = {value!r}")
        elif isinstance(value, str):
            lines.append(f'{each.name} = "{value}"')
    return "\n".join(lines) + "\n"


def nominal(made: MadeCamera) -> NominalCamera:
    """The camera for the chain; what frames do not tell is as neutral as for a guessed one."""
    t, assumed = made.transfer, made.assumed
    gain, noise = (1.0, 0.0) if assumed is None else (assumed.gain_e_adu, assumed.read_noise_e)
    if t is not None:
        gain, noise = t.gain_e_adu, t.read_noise_e if math.isfinite(t.read_noise_e) else 0.0
    full = made.saturation_adu or ASSUMED_SATURATION_ADU
    return NominalCamera(
        name="made",
        rows=made.rows,
        cols=made.cols,
        focal_px=made.focal_px or ASSUMED_FOCAL_PX,
        center_row=0.5 * (made.rows - 1),
        center_col=0.5 * (made.cols - 1),
        psf_sigma_px=made.psf_sigma_px or ASSUMED_PSF_SIGMA_PX,
        psf_known=made.psf_sigma_px is not None,
        gain_e_adu=gain,
        read_noise_e=noise,
        saturation_adu=full,
        full_well_e=full * gain,
        zero_point_e_s=None,
        aperture_m=1.0,
    )


def _images(path: Path, hdus: Sequence[int]) -> list[Any]:
    """Images of a file, those of some HDUs where these are given."""
    if not path.is_file():
        raise UserError(f"{path}: no such file")
    places = images_of(path)
    absent = sorted(set(hdus) - {place.hdu for place in places})
    if absent:
        there = ", ".join(str(place.hdu) for place in places)
        raise UserError(f"{path}: --hdu {absent[0]}: no picture is in this HDU; there are pictures in {there}")
    return [place for place in places if not hdus or place.hdu in hdus]


def _require_one_camera(frames: Sequence[SourcedFrame], *, told: bool) -> None:
    """Raises `UserError` for frames of several cameras, whose gains and levels have nothing in common.

    told : the user says that the HDUs of each file are one camera's, so that cameras are told apart within each HDU alone.
    """
    seen: dict[int, dict[str, str]] = {}
    for sourced in frames:
        place = f"{sourced.file} (HDU {sourced.hdu})"
        seen.setdefault(sourced.hdu if told else 0, {}).setdefault(sourced.camera, place)
    for first in seen.values():
        if len(first) > 1:
            listed = ", ".join(f"{place}: {' '.join(camera.split())[:CAMERA_CHARACTERS]}" for camera, place in first.items())
            raise UserError(
                f"camera make: frames of one camera, filter and mode are needed, got {len(first)} by their headers ({listed}); "
                "--hdu N takes one image of each file"
            )


def _overscan_of(place: Any, unit: float) -> float | None:
    """Level of the columns without sky, the middle one's of those that are as quiet as noise; None without an overscan.

    unit : the level is of the file's numbers times this.
    """
    data = in_unit(fits.getdata(place.path, place.hdu), unit)
    sky = without_sky(data)
    if sky is None:
        return None
    cols = np.r_[0 : sky[1].start, sky[1].stop : data.shape[1]]
    level = np.median(data[:, cols], axis=0) if len(cols) else np.zeros(0)
    inside = float(np.median(data[sky]))
    quiet = level[level < inside]
    return float(np.median(quiet)) if len(quiet) >= FEWEST_OVERSCAN else None


def _tiles(one: NDArray[np.float32], other: NDArray[np.float32]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean level and half the clipped variance of the difference, (k,), of square tiles of two frames."""
    rows, cols = (side // TILE_PX * TILE_PX for side in one.shape)

    def tiles(image: NDArray[np.float32]) -> NDArray[np.float64]:
        cut = np.asarray(image[:rows, :cols], dtype=np.float64).reshape(rows // TILE_PX, TILE_PX, cols // TILE_PX, TILE_PX)
        return np.moveaxis(cut, 1, 2).reshape(-1, TILE_PX**2)

    a, b = tiles(one), tiles(other)
    whole = np.isfinite(a + b).all(axis=1)
    a, b = a[whole], b[whole]
    level, difference = 0.5 * (a + b), a - b
    difference -= np.median(difference, axis=1, keepdims=True)
    sky = np.median(level, axis=1, keepdims=True)
    kept = np.ones(difference.shape, dtype=np.bool_)
    variance = np.median(difference**2, axis=1) / MEDIAN_OF_CHI2
    for _ in range(CLIPPINGS):
        sigma = np.sqrt(variance)[:, None]
        # stars are told by the sum of both frames, on which the scatter of the difference does not depend
        kept = (np.abs(difference) <= CLIP_SIGMAS * sigma) & (level - sky <= STAR_SIGMAS * sigma)
        variance = np.sum(np.where(kept, difference**2, 0.0), axis=1) / np.maximum(kept.sum(axis=1), 1)
    return np.sum(np.where(kept, level, 0.0), axis=1) / np.maximum(kept.sum(axis=1), 1), 0.5 * variance


def _scale(
    frames: Sequence[SourcedFrame], found: Sequence[Found], rows: int, cols: int, width_deg: float | None, *, search: bool
) -> tuple[float | None, str]:
    """Focal length in pixels and where it is from: solved from stars, else as headers have it."""
    hints = next((sourced.focal_hints_px for sourced in frames if sourced.focal_hints_px), ())
    if width_deg is not None:
        hints = (0.5 * cols / math.tan(math.radians(0.5 * width_deg)),)
    if (hints or search) and lost_in_space.installed():
        seen = [
            lost_in_space.StarField(
                row=np.asarray(f.stars["row"]), col=np.asarray(f.stars["col"]), flux=np.asarray(f.stars["flux_e"]),
                rows=rows, cols=cols,
            )
            for f in found
        ]  # fmt: skip
        match = lost_in_space.find_scale(seen, hints, StarCatalogue.embedded())
        if match is not None:
            return match.focal_px, "solved from stars"
    return (hints[0], "as the header has it" if width_deg is None else "as given") if hints else (None, "")
