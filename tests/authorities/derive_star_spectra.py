"""Makes simulator/optics/star_spectra.npz from published spectra and colours; run by hand when they change.

    python -m tests.authorities.derive_star_spectra ASTMG173.csv DAT_UVK EEM_DWARFS.txt

ASTMG173.csv : ASTM G173-03 with its extraterrestrial spectrum, as pvlib 0.16.1 ships it.
DAT_UVK : folder of the spectra of Pickles (1998, PASP 110, 863) as FITS, as EXOSIMS 3.6.6 ships it.
EEM_DWARFS.txt : mean dwarf colours of Pecaut & Mamajek (2013, ApJS 208, 9), version 2022.04.16, as MeanStars 3.6.1 ships them.

A library spectrum departs from the mean colours of its type by up to 0.1 mag. Each is therefore multiplied by a smooth
function of wavelength, through 436, 545, 641 and 798 nm, that makes its B-V, V-Rc and V-Ic (Bessell 1990 passbands, zero
points by the Sun's colours) those of the dwarf table; lines and bands stay as observed.

Red giants keep the library's V-Rc and V-Ic. Each stands at the B-V at which the stars that Tycho-2 and Gaia DR3 have in common,
nearly all giants where they are red, have its V-Ic on average; only the blue of 545 nm is bent to that B-V.
"""

import sys
from pathlib import Path

import numpy as np
from astropy.io import fits
from scipy.interpolate import PchipInterpolator

from sboc_e2e.catalogue.gaia import BP_RP_OF_B_V, G_MINUS_V
from tests.authorities.passbands import BESSELL_1990, SUN_COLOURS, magnitude

LIBRARY_TYPES = (
    *("B0V", "B1V", "B3V", "B8V", "A0V", "A2V", "A3V", "A5V", "A7V", "F0V", "F2V", "F5V", "F6V", "F8V"),
    *("G0V", "G5V", "G8V", "K0V", "K2V", "K3V", "K4V", "K5V", "K7V", "M0V", "M1V", "M2V", "M3V", "M4V", "M5V", "M6V"),
)
SPECTRUM_OF = {name: name for name in LIBRARY_TYPES} | {"K6V": "K5V", "K8V": "K7V", "M2.5V": "M2V", "M3.5V": "M4V"}
"""Types and the library's spectra that stand for them; between K5 and M4 colours change too much from one to the next."""
GIANTS = ("G8III", "K0III", "K1III", "K2III", "K3III", "K4III", "K5III", "M0III", "M1III", "M2III", "M3III", "M4III")
G_MINUS_V_OF_V_I = (-0.01597, -0.02809, -0.2483, 0.03656, -0.002939)
"""G - V in powers of V-Ic (Gaia DR3 documentation, section 5.5.1, table 5.9)."""
EFFECTIVE_NM = {"B": 436.0, "V": 545.0, "R": 641.0, "I": 798.0}
SUN_V_MAG = -26.76
EDGES_NM = np.concatenate([np.arange(300.0, 1100.0, 5.0), np.arange(1100.0, 2500.1, 20.0)])
SUN_EDGES_NM = np.concatenate([np.arange(280.0, 1100.0, 5.0), np.arange(1100.0, 4000.1, 20.0)])
PLANCK_C_J_NM = 6.62607015e-34 * 299792458.0 * 1e9


def binned_photons(wavelength_nm: np.ndarray, w_m2_nm: np.ndarray, edges_nm: np.ndarray) -> np.ndarray:
    """Mean photons per m2, s and nm of each bin."""
    photons = w_m2_nm * wavelength_nm / PLANCK_C_J_NM
    running = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(wavelength_nm) * (photons[1:] + photons[:-1]))])
    return np.diff(np.interp(edges_nm, wavelength_nm, running)) / np.diff(edges_nm)


def dwarf_colours(path: Path) -> dict[str, dict[str, float]]:
    """B-V, V-Rc and V-Ic of each type, where the table has them."""
    names: list[str] = []
    out = {}
    for line in path.read_text().splitlines():
        words = line.split()
        if line.startswith("SpT"):
            names = words
        elif names and line[:1] in tuple("OBAFGKM") and len(words) == len(names):
            row = dict(zip(names, words, strict=True))
            colours = {"B": row["B-V"], "R": row["V-Rc"], "I": row["V-Ic"]}
            out[words[0]] = {k: float(v) for k, v in colours.items() if v.strip(".")}
        elif names and line.startswith("#"):
            break
    return out


