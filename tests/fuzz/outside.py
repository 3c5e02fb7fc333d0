"""Fuzz target: frames with any header and content through the whole of `process`; each is a frame, and none costs another.

The bytes choose keys, values, a projection and pixels. A file without surprises lies beside the odd one.
"""

import json
import shutil
import tempfile
import warnings
from pathlib import Path
from typing import Any, Final

import numpy as np
from astropy.io import fits
from astropy.table import Table

from sboc_e2e import scenario as scenarios
from sboc_e2e.icd.errors import UserError
from sboc_e2e.outside.fits_frames import FitsFolder
from sboc_e2e.outside.lone_frame import LoneFrame
from sboc_e2e.outside.process import base_document, process
from sboc_e2e.registry import Registry
from sboc_e2e.run.progress import Silent

PROJECTIONS: Final = (
    "TAN", "SIN", "ARC", "STG", "ZEA", "ZPN", "AZP", "SZP", "AIR", "CYP", "CEA", "CAR", "MER", "SFL", "PAR", "MOL", "AIT",
    "COP", "COE", "COD", "COO", "BON", "PCO", "TSC", "CSC", "QSC", "HPX", "XPH", "TPV", "TAN-SIP", "TNX", "ZPX", "XXX",
)  # fmt: skip
SYSTEMS: Final = (("RA--", "DEC-"), ("DEC-", "RA--"), ("GLON", "GLAT"), ("ELON", "ELAT"), ("RA--", "RA--"))
ODD: Final = (0.0, -0.0, 1.0, -1.0, 1e-30, 1e30, -1e308, 90.0, -90.0, 360.0, "10.0", "", "NaN", True, None)
KEYS: Final = (
    "CRVAL1", "CRVAL2", "CRPIX1", "CRPIX2", "CD1_1", "CD1_2", "CD2_1", "CD2_2", "CDELT1", "PC1_1", "CROTA2", "CUNIT1", "RADESYS",
    "EQUINOX", "LONPOLE", "LATPOLE", "PV1_1", "PV2_1", "PV2_3", "A_ORDER", "A_2_0", "WAT1_001", "WCSAXES", "GAIN", "EXPTIME",
    "RDNOISE", "SATURATE", "DATE-OBS", "MJD-OBS", "BUNIT", "PIXSCALE", "FOCALLEN", "XPIXSZ", "CUNIT2", "CTYPE2", "A_1_1", "B_0_2",
    "AP_ORDER", "PV2_0", "PV2_2", "PV1_4", "CD1_3", "PC2_2", "MJDREF", "CNAME1", "LTV1", "VELOSYS", "TIMESYS", "NAXIS3", "BLANK",
)  # fmt: skip
TEXTS: Final = (
    "deg", "rad", "arcsec", "Hz", "furlong", "FK4", "FK5", "ICRS", "GALACTIC", "B1950", "2024-02-30T25:61:61", "1e400",
    "2024-01-01", "0x10", "-", "'", "x" * 60,
)  # fmt: skip
NUMPY_TYPES: Final = ("u1", "i2", "u2", "i4", "u4", "i8", "f4", "f8")


def one_input(data: bytes) -> None:
    """Products of an odd frame and a plain one, or a one-line refusal of an odd file that stands alone."""
    rng = np.random.default_rng(list(data) or [0])
    with tempfile.TemporaryDirectory(prefix="sboc-fuzz-") as name, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        folder = Path(name) / "frames"
        folder.mkdir()
        plain = fits.PrimaryHDU(content(np.random.default_rng(1), (48, 48), "trail").astype(np.float32))
        plain.writeto(folder / "b.fits")
        odd_file(rng).writeto(folder / "a.fits", output_verify="ignore")
        run(folder, Path(name) / "out")
        frames = Table.read(Path(name) / "out" / "products" / "frames.ecsv", format="ascii.ecsv")
        assert "b.fits" in frames["file"]
        shutil.rmtree(Path(name) / "out")
        (folder / "b.fits").unlink()
        try:
            run(folder, Path(name) / "out")
        except UserError as error:
            assert "\n" not in str(error)


def run(folder: Path, out: Path, begun: LoneFrame | None = None) -> dict[str, Any]:
    """`sboc process` with its defaults; what ingest.json says. begun : see `process`."""
    registry = Registry()
    scenario = scenarios.bare("process", base_document("header"), registry=registry)
    process(FitsFolder(path=folder), scenario, out, camera=None, begun=begun, force=True, registry=registry, progress=Silent())
    ingest: dict[str, Any] = json.loads((out / "products" / "ingest.json").read_text(encoding="utf-8"))
    return ingest


def odd_file(rng: np.random.Generator) -> fits.HDUList:
    """A primary HDU of odd content under an odd header, sometimes with a plane beside it."""
    shape = tuple(int(side) for side in rng.integers(16, 80, 2))
    kind = str(rng.choice(["trail", "stars", "noise", "zeros", "constant", "nan", "huge", "holes", "negative", "step"]))
    image = typed(rng, content(rng, shape, kind))
    form = rng.random()
    if form < 0.05:  # a cube, a line, a picture in a cube of one plane, a side that is too small
        image = [image[None], image[0], np.stack((image, image)), image[:3]][int(rng.integers(4))]
    hdu = fits.PrimaryHDU(image)
    header(rng, hdu.header, shape)
    hdus = [hdu]
    if rng.random() < 0.3:
        plane = np.where(rng.random(shape) < 0.1, rng.choice([1, 64]), 0).astype(np.int16)
        hdus.append(fits.ImageHDU(plane, name=str(rng.choice(["DQ", "MASK", "VAR", "WHT", "BPM", "ERR", "SCI", ""]))))
    return fits.HDUList(hdus)


