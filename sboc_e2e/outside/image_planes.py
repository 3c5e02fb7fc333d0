"""Images in a file that are not pictures of the sky: masks, variances and weights of the picture.

They are not searched. Where their meaning is certain they tell which pixels of their picture hold no light.
"""

import re
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from astropy.io import fits
from numpy.typing import NDArray

from sboc_e2e.outside.frame_source import Note

KINDS: Final[dict[str, tuple[str, ...]]] = {
    "bad pixels": ("BPM", "BADPIX", "BADPIXELS", "BADPIXELMASK"),
    "flags": ("MASK", "DQ", "DQM", "DQA", "FLAG", "FLAGS", "QUALITY", "MSK"),
    "variance": ("VARIANCE", "VAR", "VARIMG"),
    "error": ("ERR", "ERROR", "SIGMA", "STDDEV", "STD", "UNCERT", "UNCERTAINTY", "RMS"),
    "weight": ("WHT", "WEIGHT", "WGT", "IVAR", "INVVAR", "EXPMAP"),
}
"""Kinds of planes, and words of EXTNAME that name them (HST, JWST, Gemini, LSST, NOIRLab, SWarp, CCDData)."""

SCALE: Final = re.compile(r"^[\d.]+(e[+-]?\d+)?((\*\*|\^)\(?[+-]?\d+\)?)?[\s*]+", re.IGNORECASE)
"""A number before a unit, as in `10**-17 erg/cm**2/s` and `1E-17 erg/cm^2/s`."""
BRACKETED: Final = re.compile(r"[(\[]([^()\[\]]+)[)\]]\s*(\*\*|\^)?\s*[({]?2[)}]?")
"""The square of a whole unit, as in `(DN/s)^2`."""
FACTOR: Final = re.compile(r"(e-|[a-z_]+)\s*(?:(?:\*\*|\^)?\s*[({]?\s*([+-]?\d+)\b\s*[)}]?)?", re.IGNORECASE)
"""A factor of a unit and its power, as in `adu2`, `electron**2`, `s^(-2)`."""
LIGHT: Final = re.compile(
    r"adu|dn|e-?|el|elec|electrons?|counts?|cts?|photons?|ph|[numk]?jy|(nano)?(mgy|magg(y|ies?))|nmgy|ergs?|w", re.IGNORECASE
)
"""Units of light, without which a square is no variance: column densities come in `cm^-2`, areas in `arcsec^2`."""
PIXEL: Final = re.compile(r"pix(els?)?", re.IGNORECASE)
"""A factor that does not count: a variance of a pixel is given for each pixel too."""

NO_LIGHT_PLANES: Final = ("MP_BAD", "MP_NO_DATA", "MP_SUSPECT")
"""Header keys of the LSST pipelines that number the bits of a mask; those of detected sources are others."""

MOST_FLAG_VALUES: Final = 64
"""Different values of an image of flags, each of three bits at most. Chosen, not measured: more let pictures of few counts
pass."""
LEAST_UNFLAGGED: Final = 0.5
"""Share of zeros in an image of flags. Chosen, not measured: less lets pictures pass for flags."""


@dataclass(frozen=True, kw_only=True)
class Plane:
    """A plane: its HDU and kind, the HDU of the picture that it belongs to (None: of none), and how it was recognised."""

    hdu: int
    kind: str
    image: int | None
    words: str


def planes_of(hdus: fits.HDUList, images: list[int]) -> list[Plane]:
    """The planes among the image HDUs of a file. A plane belongs to the picture of its size and EXTVER, or to the one before."""
    kinds = {index: kind for index in images if (kind := _kind_of(hdus[index])) is not None}
    squares = [index for index in images if index not in kinds and is_square_of_light(hdus[index].header.get("BUNIT"))]
    if len(kinds) + len(squares) < len(images):  # a unit alone leaves no file without a picture
        kinds |= dict.fromkeys(squares, "variance")
    for index in images:
        beside = [other for other in images if other < index and other not in kinds and hdus[other].shape == hdus[index].shape]
        if index not in kinds and beside and _holds_flags(hdus[index]):
            kinds[index] = "flags"
    pictures = [index for index in images if index not in kinds]
    planes = []
    for index, kind in kinds.items():
        fitting = [other for other in pictures if hdus[other].shape == hdus[index].shape]
        same = [other for other in fitting if hdus[other].ver == hdus[index].ver]
        before = [other for other in fitting if other < index]
        image = same[0] if len(same) == 1 else before[-1] if before else None
        planes.append(Plane(hdu=index, kind=kind, image=image, words=f"{kind} ({hdus[index].name or 'no EXTNAME'})"))
    return planes