def as_the_sun_has_them(colours: dict[str, dict[str, float]]) -> dict[str, dict[str, float]]:
    """Colours shifted by as much (V-Rc 0.009, V-Ic 0.015 mag) as the table's dwarf of the Sun's B-V is redder than the Sun.

    The Sun looks like its twins; else stars and sunlit objects of one B-V would have zero points that differ by 0.009 mag. The
    shift holds from B-V 0.4 to 1.0 and fades to none at 0.0 and 1.4.
    """
    sunlike = [c for c in colours.values() if {"B", "R", "I"} <= c.keys() and 0.5 < c["B"] < 0.9]
    sunlike.sort(key=lambda c: c["B"])
    at = [c["B"] for c in sunlike]
    excess = {k: float(np.interp(SUN_COLOURS["B"], at, [c[k] for c in sunlike])) - SUN_COLOURS[k] for k in "RI"}
    sys.stdout.write(f"the table's colours less those of the Sun: {excess}\n")
    share = {
        name: float(np.interp(c["B"], (0.0, 0.4, 1.0, 1.4), (0.0, 1.0, 1.0, 0.0))) for name, c in colours.items() if "B" in c
    }
    return {name: {k: v - share.get(name, 0.0) * excess.get(k, 0.0) for k, v in c.items()} for name, c in colours.items()}


def giant_colour(v_i: float) -> float:
    """B-V, in Tycho-2, of giants with a V-Ic: both colours give the same G - V."""
    b_v = np.linspace(0.7, 2.2, 1501)
    g_v = np.polynomial.Polynomial(G_MINUS_V)(np.polynomial.Polynomial(BP_RP_OF_B_V)(b_v))
    return float(np.interp(-np.polynomial.Polynomial(G_MINUS_V_OF_V_I)(v_i), -g_v, b_v))


def main(sun_path: Path, library: Path, dwarfs: Path) -> None:
    """Write the file and print what became of the colours."""
    sun = np.genfromtxt(sun_path, delimiter=",", skip_header=2)[:, :2].T
    zero = {band: magnitude(*sun, band) for band in BESSELL_1990}
    colours = as_the_sun_has_them(dwarf_colours(dwarfs))
    index = fits.getdata(library / "pickles_uk.fits")
    file_of = {str(row["SPTYPE"]).strip(): str(row["FILENAME"]).strip() for row in index}
    b_v, photons, used = [], [], []
    giant_b_v, giant_photons = [], []
    for spectral_type, spectrum in (SPECTRUM_OF | dict(zip(GIANTS, GIANTS, strict=True))).items():
        giant = spectral_type in GIANTS
        path = library / f"{file_of.get(spectrum, spectrum)}.fits"
        if not path.exists() or not (giant or spectral_type in colours):
            sys.stdout.write(f"{spectral_type}: no spectrum or no colours\n")
            continue
        table = fits.getdata(path)
        wavelength_nm, flux = np.asarray(table["WAVELENGTH"], float) / 10.0, np.asarray(table["FLUX"], float)
        if giant:
            seen = {band: magnitude(wavelength_nm, flux, band) - zero[band] for band in "VRI"}
            wanted = {band: seen[band] - seen["V"] for band in "VRI"}
            wanted["B"] = giant_colour(SUN_COLOURS["I"] - wanted["I"]) - SUN_COLOURS["B"]
        else:
            own = colours[spectral_type]
            wanted = {"V": 0.0, **{k: (v - SUN_COLOURS[k]) * (1.0 if k == "B" else -1.0) for k, v in own.items()}}
        bands = [b for b in "BVRI" if b in wanted]
        log_nm = np.log([EFFECTIVE_NM[b] for b in bands])
        shift = np.zeros(len(bands))
        for _ in range(12):
            bend = PchipInterpolator(log_nm, shift)(np.clip(np.log(wavelength_nm), log_nm[0], log_nm[-1]))
            warped = flux * 10.0 ** (-0.4 * bend)
            got = np.array([magnitude(wavelength_nm, warped, b) - zero[b] for b in bands])
            shift += np.array([wanted[b] for b in bands]) - (got - got[bands.index("V")])
        offset = got[bands.index("V")]
        scale = 10.0 ** (0.4 * (SUN_V_MAG + offset))  # as bright in V as a V = 0 star
        sys.stdout.write(f"{spectral_type}: bent by {np.ptp(shift):.3f} mag between {EFFECTIVE_NM[bands[0]]:.0f} and 798 nm\n")
        binned = binned_photons(wavelength_nm, warped * scale, EDGES_NM)
        if giant:
            giant_b_v.append(wanted["B"] + SUN_COLOURS["B"])
            giant_photons.append(binned)
            continue
        b_v.append(colours[spectral_type]["B"])
        photons.append(binned)
        used.append(spectral_type)
    np.savez_compressed(
        Path(__file__).parents[2] / "simulator" / "optics" / "star_spectra.npz",
        sun_edges_nm=SUN_EDGES_NM.astype(np.float32),
        sun_photons_m2_s_nm=(binned_photons(*sun, SUN_EDGES_NM) * 10.0 ** (0.4 * SUN_V_MAG)).astype(np.float32),
        edges_nm=EDGES_NM.astype(np.float32),
        b_v=np.array(b_v, dtype=np.float32),
        photons_m2_s_nm=np.array(photons, dtype=np.float32),
        spectral_type=np.array(used),
        giant_type=np.array(GIANTS),
        giant_b_v=np.array(giant_b_v, dtype=np.float32),
        giant_photons_m2_s_nm=np.array(giant_photons, dtype=np.float32),
    )


if __name__ == "__main__":
    main(*(Path(a) for a in sys.argv[1:4]))
