"""Matched-filter S/N of trails without an image: from the camera's own PSF, and with the noise of the stars below them.

A uniform trail of flux F and length L on a noise of variance V per pixel has ``S^2 = F^2 E(L) / V`` with

    E(L) = (2 / L^2) integral from 0 to L of (L - t) A(t) dt        1 / px^2

where A(t) is the overlap of the PSF, pixels included, with itself at a distance t. Against a Gaussian of the same
noise-equivalent area, wings make a trail fainter: 1 % at 10 px, 6 % at 300 px with the PSF `as_measured`.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.special import erf

from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.catalogue.healpix import pixel_of, pixels_in_cone
from simulator.camera import Camera
from simulator.optics.psf_field import GRID, HALF_PX, PHASES
from simulator.scene.stars import FAINT_B_V, StarOptions, angles_deg, cumulative_counts_deg2, over_mean_density

Array = NDArray[np.float64]

PIXEL_VARIANCE_PX2: Final = 1.0 / 12.0
"""Of a square pixel along either axis."""
LENGTHS_PX: Final = np.geomspace(0.05, 3000.0, 160)
"""Lengths of the table, 7 % apart: linear in their logarithm it errs by less than 1e-3."""
BRIGHTEST_MAG: Final = 7.5  # The counts begin there; the 0.65 a square degree that are brighter count as of this magnitude.
COUNT_STEP_MAG: Final = 0.1  # Of the sum over magnitudes. Chosen
VARIANCES_E2: Final = np.geomspace(0.5, 1e5, 60)  # of a pixel, from less than read noise to moonlight at the Moon's rim
HALO_REACH_PX: Final = 120.0  # Halos of bright stars take something to here; farther ones are part of the sky. Chosen
PLACES: Final = 3 * GRID  # Along either axis of the window, at which the PSF's tables are asked for: thrice as many as there are.


def gaussian_energy(length_px: Array, sigma_px: Array) -> Array:
    """E of a Gaussian PSF in closed form, 1 / px^2, of lengths and sigmas that broadcast against each other."""
    x = np.maximum(length_px / (2.0 * sigma_px), 1e-4)  # half the length in sigmas; below, E is that of a point to 1e-9
    along = (np.sqrt(np.pi) * x * erf(x) - 1.0 + np.exp(-x * x)) / (x * x)
    return np.asarray(along / (4.0 * np.pi * sigma_px**2))


def _radial_overlap(table: NDArray[np.float32]) -> Array:
    """A (k,) at distances of k / PHASES px, the mean of all directions, of a table (n, n) of a PSF."""
    n = len(table)
    spectrum = np.abs(np.fft.rfft2(table, (2 * n, 2 * n))) ** 2
    overlap = np.fft.fftshift(np.fft.irfft2(spectrum, (2 * n, 2 * n))) / PHASES**2
    ring = np.rint(np.hypot(*np.meshgrid(np.arange(-n, n), np.arange(-n, n), indexing="ij"))).astype(np.int64).ravel()
    total, count = np.bincount(ring, weights=overlap.ravel()), np.bincount(ring)
    return np.asarray((total / count)[: 2 * HALF_PX * PHASES])


@dataclass(frozen=True, kw_only=True, eq=False)
class TrailEnergy:
    """E of trails anywhere in a camera's window."""

    camera: Camera

    def of(self, length_px: Array, row: Array, col: Array, defocus_px: Array) -> Array:
        """E (n,), 1 / px^2, of trails with lengths, middles and discs of defocus (n,), all in pixels of the detector.

        A disc counts with its variance, as a Gaussian would: of a PSF with wings what it takes from a Gaussian's E.
        """
        obstruction = self.camera.instrument.obstruction
        disc_px2 = defocus_px**2 / 16.0 * (1.0 + obstruction**2)
        inside = np.clip(row, 0.0, self.camera.shape[0] - 1.0), np.clip(col, 0.0, self.camera.shape[1] - 1.0)
        sigma_px = np.sqrt(self.camera.sigma_at(*inside) ** 2 + PIXEL_VARIANCE_PX2)
        blurred = gaussian_energy(length_px, np.hypot(sigma_px, np.sqrt(disc_px2)))
        field = self.camera.psf_field
        if field is None:
            return blurred
        node = field.node(*inside)
        step = np.log(LENGTHS_PX[1] / LENGTHS_PX[0])
        place = np.clip(np.log(np.maximum(length_px, LENGTHS_PX[0]) / LENGTHS_PX[0]) / step, 0.0, len(LENGTHS_PX) - 1.001)
        low = place.astype(np.int64)
        sharp = self._tables[node, low] + (place - low) * (self._tables[node, low + 1] - self._tables[node, low])
        return np.asarray(np.exp(sharp) * blurred / gaussian_energy(length_px, sigma_px))

    @cached_property
    def _tables(self) -> Array:
        """ln E (tables, lengths) of the PSF's tables in the window; NaN for tables outside it."""
        field = self.camera.psf_field
        if field is None:
            return np.zeros((0, len(LENGTHS_PX)))
        grid = np.meshgrid(*(np.linspace(0.0, n - 1.0, PLACES) for n in self.camera.shape), indexing="ij")
        out = np.full((len(field.tables), len(LENGTHS_PX)), np.nan)
        for k in np.unique(field.node(grid[0].ravel(), grid[1].ravel())):
            out[k] = np.log(_energies(_radial_overlap(field.tables[k])))
        return out