def with_planes(
    hdus: fits.HDUList, planes: tuple[Plane, ...], shape: tuple[int, int]
) -> tuple[NDArray[np.bool_] | None, list[Note]]:
    """Pixels of a picture without light, by its planes (None: these do not say), and what was done with each plane."""
    blind: NDArray[np.bool_] | None = None
    notes = []
    for plane in planes:
        try:
            here = _without_light(hdus[plane.hdu], plane.kind)
        except MemoryError:
            raise
        except Exception:  # noqa: BLE001 - a plane that cannot be read is no reason to do without its picture
            here = None
        if here is None or here.shape != shape:
            done = "not searched, not used"
        elif here.all():
            done = "not searched, not used: it leaves no pixel"
        else:
            blind = here if blind is None else blind | here
            done = "not searched; its pixels without data are masked"
        notes.append(Note(kind=f"plane {plane.words}", text=f"HDU {plane.hdu} is {plane.words}: {done}"))
    return blind, notes


def _kind_of(hdu: Any) -> str | None:
    """What an image's name says that it is, if no picture."""
    named = f"{hdu.name} {hdu.header.get('EXTTYPE', '')}"  # compressed planes of LSST have EXTTYPE and no EXTNAME
    words = [word for word in re.split(r"[^A-Z]+", named.upper()) if word]
    for kind, names in KINDS.items():
        if any(word in names for word in words):
            return kind
    return None


def is_square_of_light(unit: object) -> bool:
    """Whether a whole unit (a value of BUNIT) is the square of one of light, as that of a variance is: `adu2`, `(MJy/sr)^2`.

    Pictures have squares in their units too: `mJy/arcsec^2`, `erg/s/cm**2/Angstrom`.
    """
    if not isinstance(unit, str):
        return False
    text = SCALE.sub("", unit.strip())
    whole = BRACKETED.fullmatch(text)
    factors = [(m[1], int(m[2] or 1)) for m in FACTOR.finditer(whole[1] if whole else text)]
    if whole is None and FACTOR.sub("", text).strip(" */.()[]"):
        return False
    factors = [(name, power * (2 if whole else 1)) for name, power in factors if not PIXEL.fullmatch(name)]
    return all(power % 2 == 0 for _, power in factors) and any(abs(p) == 2 and LIGHT.fullmatch(name) for name, p in factors)


def _holds_flags(hdu: Any) -> bool:
    """Whether an image of integers, beside another one of its size, can only be flags: few values, most of them zero."""
    if hdu.header.get("BITPIX", 0) < 0 or hdu.header.get("BSCALE", 1) != 1:
        return False
    data = hdu.data
    if data is None or data.dtype.kind not in "ui" or np.count_nonzero(data) > (1.0 - LEAST_UNFLAGGED) * data.size:
        return False
    values = np.unique(data)
    return len(values) <= MOST_FLAG_VALUES and int(values[0]) >= 0 and all(int(v).bit_count() <= 3 for v in values)


def _without_light(hdu: Any, kind: str) -> NDArray[np.bool_] | None:
    """Pixels without light by a plane of this kind; None where it does not say for certain."""
    data = hdu.data
    if data is None or data.dtype.kind not in "uif":
        return None
    if kind == "bad pixels":
        return np.asarray(data != 0)
    if kind == "flags":
        bits = [hdu.header[key] for key in NO_LIGHT_PLANES if isinstance(hdu.header.get(key), int)]
        if not bits or data.dtype.kind == "f":
            return None
        return np.asarray(data & sum(1 << bit for bit in set(bits) if 0 <= bit < 31) != 0)
    unknown = ~np.isfinite(data)
    return np.asarray(unknown | (data <= 0)) if kind == "weight" else np.asarray(unknown)