def typed(rng: np.random.Generator, image: np.ndarray) -> np.ndarray:
    """Pixels as a number type of FITS; integers wrap around or are clipped where they do not fit."""
    name = str(rng.choice(NUMPY_TYPES)) if rng.random() < 0.5 else "f4"
    with np.errstate(all="ignore"):
        if name.startswith("f"):
            return image.astype(name)
        whole = np.nan_to_num(image).clip(-(2.0**62), 2.0**62)
        limits = np.iinfo(name)
        return (whole.astype("i8") if rng.random() < 0.5 else whole.clip(limits.min, min(limits.max, 2**62))).astype(name)


def content(rng: np.random.Generator, shape: tuple[int, ...], kind: str) -> np.ndarray:
    """Pixels of a kind."""
    grid = np.mgrid[: shape[0], : shape[1]].astype(float)
    image = rng.normal(300.0, 4.0, shape)
    if kind in ("trail", "stars", "holes", "negative"):
        spots = [(*(rng.uniform(0.1, 0.9, 2) * shape), 4000.0) for _ in range(8)]
        if kind != "stars":
            spots += [(shape[0] * (0.4 + 0.2 * p), shape[1] * (0.2 + 0.6 * p), 400.0) for p in np.linspace(0, 1, 60)]
        for row, col, flux in spots:
            image += flux / 9.0 * np.exp(-0.35 * ((grid[0] - row) ** 2 + (grid[1] - col) ** 2))
    if kind in ("zeros", "constant"):
        image[:] = 0.0 if kind == "zeros" else 1234.5
    elif kind == "nan":
        image[:] = np.nan
    elif kind == "huge":
        image *= float(rng.choice([1e30, 1e36, 1e-30]))
    elif kind == "holes":
        image[rng.random(shape) < rng.random()] = rng.choice([np.nan, np.inf, -np.inf])
    elif kind == "negative":
        image = -image
    elif kind == "step":
        image[shape[0] // 2 :] += 10.0 ** rng.uniform(0, 6)
    return image


def header(rng: np.random.Generator, cards: fits.Header, shape: tuple[int, ...]) -> None:
    """A WCS at random, of which some keys are odd or absent, and other keys of any value."""
    if rng.random() < 0.9:
        axes, projection = SYSTEMS[int(min(rng.geometric(0.6), len(SYSTEMS)) - 1)], str(rng.choice(PROJECTIONS))
        cards["CTYPE1"], cards["CTYPE2"] = (f"{axis}-{projection}" for axis in axes)
        cards["CRVAL1"], cards["CRVAL2"] = rng.uniform(0, 360), float(rng.choice([90.0, -90.0, rng.uniform(-90, 90)]))
        cards["CRPIX1"], cards["CRPIX2"] = 0.5 * shape[1], 0.5 * shape[0]
        scale, turn = 10.0 ** rng.uniform(-5, 1), rng.uniform(0, 2 * np.pi)
        cards["CD1_1"], cards["CD1_2"] = -scale * np.cos(turn), scale * np.sin(turn)
        cards["CD2_1"], cards["CD2_2"] = scale * np.sin(turn), scale * np.cos(turn)
        if "SIP" in projection:
            cards["A_ORDER"] = cards["B_ORDER"] = 2
            cards["A_2_0"] = 10.0 ** rng.uniform(-9, 0)
        if projection in ("TPV", "ZPN", "ZPX"):
            cards["PV2_1"], cards["PV1_1"] = 1.0, 1.0
            cards["PV2_3"] = rng.normal(0, 10.0)
        if projection in ("TNX", "ZPX"):
            numbers = " ".join(f"{number:.6g}" for number in rng.normal(0.0, 10.0 ** rng.uniform(-6, 1), 14))
            for axis, name in enumerate(("lng", "lat"), start=1):
                cards[f"WAT{axis}_001"] = f'wtype={projection.lower()} axtype={name} {name}cor = "{rng.integers(1, 4)}. 3. 3. 2. '
                cards[f"WAT{axis}_002"] = f'{numbers[:55]}"'
    for _ in range(int(rng.integers(0, 5))):
        values = ODD if rng.random() < 0.7 else TEXTS
        key, value = str(rng.choice(KEYS)), values[int(rng.integers(len(values)))]
        if rng.random() < 0.2:
            cards.remove(key, ignore_missing=True)
        else:
            cards[key] = value
    if rng.random() < 0.1:
        for key in ("CD1_1", "CD1_2", "CD2_1", "CD2_2"):
            cards[key] = 0.0
    (apart,) = rng.spawn(1)  # a stream of its own: files of earlier seeds stay otherwise as they were
    if apart.random() < 0.1:
        key = str(apart.choice([key for key in KEYS if key not in ("BLANK", "BSCALE", "BZERO")]))  # the writer reads these
        cards.remove(key, ignore_missing=True)
        cards.append(fits.Card.fromstring(f"{key:<8}= 'a quote that does not end / of {key}"))