def _energies(overlap: Array) -> Array:
    """E at `LENGTHS_PX` of a PSF's overlap at distances of k / PHASES px."""
    distance = np.arange(len(overlap)) / PHASES
    fine = np.linspace(0.0, distance[-1], 8 * len(distance))
    even = np.interp(fine, distance, overlap)
    below, moment = (np.interp(LENGTHS_PX, fine, cumulative_trapezoid(y, fine, initial=0.0)) for y in (even, even * fine))
    return np.asarray(2.0 * (LENGTHS_PX * below - moment) / LENGTHS_PX**2)


class StarNoise:
    """What the noise of stars takes from the S/N of trails, in the mean over a field.

    A star of f electrons takes from S^2 what lies on ``a = sum of f p / (V + f p)`` pixels, p the shares of its light in them.
    Stars at random places with n(m) in a pixel leave the share ``exp(-integral of n a dm)`` of S^2. Their numbers are all-sky
    counts scaled to the catalogue's stars in the field, as those of the pixel chain's faint stars are.
    """

    def __init__(self, camera: Camera, options: StarOptions, catalogue: StarCatalogue) -> None:
        self._reach_rad = camera.radius_rad / np.sqrt(0.5 * np.pi)  # a circle of the field's area
        area_deg2 = float(np.degrees(np.degrees(4.0 * np.pi))) / len(catalogue.pixel_counts)
        self._scale = over_mean_density(catalogue, catalogue.v_max, area_deg2)
        nodes = np.arange(BRIGHTEST_MAG, max(options.faint_limit_mag, catalogue.v_max), COUNT_STEP_MAG)
        ends = cumulative_counts_deg2(np.append(nodes, nodes[-1] + COUNT_STEP_MAG))
        number = np.diff(ends, prepend=0.0)[1:] * float(np.degrees(1.0 / camera.projection.focal_px)) ** 2
        number[0] += ends[0] * float(np.degrees(1.0 / camera.projection.focal_px)) ** 2  # all that are brighter
        colour = camera.instrument.colour_factor(np.array([FAINT_B_V]))[0] if options.colours else 1.0
        flux_e = camera.zero_point_e_s * camera.exposure_s * colour * 10.0 ** (-0.4 * (nodes + 0.5 * COUNT_STEP_MAG))
        light, area = _light_of_a_star(camera)
        self._lost = np.array(
            [number @ (flux_e[:, None] * light / (v + flux_e[:, None] * light) * area).sum(axis=1) for v in VARIANCES_E2]
        )
        if not options.enabled:
            self._lost *= 0.0

    def share(self, boresight: Array, variance_e2: Array) -> Array:
        """Share (m,) of S^2 that is left in fields around directions (m, 3), at variances (m,) of a pixel without stars."""
        ra, dec = angles_deg(boresight)
        pixels = pixel_of(ra, dec)
        scale = np.empty(len(pixels))
        for pixel in np.unique(pixels):  # nothing is kept for later calls: a block must not depend on those before it
            here = pixels == pixel
            scale[here] = self._scale[pixels_in_cone(boresight[np.flatnonzero(here)[0]], self._reach_rad)].mean()
        return np.exp(-scale * np.interp(np.log(variance_e2), np.log(VARIANCES_E2), self._lost))


def _light_of_a_star(camera: Camera) -> tuple[Array, Array]:
    """Shares of a star's light per pixel in the middle of the window, and the area (px) on which each falls."""
    middle = np.array([0.5 * (n - 1.0) for n in camera.shape])
    field = camera.psf_field
    if field is None:
        variance = float(camera.sigma_at(middle[:1], middle[1:])[0]) ** 2 + PIXEL_VARIANCE_PX2
        radius = (np.arange(200) + 0.5) * 0.05 * np.sqrt(variance)  # to 10 sigma
        return np.exp(-0.5 * radius**2 / variance) / (2.0 * np.pi * variance), 2.0 * np.pi * radius * (radius[1] - radius[0])
    table = np.asarray(field.tables[int(field.node(middle[:1], middle[1:])[0])], dtype=np.float64)
    edges = np.geomspace(1.0, HALO_REACH_PX / HALF_PX, 60) * HALF_PX * np.sqrt(4.0 / np.pi)  # outside a square as large
    radius = np.sqrt(edges[1:] * edges[:-1])
    light = np.concatenate([table.ravel(), field.halo.ring(radius)])
    return light, np.concatenate([np.full(table.size, 1.0 / PHASES**2), np.pi * np.diff(edges**2)])
