"""The wavefront that leaves the optics: Zernike errors drawn by seed, other ones at each place of the field, and its OTF.

A PSF is the transform of an optical transfer function; what blurs it further (charge diffusion, residual motion, the pixel)
multiplies that function, so that nothing finer than a pixel needs to be sampled. Zernike polynomials are those of Noll (1976,
JOSA 66, 207), of unit variance over the pupil.
"""

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final

import numpy as np
import scipy  # scipy.fft is loaded where it is used: most programs draw no PSF of a wavefront
from numpy.typing import NDArray

from simulator.optics.passband import Passband, sun_electrons_m2_s
from simulator.randomness import Effect, generator

Array = NDArray[np.float64]

PERIOD_PX: Final = 20.0
"""Period of the PSF; the step of the OTF is its inverse."""
NODES: Final = 5
"""Places of the field along either axis at which OTFs are computed."""
_WAVELENGTHS: Final = 4  # of equal electrons; 8 change the noise-equivalent area by 4e-5 at most (F/2, 100 nm rms, 420 to 850 nm)
_MOST_SAMPLES: Final = 640  # across the transform: a budget of time; it coarsens diffraction where lambda F is below 1/16 px
_SHARES: Final = {"defocus": 0.30, "astigmatism": 0.30, "coma": 0.22, "trefoil": 0.10, "spherical": 0.08}
"""Of the variance: the lower the order the larger, as alignment and figure errors have it (Noll's residuals fall alike)."""
_TERMS: Final = ("defocus", "astigmatism", "astigmatism", "coma", "coma", "trefoil", "trefoil", "spherical")


@dataclass(frozen=True, kw_only=True)
class WavefrontOptions:
    """Errors of the wavefront beyond the nominal PSF; 0 nm: a Gaussian PSF."""

    rms_nm: float = field(
        default=0.0,
        metadata={
            "doc": "rms over pupil, field and seeds of the wavefront's errors (defocus to spherical), for which the Gaussian "
            "share of the PSF shrinks; 0: the PSF is a Gaussian",
            "min": 0.0,
            "max": 5000.0,
        },
    )
    field_share: float = field(
        default=0.5, metadata={"doc": "share of the variance that changes sign across the field", "min": 0.0, "max": 1.0}
    )


def zernike_terms(x: Array, y: Array) -> Array:
    """Noll's Z4, Z5, Z6, Z7, Z8, Z9, Z10 and Z11, (8, ...), at places of the unit pupil."""
    r2 = x * x + y * y
    return np.stack(
        [
            np.sqrt(3.0) * (2.0 * r2 - 1.0),
            np.sqrt(6.0) * 2.0 * x * y,
            np.sqrt(6.0) * (x * x - y * y),
            np.sqrt(8.0) * (3.0 * r2 - 2.0) * y,
            np.sqrt(8.0) * (3.0 * r2 - 2.0) * x,
            np.sqrt(8.0) * (3.0 * x * x - y * y) * y,
            np.sqrt(8.0) * (x * x - 3.0 * y * y) * x,
            np.sqrt(5.0) * (6.0 * r2 * r2 - 6.0 * r2 + 1.0),
        ]
    )


def draw_coefficients_nm(options: WavefrontOptions, seed: int) -> Array:
    """(NODES, NODES, 8) coefficients over the field: a constant and a tilt along either axis, each normal."""
    rng = generator(seed, Effect.WAVEFRONT)
    share = np.array([_SHARES[name] / _TERMS.count(name) for name in _TERMS])
    constant, along_rows, along_cols = rng.standard_normal((3, len(_TERMS))) * options.rms_nm * np.sqrt(share)
    place = np.linspace(-1.0, 1.0, NODES)
    tilt = np.sqrt(1.5) * (
        place[:, None, None] * along_rows + place[None, :, None] * along_cols
    )  # unit mean variance over the field
    return np.asarray(np.sqrt(1.0 - options.field_share) * constant + np.sqrt(options.field_share) * tilt)


