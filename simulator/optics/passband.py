"""What a camera makes of light: spectrum times optics times quantum efficiency, integrated over the band.

Photons come from published spectra: the Sun's from ASTM G173-03 (extraterrestrial) at V = -26.76, stars' from the library of
Pickles (1998): dwarfs bent to their mean colours (Pecaut & Mamajek 2013), red giants as observed; `star_spectra.md` says how
the file was made.
"""

from dataclasses import dataclass, field
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.errors import UserError

Array = NDArray[np.float64]

SPECTRA_PATH: Final = Path(__file__).parent / "star_spectra.npz"
SUN_B_V: Final = 0.653
"""The Sun's B-V (Ramirez et al. 2012, ApJ 752, 5); zero points hold for this colour."""
SHORTEST_NM: Final = 280.0  # where ASTM G173-03 begins
LONGEST_NM: Final = 4000.0  # where ASTM G173-03 ends
_STEP_NM: Final = 1.0  # longest piece of the midpoint rule; the spectra's own bins cut it further


@dataclass(frozen=True, kw_only=True)
class CurvePointOptions:
    """One point of a curve over wavelength."""

    wavelength_nm: float = field(default=600.0, metadata={"doc": "wavelength", "min": SHORTEST_NM, "max": LONGEST_NM})
    value: float = field(default=1.0, metadata={"doc": "factor at this wavelength", "min": 0.0, "max": 1.0})


Curve = tuple[CurvePointOptions, ...]


@dataclass(frozen=True, kw_only=True)
class Passband:
    """Electrons for each photon at the entrance pupil: constant times two curves between the edges, none outside.

    A curve is linear between its points and keeps the values of its ends beyond them; without points it is 1.
    """

    short_nm: float
    long_nm: float
    peak: float
    curves: tuple[Curve, ...] = ()

    def response(self, wavelength_nm: Array) -> Array:
        """Electrons for each photon."""
        out = np.where((wavelength_nm >= self.short_nm) & (wavelength_nm <= self.long_nm), self.peak, 0.0)
        for curve in self.curves:
            if curve:
                out = out * np.interp(wavelength_nm, [p.wavelength_nm for p in curve], [p.value for p in curve])
        return out


def refuse_disorder(key: str, curve: Curve) -> None:
    """UserError for points that are not in the order of their wavelengths."""
    for before, after in pairwise(curve):
        if after.wavelength_nm <= before.wavelength_nm:
            raise UserError(
                f"{key}: {after.wavelength_nm:g} nm follows {before.wavelength_nm:g} nm; allowed are growing wavelengths"
            )


class _Spectra(NamedTuple):
    """Photons per m2, s and nm of V = 0: of the Sun in bins, of dwarfs by B-V (the Sun among them), then of giants by B-V."""

    sun_edges_nm: Array
    sun: Array
    edges_nm: Array
    dwarf_b_v: Array
    giant_b_v: Array
    stars: Array


@cache
def _spectra() -> _Spectra:
    with np.load(SPECTRA_PATH) as content:
        names = (
            "sun_edges_nm",
            "sun_photons_m2_s_nm",
            "edges_nm",
            "b_v",
            "photons_m2_s_nm",
            "giant_b_v",
            "giant_photons_m2_s_nm",
        )
        sun_edges, sun, edges, b_v, dwarfs, giant_b_v, giants = (content[name].astype(np.float64) for name in names)
    middle = 0.5 * (edges[1:] + edges[:-1])
    sun_among_stars = sun[np.searchsorted(sun_edges, middle, side="right") - 1]
    order = np.argsort(np.append(b_v, SUN_B_V))
    stars = np.vstack([np.vstack([dwarfs, sun_among_stars])[order], giants])
    return _Spectra(sun_edges, sun, edges, np.append(b_v, SUN_B_V)[order], giant_b_v, stars)


@cache
def _electrons(band: Passband) -> tuple[float, Array]:
    """Electrons per m2 and s of V = 0: of the Sun, and of each star of the library.

    Spectra are constant in their bins, so that the midpoint rule on pieces of at most a nanometre is exact where the
    response is linear. Where the library ends, a star keeps its last ratio to the Sun.
    """
    spectra = _spectra()
    nodes = [p.wavelength_nm for curve in band.curves for p in curve]
    steps = np.arange(band.short_nm, band.long_nm, _STEP_NM)
    edges = np.unique(np.concatenate([steps, [band.long_nm], spectra.sun_edges_nm, spectra.edges_nm, nodes]))
    edges = edges[(edges >= band.short_nm) & (edges <= band.long_nm)]
    middle = 0.5 * (edges[1:] + edges[:-1])
    weight = band.response(middle) * np.diff(edges)
    sun = spectra.sun[np.searchsorted(spectra.sun_edges_nm, middle, side="right") - 1]
    places = 0.5 * (spectra.edges_nm[1:] + spectra.edges_nm[:-1])
    own = np.clip(np.searchsorted(spectra.edges_nm, middle, side="right") - 1, 0, len(places) - 1)
    sun_there = spectra.sun[np.searchsorted(spectra.sun_edges_nm, places, side="right") - 1]
    ratio = (spectra.stars / sun_there)[:, own]
    return float(sun @ weight), np.asarray(ratio @ (sun * weight))


def sun_electrons_m2_s(band: Passband) -> float:
    """Electrons per m2 and s of a star of V = 0 and the Sun's spectrum."""
    return _electrons(band)[0]


def colour_factor(b_v: Array, band: Passband, giant: NDArray[np.bool_] | None = None) -> Array:
    """Electrons of stars of a colour over those of a star of the Sun's colour and the same V.

    Dwarfs of the library, linear in magnitude between their B-V, the ends' values beyond. Those that are a giant and redder
    than the bluest one of the library, B-V 0.88, take the giants' values: at B-V 1.65 a dwarf has V-Ic = 2.8, a giant 1.8.

    giant : (n,) which stars are giants; None for none.
    """
    spectra = _spectra()
    sun, stars = _electrons(band)
    magnitude = np.log(np.maximum(stars, 1e-12 * sun) / sun)
    n = len(spectra.dwarf_b_v)
    out = np.interp(b_v, spectra.dwarf_b_v, magnitude[:n])
    if giant is not None:
        red = giant & (b_v > spectra.giant_b_v[0])
        out = np.where(red, np.interp(b_v, spectra.giant_b_v, magnitude[n:]), out)
    return np.asarray(np.exp(out))
