"""The built and the nominal camera: geometry, illumination and PSF over the read-out window, and calibration.

Pixels are unbinned pixels of the detector's read-out window, unless a name says "delivered".
"""

import copy
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.errors import UserError
from sboc_e2e.icd.frame import Calibration, NominalCamera
from simulator.optics.halo import make_halo
from simulator.optics.instrument import InstrumentOptions
from simulator.optics.passband import SUN_B_V
from simulator.optics.psf import PsfOptions, sigma_at
from simulator.optics.psf_field import GRID, PsfField, field_functions
from simulator.optics.vignetting import IlluminationGrid, VignettingOptions, grid_step_px, node_places, relative_illumination
from simulator.optics.wavefront import expected_variance_px2
from simulator.sensor import Sensor, SensorOptions

Array = NDArray[np.float64]


LEAST_GAUSSIAN = 0.4
"""Least Gaussian share of the nominal width, by charge diffusion and residual motion, for any wavefront."""


class Camera:
    """An instrument and its sensor. `seeing_px` (Gaussian sigma) widens the PSF of a camera on the ground.

    seeing_error : the seeing over that of the camera file, less 1. UserError for binning that is not square.
    """

    def __init__(
        self,
        instrument: InstrumentOptions,
        psf: PsfOptions,
        vignetting: VignettingOptions,
        sensor: SensorOptions,
        *,
        exposure_s: float,
        seed: int,
    ) -> None:
        self.instrument, self.exposure_s = instrument, exposure_s
        self._psf, self._vignetting = psf, vignetting
        self.sensor = Sensor(sensor, rows=instrument.rows, cols=instrument.cols, seed=seed)
        self.binning, self._window = sensor.binning, sensor.window
        if sensor.binning.rows != sensor.binning.cols:  # the nominal camera has one focal length in pixels
            raise UserError(
                f"sensor.binning: {sensor.binning.rows} x {sensor.binning.cols} is not square; allowed are equal rows and cols"
            )
        self.shape = self.sensor.window_shape
        self.projection = instrument.true_projection().delivered(
            bin_rows=1, bin_cols=1, window_row0=sensor.window.row0, window_col0=sensor.window.col0
        )
        self.corner_px = 0.5 * float(np.hypot(instrument.rows, instrument.cols))
        self.seeing_px, self.seeing_error, self._seed = 0.0, 0.0, seed
        self._psf_field: tuple[float, PsfField] | None = None
        self.zero_point_e_s = instrument.true_zero_point_e_s
        step_px = grid_step_px(vignetting, self.corner_px)
        nodes = self.illumination_at(*node_places(self.shape, step_px)).astype(np.float32)
        self.illumination = IlluminationGrid(nodes, step_px)

    def at(self, seconds: float) -> "Camera":
        """The camera so long after the epoch: its focal length drifts."""
        drift_ppm_s = self.instrument.as_built.focal_drift_ppm_s
        if drift_ppm_s == 0.0:
            return self
        later = copy.copy(self)
        later.projection = replace(self.projection, focal_px=self.projection.focal_px * (1.0 + 1e-6 * drift_ppm_s * seconds))
        return later

    def illumination_at(self, row: Array, col: Array) -> Array:
        """Relative illumination at positions."""
        return relative_illumination(
            self._vignetting,
            row,
            col,
            center_row=self.projection.center_row,
            center_col=self.projection.center_col,
            corner_radius_px=self.corner_px,
            focal_px=self.projection.focal_px,
        )

    @property
    def psf_field(self) -> PsfField | None:
        """The PSF of a wavefront with its halo; None where the PSF is a Gaussian."""
        if self._psf.is_gaussian:
            return None
        if self._psf_field is None or self._psf_field[0] != self.seeing_px:
            self._psf_field = (self.seeing_px, self._make_psf_field())
        return self._psf_field[1]

    def _make_psf_field(self) -> PsfField:
        """Tables over the whole detector; the Gaussian share shrinks by what errors of the wavefront add on average."""
        built, options = self.instrument, self._psf
        rows, cols, window = built.rows, built.cols, self._window
        grid = np.meshgrid(*(np.linspace(0.0, n - 1.0, GRID) for n in (rows, cols)), indexing="ij")
        sigma_px = self._gaussian_at(grid[0] - window.row0, grid[1] - window.col0)
        otf, f_number = None, 1e-3 * built.focal_length_mm / built.aperture_m
        if options.wavefront.rms_nm > 0.0:
            less_px2 = expected_variance_px2(options.wavefront, f_number, built.pixel_um)
            sigma_px = np.sqrt(np.maximum(sigma_px**2 - less_px2, (LEAST_GAUSSIAN * sigma_px) ** 2))
            otf = field_functions(options.wavefront, built.passband, f_number, built.pixel_um, built.obstruction, self._seed)
        halo = make_halo(
            options.aureole,
            options.spider,
            options.ghost,
            wavelength_nm=0.5 * (built.band_short_nm + built.band_long_nm),
            aperture_m=built.aperture_m,
            obstruction=built.obstruction,
            focal_px=built.focal_px,
            sigma_px=float(sigma_px[GRID // 2, GRID // 2]),
            diffracts=otf is not None,
        )

        def place(row: Array, col: Array) -> Array:
            at = [(row + window.row0) / max(rows - 1, 1), (col + window.col0) / max(cols - 1, 1)]
            return np.stack(np.broadcast_arrays(*at)) * (GRID - 1)

        return PsfField(otf, sigma_px, halo, place, built.obstruction)

    def sigma_at(self, row: Array, col: Array) -> Array:
        """PSF sigma of the built camera, seeing included; of equal noise-equivalent area where the PSF is no Gaussian."""
        field = self.psf_field
        return self._gaussian_at(row, col) if field is None else field.sigma_at(row, col)

    def _gaussian_at(self, row: Array, col: Array) -> Array:
        nominal = sigma_at(
            self._psf,
            row,
            col,
            center_row=self.projection.center_row,
            center_col=self.projection.center_col,
            corner_radius_px=self.corner_px,
        )
        return np.asarray(np.hypot(nominal * (1.0 + self.instrument.as_built.psf_width), self.seeing_px))

    def variance_e2(self, image_e: NDArray[np.float32], row0: int, col0: int) -> NDArray[np.float32]:
        """Noise variance of detector pixels whose first is (row0, col0)."""
        return self.sensor.variance_e2(image_e, self.exposure_s, row0=row0, col0=col0)

    @property
    def blurring_aperture_m(self) -> float:
        """Aperture that defocuses near objects; 0 where defocus is switched off."""
        return self.instrument.aperture_m if self._psf.near_field_defocus else 0.0

    def defocus_px(self, range_km: Array) -> Array:
        """Diameter of the blur disc of objects at given ranges; the focus is at infinity."""
        return np.asarray(self.blurring_aperture_m * 1e-3 / range_km * self.projection.focal_px)

    @property
    def axis_sigma_px(self) -> float:
        """PSF sigma on axis."""
        return float(self.sigma_at(np.array([self.projection.center_row]), np.array([self.projection.center_col]))[0])

    @property
    def saturation_e(self) -> float:
        """Signal at which a detector pixel saturates."""
        converter = self.sensor.options.converter
        delivered_e = (self.sensor.delivered.saturation_adu - converter.pedestal_adu) * converter.gain_e_adu
        return min(delivered_e, converter.full_well_e)  # a sum holds more than each of its pixels

    @property
    def surface_rate_e_s(self) -> float:
        """Electrons per pixel and second of a surface brightness of one V = 0 star per square arcsecond."""
        return float(self.zero_point_e_s * (np.degrees(1.0 / self.projection.focal_px) * 3600.0) ** 2)

    @property
    def window_offset_px(self) -> tuple[float, float]:
        """Rows and columns from the middle of the detector to that of the read-out window."""
        return self._window.offset_px_in(self.instrument.rows, self.instrument.cols)

    def direction(self, field_row: float, field_col: float) -> Array:
        """Direction (3,) in the camera frame of a place of the field, -1 to 1 along each axis."""
        row = 0.5 * (self.shape[0] - 1) * (1.0 + field_row)
        col = 0.5 * (self.shape[1] - 1) * (1.0 + field_col)
        return np.asarray(self.projection.to_vectors(np.array([row]), np.array([col]))[0])

    @cached_property
    def radius_rad(self) -> float:
        """Angle from the centre of the field to its farthest corner."""
        centre = self.direction(0.0, 0.0)
        corners = [self.direction(r, c) @ centre for r in (-1.0, 1.0) for c in (-1.0, 1.0)]
        return float(np.arccos(np.clip(min(corners), -1.0, 1.0)))

    def delivered(self, row: Array, col: Array) -> tuple[Array, Array]:
        """Delivered pixels of positions: the centre of a binned pixel is the mean of its pixels' centres."""
        bins = self.binning
        return (row - 0.5 * (bins.rows - 1)) / bins.rows, (col - 0.5 * (bins.cols - 1)) / bins.cols

    def undelivered(self, row: Array, col: Array) -> tuple[Array, Array]:
        """Positions of delivered pixels, the inverse of `delivered`."""
        bins = self.binning
        return bins.rows * row + 0.5 * (bins.rows - 1), bins.cols * col + 0.5 * (bins.cols - 1)

    def binned(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Sums over delivered pixels of a block that starts on their border."""
        bins = self.binning
        if bins.rows * bins.cols == 1:
            return values
        n, m = values.shape[0] // bins.rows, values.shape[1] // bins.cols
        return np.asarray(values[: n * bins.rows, : m * bins.cols].reshape(n, bins.rows, m, bins.cols).sum(axis=(1, 3)))

    def nominal(self) -> NominalCamera:
        """The camera as ground and on-board software believe it to be, in delivered pixels."""
        nominal, bins, delivered = self.instrument, self.binning, self.sensor.delivered
        geometry = nominal.known_projection().delivered(
            bin_rows=bins.rows, bin_cols=bins.cols, window_row0=self._window.row0, window_col0=self._window.col0
        )
        colours = np.linspace(0.2, 1.2, 11)
        factor = nominal.colour_factor(colours)
        return NominalCamera(
            name=nominal.name,
            rows=delivered.rows,
            cols=delivered.cols,
            focal_px=geometry.focal_px,
            center_row=geometry.center_row,
            center_col=geometry.center_col,
            k1=geometry.distortion.k1,
            k2=geometry.distortion.k2,
            p1=geometry.distortion.p1,
            p2=geometry.distortion.p2,
            psf_sigma_px=float(np.hypot(self._psf.sigma_px, self.seeing_px / (1.0 + self.seeing_error))) / bins.cols,
            gain_e_adu=delivered.gain_e_adu,
            read_noise_e=delivered.read_noise_e,
            saturation_adu=delivered.saturation_adu,
            full_well_e=delivered.full_well_e,
            zero_point_e_s=nominal.zero_point_e_s,
            colour_term=float(np.polyfit(colours - SUN_B_V, -2.5 * np.log10(factor), 1)[0]) + nominal.as_built.colour_term,
            aperture_m=nominal.aperture_m,
            obstruction=nominal.obstruction,
        )

    def calibration(self) -> Calibration:
        """Nominal camera, and dark, flat and defects reduced from noisy calibration frames."""
        maps = self.sensor.calibration_maps(self.exposure_s, self.illumination)
        frames = self.sensor.options.calibration
        return Calibration(
            camera=self.nominal(),
            dark_adu=maps.dark_adu,
            flat=maps.flat,
            defects=maps.defects,
            provenance=f"simulated calibration: {frames.dark_frames} dark and {frames.flat_frames} flat frames",
        )