def expected_variance_px2(options: WavefrontOptions, f_number: float, pixel_um: float) -> float:
    """Mean geometric variance of the spot along one axis: mean square slopes, ``x = 2 F dW/drho`` for the unit pupil."""
    n = 200
    y, x = np.meshgrid(*2 * ((np.arange(n) + 0.5) / n * 2.0 - 1.0,), indexing="ij")
    terms = zernike_terms(x, y)
    inside = np.hypot(x, y) < 1.0
    slope2 = np.sum([np.gradient(terms, 2.0 / n, axis=axis)[:, inside] ** 2 for axis in (1, 2)], axis=0)
    share = np.array([_SHARES[name] / _TERMS.count(name) for name in _TERMS])
    rms_um = 1e-3 * options.rms_nm
    return float(0.5 * (share * slope2.mean(axis=1)).sum() * (2.0 * f_number * rms_um / pixel_um) ** 2)


def frequencies_px(highest: float) -> Array:
    """Spatial frequencies (cycles per pixel) of an OTF up to a highest one, symmetric about 0."""
    n = int(highest * PERIOD_PX)
    return np.arange(-n, n + 1) / PERIOD_PX


def transfer_functions(
    options: WavefrontOptions, band: Passband, f_number: float, pixel_um: float, obstruction: float, seed: int, frequency: Array
) -> NDArray[np.complex64]:
    """OTF of the band at the nodes of the field, (NODES, NODES, n, n) for rows by columns of `frequency`; 1 at frequency 0.

    A mean over wavelengths of equal shares of the Sun's electrons. Where the pixels are so wide that the pupil would need more
    than `_MOST_SAMPLES`, diffraction is taken for coarser than it is; the geometric spot stays.
    """
    coefficients = draw_coefficients_nm(options, seed)
    wavelengths_nm = _wavelengths_nm(band)
    finest_px = PERIOD_PX / (0.5 * _MOST_SAMPLES)
    out = np.zeros((NODES, NODES, frequency.size, frequency.size), dtype=np.complex64)
    half = frequency.size // 2
    for wavelength_nm in wavelengths_nm:
        scale_px = max(1e-3 * wavelength_nm * f_number / pixel_um, finest_px)  # lambda F
        radius = 0.5 * PERIOD_PX / scale_px  # of the pupil, in samples
        size = scipy.fft.next_fast_len(int(np.ceil(4.0 * radius)) + 2)
        place = (np.arange(int(np.ceil(2.0 * radius)) + 2) - radius - 0.5) / radius
        y, x = place[:, None], place[None, :]
        r = np.hypot(x, y)
        pupil = np.clip((1.0 - r) * radius + 0.5, 0.0, 1.0)
        if obstruction > 0.0:
            pupil *= np.clip((r - obstruction) * radius + 0.5, 0.0, 1.0)
        terms = zernike_terms(np.broadcast_to(x, r.shape), np.broadcast_to(y, r.shape)).astype(np.float32)
        for i in range(NODES):
            for j in range(NODES):
                turns = np.tensordot(coefficients[i, j].astype(np.float32) / np.float32(wavelength_nm), terms, axes=1)
                amplitude = (pupil * np.exp(2j * np.pi * turns)).astype(np.complex64)
                power = np.abs(scipy.fft.fft2(amplitude, (size, size))) ** 2
                otf = scipy.fft.ifft2(power)
                otf = np.roll(otf, (half, half), axis=(0, 1))[: frequency.size, : frequency.size]
                # Rim samples hold parts of the pupil: their squares would miss some of the light.
                otf /= pupil.sum()
                otf[half, half] = 1.0
                out[i, j] += otf / len(wavelengths_nm)
    return out


def _wavelengths_nm(band: Passband) -> Array:
    """Middles of parts of the band that hold equal shares of the Sun's electrons."""
    edges = np.linspace(band.short_nm, band.long_nm, 41)
    parts = [
        sun_electrons_m2_s(Passband(short_nm=float(a), long_nm=float(b), peak=band.peak, curves=band.curves))
        for a, b in pairwise(edges.tolist())
    ]
    running = np.concatenate([[0.0], np.cumsum(parts)])
    return np.asarray(np.interp((np.arange(_WAVELENGTHS) + 0.5) / _WAVELENGTHS * running[-1], running, edges))
