"""The sensor: mean photo-electrons in, ADU out, and what is known about it without looking at a frame."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sboc_e2e.icd.errors import UserError
from simulator.optics.vignetting import IlluminationGrid, even_illumination
from simulator.radiation.hits import HitList, no_hits
from simulator.randomness import Effect, seed_word
from simulator.sensor import digitise as passes
from simulator.sensor.binning import bin_means, bin_pixels, noise_factor
from simulator.sensor.calibration import CalibrationMaps, reduce_calibration
from simulator.sensor.counter import NORMAL_TABLE
from simulator.sensor.maps import dark_rate_of_class_e_s, draw_fixed_pattern, pixel_model, telegraph_charge_e
from simulator.sensor.options import REGISTER_WELLS, SensorOptions
from simulator.sensor.poisson import poisson_tables
from simulator.sensor.statistics import entropy_table, mean_entropy_bits, pixel_variance
from simulator.sensor.structure import bloom, column_offsets_e, couple, defer_charge, row_offsets_e, spread_charge

BAND_ROWS = 64
"""Rows of pixels that share their signal are made in bands, so that no whole frame of charge is held."""


@dataclass(frozen=True, kw_only=True)
class DeliveredPixels:
    """Numbers of a delivered (windowed, binned) pixel."""

    rows: int
    cols: int
    gain_e_adu: float
    read_noise_e: float
    saturation_adu: float
    full_well_e: float


class Sensor:
    """A detector of (rows, cols) pixels with the fixed pattern of its seed.

    All images of mean electrons are on the detector's grid of the read-out window, unbinned: (window rows, window cols).
    """

    def __init__(self, options: SensorOptions, *, rows: int, cols: int, seed: int) -> None:
        window, binning = options.window, options.binning
        self.options = options
        self.seed = seed
        self.window_rows, self.window_cols = window.shape_in(rows, cols)
        if self.window_rows < binning.rows or self.window_cols < binning.cols:
            raise UserError(f"sensor.binning: {binning.rows} x {binning.cols} exceeds the window {self.window_shape}")
        if self.window_rows % binning.rows or self.window_cols % binning.cols:
            raise UserError(
                f"sensor.binning: {binning.rows} x {binning.cols} pixels do not divide the {self.window_rows} x "
                f"{self.window_cols} that are read out; sensor.window.rows and .cols read a part of the detector"
            )
        pattern = draw_fixed_pattern(options, rows, cols, seed)
        in_rows = slice(window.row0, window.row0 + self.window_rows)
        in_cols = slice(window.col0, window.col0 + self.window_cols)
        self._pattern = pattern
        self._pixels = pixel_model(options, pattern, in_rows, in_cols)
        self._poisson = poisson_tables()
        self._entropy: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None

    @property
    def window_shape(self) -> tuple[int, int]:
        """Detector rows and columns that are read out."""
        return self.window_rows, self.window_cols

    @cached_property
    def read_noise_e(self) -> float:
        """Rms read noise of a detector pixel over the sensor, row noise and (without CDS) reset noise included."""
        counts = np.bincount(self._pixels.noise[::7, ::5].ravel(), minlength=256)
        variance = float((counts * self._pixels.noise_of_e**2).sum() / counts.sum())
        return float(np.sqrt(variance + self.options.readout.row_noise_e**2))

    @property
    def delivered(self) -> DeliveredPixels:
        """Gain, noise and saturation of a delivered pixel; electrons are those of its whole block."""
        converter, binning = self.options.converter, self.options.binning
        n = binning.rows * binning.cols
        averaged = n > 1 and binning.method != "sum"
        top = 2.0**converter.bits - 1.0
        if converter.dual_gain:
            top = (top - converter.pedestal_adu) * converter.low_gain_e_adu / converter.gain_e_adu + converter.pedestal_adu
        well = self.options.read_well_e * (1.0 - converter.nonlinearity)
        readout = self.options.readout
        noise = readout.low_gain_read_noise_e if converter.dual_gain else readout.read_noise_e
        saturation = min(top, (well - 5.0 * noise) / converter.gain_e_adu + converter.pedestal_adu, 65535.0)
        if n > 1 and binning.method == "sum" and not self.options.on_chip_sum:
            saturation = min(saturation * n, 65535.0)
        return DeliveredPixels(
            rows=self.window_rows // binning.rows,
            cols=self.window_cols // binning.cols,
            gain_e_adu=converter.gain_e_adu * (n if averaged else 1),
            read_noise_e=self.read_noise_e * (1.0 if self.options.on_chip_sum else noise_factor(binning)),
            saturation_adu=float(np.floor(saturation)),
            full_well_e=self.options.read_well_e * (1 if self.options.on_chip_sum else n),
        )

    def digitise(
        self, mean_e: NDArray[np.float32], frame: int, exposure_s: float, hits: HitList | None = None, *, first_row: int = 0
    ) -> NDArray[np.uint16]:
        """A delivered frame from mean photo-electrons.

        Parameters
        ----------
        mean_e : (n, window cols) float32, light collected during the exposure; all rows of the window, or a block of them
            that starts at `first_row` (CMOS without binning only): a block gives the same values as the whole.
        frame : number of the frame, which with the seed decides every random number.
        exposure_s : for dark current.
        hits : charge of particle tracks on the same grid as the whole detector.

        Returns
        -------
        (rows, cols) uint16 ADU of delivered pixels.
        """
        n = mean_e.shape[0]
        if mean_e.shape[1] != self.window_cols or first_row + n > self.window_rows:
            raise UserError(f"sensor: image {mean_e.shape} does not fit the window {self.window_shape} at row {first_row}")
        binned = self.options.binning.rows * self.options.binning.cols > 1
        structure = self.options.structure
        whole = binned or self.options.type == "ccd" or structure.coupling > 0.0
        if n != self.window_rows and whole:
            raise UserError("sensor: a CCD or a binned sensor is digitised as a whole, not by blocks of rows")
        mean_e = np.ascontiguousarray(mean_e, dtype=np.float32)
        if self.options.type == "ccd":
            adu = self._read_ccd(mean_e, frame, exposure_s, hits or no_hits())
            return adu if self.options.on_chip_sum else bin_pixels(adu, self.options.binning, self._weight(exposure_s))
        structure = self.options.structure
        part = np.s_[first_row : first_row + n]
        out = np.empty(mean_e.shape, dtype=np.uint16)
        column_e = self._pixels.column_e + column_offsets_e(structure, self.seed, frame, self.window_cols)
        row_e = row_offsets_e(structure, self.seed, frame, self.window_rows)[part]
        if structure.coupling > 0.0:
            self._digitise_coupled(mean_e, frame, exposure_s, hits or no_hits(), column_e, row_e, out)
            return bin_pixels(out, self.options.binning, self._weight(exposure_s))
        passes.digitise_rows(
            mean_e,
            self.options.window.row0 + first_row,
            self._pixels.response[part],
            self._pixels.dark[part],
            self._pixels.noise[part],
            self._pixels.response_of,
            self._pixels.dark_rate_of_e_s * exposure_s,
            self._pixels.noise_of_e,
            column_e,
            self.options.readout.row_noise_e,
            row_e,
            *self._extra_charge(frame, hits or no_hits(), first_row, n),
            self._words(frame),
            self.options.shot_noise,
            *self._poisson,
            NORMAL_TABLE,
            self._chain(),
            out,
        )
        return bin_pixels(out, self.options.binning, self._weight(exposure_s))

    def overflow(self, mean_e: NDArray[np.float32]) -> None:
        """Let charge repel charge, and what a blooming CMOS detector cannot hold flow, in place; before `digitise`."""
        structure, full_well_e = self.options.structure, self.options.converter.full_well_e
        if structure.brighter_fatter > 0.0:
            spread_charge(mean_e, full_well_e, structure.brighter_fatter)
        if self.options.type == "cmos" and self.options.structure.blooming > 0.0:
            bloom(mean_e, self.options.converter.full_well_e, self.options.structure.blooming)

    def variance_e2(self, mean_e: ArrayLike, exposure_s: float, *, row0: int = 0, col0: int = 0) -> NDArray[np.float32]:
        """Noise variance of detector pixels in electrons squared: photons, dark current, read noise, quantisation.

        A CCD's on-chip sum is read once: each of its pixels has an equal share of that read-out's variance, so that the sum over
        a delivered pixel is the variance of the delivered pixel.

        mean_e : a scalar (then the median pixel is meant) or an image whose first pixel is (row0, col0) of the window; then
            each pixel's own response, dark current and read noise count.
        """
        converter, binning = self.options.converter, self.options.binning
        shot = 1.0 if self.options.shot_noise else 0.0
        share = 1.0 / (binning.rows * binning.cols) if self.options.on_chip_sum else 1.0
        fixed = (self.options.readout.row_noise_e**2 + converter.gain_e_adu**2 / 12.0) * share
        mean = np.asarray(mean_e, dtype=np.float32)
        if mean.ndim == 0:
            dark = self._pixels.median_dark_e_s * exposure_s
            return np.asarray(shot * (mean + dark) + self._pixels.median_noise_e**2 * share + fixed, dtype=np.float32)
        part = np.s_[row0 : row0 + mean.shape[0], col0 : col0 + mean.shape[1]]
        out = np.empty(mean.shape, dtype=np.float32)
        pixel_variance(
            mean,
            self._pixels.response[part],
            self._pixels.dark[part],
            self._pixels.noise[part],
            shot * self._pixels.response_of,
            shot * self._pixels.dark_rate_of_e_s * exposure_s + fixed,
            self._pixels.noise_of_e**2 * share,
            out,
        )
        return out

    def entropy_bits(self, mean_e: NDArray[np.float32], exposure_s: float, *, every: int = 1) -> float:
        """Mean entropy of a delivered pixel's ADU given the mean light: what no lossless code can undercut.

        mean_e : (rows, cols) of detector pixels from the window's first on. every : rows of delivered pixels of which one counts.

        Exact for Poisson electrons plus the pixel's read noise rounded to the high-gain unit, averaged over the sensor's
        read noises and interpolated in the mean; above 400 e- the entropy of a rounded Gaussian, above the handover in the
        low-gain unit. A binned pixel has the electrons of its block, one read noise where a CCD sums on the chip, else those of
        all its pixels with their roundings, taken as Gaussian. That holds where its noise is above half a unit.
        """
        options, converter, readout = self.options, self.options.converter, self.options.readout
        n, delivered = options.binning.rows * options.binning.cols, self.delivered
        joined = n > 1 and not self.options.on_chip_sum
        scale = delivered.gain_e_adu / converter.gain_e_adu
        mean_e = bin_means(mean_e, options.binning)[::every] * np.float32(n)

        def whole(read_noise_e: float, gain_e_adu: float) -> float:
            return (
                float(noise_factor(options.binning) * np.hypot(read_noise_e, gain_e_adu / 12.0**0.5)) if joined else read_noise_e
            )

        if self._entropy is None:
            codes = np.sort(self._pixels.noise[::31, ::17].ravel())
            quantiles = codes[((np.arange(9) + 0.5) / 9 * codes.size).astype(int)]
            noises = tuple(whole(noise, converter.gain_e_adu) for noise in self._pixels.noise_of_e[quantiles].tolist())
            self._entropy = entropy_table(noises, delivered.gain_e_adu)
        pixels = n if joined else 1
        top = converter.gain_e_adu * (2.0**converter.bits - 1.0)
        return mean_entropy_bits(
            mean_e,
            self._pixels.median_dark_e_s * exposure_s * n,
            *self._entropy,
            (
                delivered.gain_e_adu,
                whole(self._pixels.median_noise_e, converter.gain_e_adu),
                pixels * converter.handover * top if converter.dual_gain else np.inf,
            ),
            (
                converter.low_gain_e_adu * scale,
                whole(readout.low_gain_read_noise_e, converter.low_gain_e_adu),
                pixels * min(options.read_well_e, np.inf if converter.dual_gain else top),
            ),
        )

    def calibration_maps(self, exposure_s: float, illumination: IlluminationGrid | None = None) -> CalibrationMaps:
        """Dark, flat and defect maps of delivered pixels, reduced from calibration frames with their own noise.

        illumination : of the flat field over the window, 1 on axis; None for uniform.
        """
        pattern, window = self._pattern, self.options.window
        # The dark frames (the last 256 of them) are taken before frame 0, with telegraph pixels in the states they then have.
        states = range(-min(self.options.calibration.dark_frames, 256), 0)
        jump_e = np.mean([telegraph_charge_e(pattern, self.options, self.seed, frame) for frame in states], axis=0)
        row, col = pattern.telegraph_row.astype(np.int64) - window.row0, pattern.telegraph_col.astype(np.int64) - window.col0
        inside = (row >= 0) & (row < self.window_rows) & (col >= 0) & (col < self.window_cols)
        jumps = (row[inside], col[inside], jump_e[inside].astype(np.float32))
        warmer = replace(self.options, temperature_k=self.options.temperature_k + self.options.calibration.warmer_k)
        pixels = replace(self._pixels, dark=self._dark_before(), dark_rate_of_e_s=dark_rate_of_class_e_s(warmer))
        return reduce_calibration(
            self.options, pixels, exposure_s, illumination or even_illumination(self.window_shape), jumps, self.seed
        )

    def _dark_before(self) -> NDArray[np.uint8]:
        """Classes of dark current when the calibration frames were taken: without the pixels that have become hot since."""
        pattern, window = self._pattern, self.options.window
        row, col = pattern.aged_row - window.row0, pattern.aged_col - window.col0
        inside = (row >= 0) & (row < self.window_rows) & (col >= 0) & (col < self.window_cols)
        if not inside.any():
            return self._pixels.dark
        before = self._pixels.dark.copy()
        before[row[inside], col[inside]] = pattern.aged_class[inside]
        return before

    def _words(self, frame: int) -> tuple[np.uint64, np.uint64, np.uint64]:
        return (
            np.uint64(seed_word(self.seed, Effect.SHOT_AND_READ, frame, 0)),
            np.uint64(seed_word(self.seed, Effect.SHOT_AND_READ, frame, 1)),
            np.uint64(seed_word(self.seed, Effect.ROW_COLUMN_NOISE, frame)),
        )

    def _chain(self) -> tuple[float, float, float, float, float, float, bool, float, float, float, float]:
        converter = self.options.converter
        top = 2.0**converter.bits - 1.0
        return (
            self.options.read_well_e,
            converter.true_nonlinearity / self.options.read_well_e,
            converter.true_gain_e_adu,
            top,
            converter.handover * top,
            float(converter.pedestal_adu),
            converter.dual_gain,
            converter.low_gain_e_adu * (1.0 + converter.low_gain_error),
            self.options.readout.low_gain_read_noise_e,
            converter.gain_e_adu,
            converter.low_gain_e_adu,
        )

    def _extra_charge(
        self, frame: int, hits: HitList, first_row: int, n: int
    ) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float32]]:
        """Telegraph jumps and particle charge of rows ``first_row ... first_row + n - 1`` of the window, by row."""
        pattern, window = self._pattern, self.options.window
        jump = telegraph_charge_e(pattern, self.options, self.seed, frame)
        row = np.concatenate([pattern.telegraph_row, hits.row]) - window.row0 - first_row
        col = np.concatenate([pattern.telegraph_col, hits.col]) - window.col0
        charge = np.concatenate([jump, hits.charge_e])
        inside = (row >= 0) & (row < n) & (col >= 0) & (col < self.window_cols) & (charge > 0.0)
        row, col, charge = row[inside], col[inside], charge[inside]
        order = np.argsort(row, kind="stable")
        start = np.searchsorted(row[order], np.arange(n + 1)).astype(np.int64)
        return start, col[order].astype(np.int32), charge[order].astype(np.float32)

    def _read_ccd(self, mean_e: NDArray[np.float32], frame: int, exposure_s: float, hits: HitList) -> NDArray[np.uint16]:
        """Charge of the whole chip, bleeding along columns, on-chip sums, conversion."""
        words = self._words(frame)
        charge = np.empty(mean_e.shape, dtype=np.float64)
        passes.collect_rows(
            mean_e,
            self.options.window.row0,
            self._pixels.response,
            self._pixels.dark,
            self._pixels.response_of,
            self._pixels.dark_rate_of_e_s * exposure_s,
            *self._extra_charge(frame, hits, 0, mean_e.shape[0]),
            words[0],
            self.options.shot_noise,
            *self._poisson,
            NORMAL_TABLE,
            charge,
        )
        passes.bleed_columns(charge, self.options.converter.full_well_e)
        if self.options.ccd.transfer_loss > 0.0:
            defer_charge(charge, self.options.ccd.transfer_loss, self.options.ccd.transfer_tail_rows)
        structure = self.options.structure
        noise = self._pixels.noise
        column = self._pixels.column_e + column_offsets_e(structure, self.seed, frame, self.window_cols)
        row = row_offsets_e(structure, self.seed, frame, self.window_rows)
        if self.options.on_chip_sum:
            binning = self.options.binning
            rows, cols = self.window_rows // binning.rows, self.window_cols // binning.cols
            register = _blocks_of(charge, rows, cols, binning.rows, binning.cols).sum(axis=1)
            np.minimum(register, REGISTER_WELLS * self.options.converter.full_well_e, out=register)
            charge = np.ascontiguousarray(register.sum(axis=2))
            noise, column, row = noise[:rows, :cols], column[:cols], row[:rows]
        out = np.empty(charge.shape, dtype=np.uint16)
        passes.convert_rows(
            charge,
            self.options.window.row0,
            noise,
            self._pixels.noise_of_e,
            column,
            self.options.readout.row_noise_e,
            row,
            words,
            NORMAL_TABLE,
            self._chain(),
            out,
        )
        return out

    def _digitise_coupled(
        self,
        mean_e: NDArray[np.float32],
        frame: int,
        exposure_s: float,
        hits: HitList,
        column_e: NDArray[np.float64],
        row_e: NDArray[np.float64],
        out: NDArray[np.uint16],
    ) -> None:
        """A CMOS frame whose pixels share their signal: bands of rows, with a neighbour on either side, one after the other."""
        words, rows = self._words(frame), self.window_rows
        extra_start, extra_col, extra_e = self._extra_charge(frame, hits, 0, rows)
        for first in range(0, rows, BAND_ROWS):
            stop = min(first + BAND_ROWS, rows)
            low, high = max(first - 1, 0), min(stop + 1, rows)
            band, inner = np.s_[low:high], np.s_[first:stop]
            charge = np.empty((high - low, self.window_cols))
            signal = np.empty_like(charge)
            passes.collect_rows(
                mean_e[band],
                self.options.window.row0 + low,
                self._pixels.response[band],
                self._pixels.dark[band],
                self._pixels.response_of,
                self._pixels.dark_rate_of_e_s * exposure_s,
                extra_start[low : high + 1],
                extra_col,
                extra_e,
                words[0],
                self.options.shot_noise,
                *self._poisson,
                NORMAL_TABLE,
                charge,
            )
            np.minimum(charge, self.options.converter.full_well_e, out=charge)
            couple(charge, self.options.structure.coupling, signal)
            passes.convert_rows(
                signal[first - low : stop - low],
                self.options.window.row0 + first,
                self._pixels.noise[inner],
                self._pixels.noise_of_e,
                column_e,
                self.options.readout.row_noise_e,
                row_e[inner],
                words,
                NORMAL_TABLE,
                self._chain(),
                out[inner],
            )

    def _weight(self, exposure_s: float) -> NDArray[np.float32] | None:
        """Inverse noise variance in the dark; dead pixels weigh nothing. Only where binning asks for it."""
        if self.options.binning.method != "weighted":
            return None
        variance = np.take((self._pixels.noise_of_e**2).astype(np.float32), self._pixels.noise)
        variance += np.take((self._pixels.dark_rate_of_e_s * exposure_s).astype(np.float32), self._pixels.dark)
        return np.asarray((self._pixels.response > 0) / np.maximum(variance, 1e-6), dtype=np.float32)


def _blocks_of(charge_e: NDArray[np.float64], rows: int, cols: int, height: int, width: int) -> NDArray[np.float64]:
    """View of (rows, height, cols, width) blocks of pixels."""
    return charge_e[: rows * height, : cols * width].reshape(rows, height, cols, width)
