"""Options of the detector: every effect can be switched off by its own number."""

from dataclasses import dataclass, field
from typing import Final

from sboc_e2e.icd.errors import UserError
from simulator.sensor.structure import StructureOptions

REGISTER_WELLS: Final = 2.0
"""Full wells of a pixel that a cell of a CCD's serial register holds: usual in good ones (Roper Scientific, "Binning")."""
SUMMING_WELLS: Final = 4.0
"""The same of the summing well and the output node behind it: twice the register, from the same source."""


@dataclass(frozen=True, kw_only=True)
class DarkOptions:
    """Dark current, its spread from pixel to pixel, and defective pixels."""

    median_e_s: float = field(
        default=0.1, metadata={"doc": "median dark current at the reference temperature", "min": 0.0, "max": 1e5}
    )
    spread: float = field(default=0.3, metadata={"doc": "sigma of ln(dark current) over pixels (DSNU)", "min": 0.0, "max": 2.0})
    reference_k: float = field(
        default=263.15, metadata={"doc": "temperature of the quoted dark current", "min": 100.0, "max": 400.0}
    )
    activation_ev: float = field(default=0.63, metadata={"doc": "activation energy of the dark current", "min": 0.0, "max": 1.2})
    warm_fraction: float = field(default=2e-4, metadata={"doc": "share of warm pixels", "min": 0.0, "max": 0.5})
    warm_e_s: float = field(default=40.0, metadata={"doc": "median dark current of warm pixels", "min": 0.0, "max": 1e6})
    hot_fraction: float = field(default=5e-5, metadata={"doc": "share of hot pixels", "min": 0.0, "max": 0.5})
    hot_e_s: float = field(default=2000.0, metadata={"doc": "median dark current of hot pixels", "min": 0.0, "max": 1e7})
    hot_growth_per_year: float = field(
        default=0.0,
        metadata={"doc": "share of pixels that displacement damage makes hot in a year of flight", "min": 0.0, "max": 0.1},
    )
    dead_fraction: float = field(
        default=2e-5, metadata={"doc": "share of pixels that do not respond to light", "min": 0.0, "max": 0.5}
    )


@dataclass(frozen=True, kw_only=True)
class TelegraphOptions:
    """Random telegraph signal: pixels that jump between two levels."""

    fraction: float = field(default=5e-5, metadata={"doc": "share of telegraph pixels", "min": 0.0, "max": 0.5})
    amplitude_e: float = field(default=25.0, metadata={"doc": "median jump of one exposure", "min": 0.0, "max": 1e5})
    dwell_frames: int = field(default=8, metadata={"doc": "frames between draws of a pixel's state", "min": 1, "max": 100000})


@dataclass(frozen=True, kw_only=True)
class ReadoutOptions:
    """Noise and structure of the read-out chain."""

    read_noise_e: float = field(
        default=2.3, metadata={"doc": "rms read noise over the sensor, high-gain channel", "min": 0.0, "max": 1000.0}
    )
    read_noise_spread: float = field(
        default=0.15, metadata={"doc": "sigma of ln(read noise) over pixels (CMOS)", "min": 0.0, "max": 1.0}
    )
    low_gain_read_noise_e: float = field(
        default=8.0, metadata={"doc": "read noise of the low-gain channel", "min": 0.0, "max": 1000.0}
    )
    row_noise_e: float = field(default=0.1, metadata={"doc": "offset of each row, new in each frame", "min": 0.0, "max": 100.0})
    column_offset_e: float = field(default=0.3, metadata={"doc": "fixed offset of each column", "min": 0.0, "max": 100.0})
    sense_node_ff: float = field(
        default=1.5,
        metadata={"doc": "capacitance of the sense node in femtofarad, for reset (kTC) noise", "min": 0.0, "max": 1000.0},
    )
    correlated_double_sampling: bool = field(
        default=True, metadata={"doc": "the reset level is measured and subtracted, which removes kTC noise"}
    )


@dataclass(frozen=True, kw_only=True)
class ConverterOptions:
    """Full well, linearity, amplifiers and analogue-to-digital conversion."""

    full_well_e: float = field(
        default=39000.0,
        metadata={"doc": "charge that a pixel holds; a CCD's on-chip sum holds up to 4 of it", "min": 10.0, "max": 1e7},
    )
    nonlinearity: float = field(
        default=0.01,
        metadata={
            "doc": "relative loss of signal at full well, that of the sum for a CCD's on-chip sum; linear in signal",
            "min": 0.0,
            "max": 0.4,
        },
    )
    nonlinearity_error: float = field(
        default=0.0,
        metadata={"doc": "true loss over `nonlinearity`, less 1: what the laboratory's curve misses", "min": -1.0, "max": 5.0},
    )
    bits: int = field(default=12, metadata={"doc": "bits of each converter", "min": 4, "max": 16})
    gain_e_adu: float = field(default=1.2, metadata={"doc": "electrons per unit, high-gain channel", "min": 1e-3, "max": 1e4})
    dual_gain: bool = field(default=True, metadata={"doc": "a second, low-gain channel takes over where the first ends"})
    low_gain_e_adu: float = field(default=10.0, metadata={"doc": "electrons per unit, low-gain channel", "min": 1e-3, "max": 1e4})
    handover: float = field(
        default=0.95,
        metadata={"doc": "share of the high channel's range above which the low one is used", "min": 0.1, "max": 1.0},
    )
    gain_error: float = field(
        default=0.0,
        metadata={"doc": "true gain of the high channel over that of the camera file, less 1", "min": -0.5, "max": 0.5},
    )
    low_gain_error: float = field(
        default=0.0,
        metadata={"doc": "the same of the low channel: a seam where the channels meet", "min": -0.5, "max": 0.5},
    )
    pedestal_adu: int = field(default=100, metadata={"doc": "offset that keeps noise above zero", "min": 0, "max": 10000})

    @property
    def true_gain_e_adu(self) -> float:
        """Electrons per unit of the built high channel."""
        return self.gain_e_adu * (1.0 + self.gain_error)

    @property
    def true_nonlinearity(self) -> float:
        """Relative loss of signal at full well of the built sensor."""
        return self.nonlinearity * (1.0 + self.nonlinearity_error)

    def __post_init__(self) -> None:
        top = 2**self.bits - 1
        if self.pedestal_adu > top // 2:
            raise UserError(
                f"sensor.converter.pedestal: {self.pedestal_adu} ADU; allowed is up to half of {self.bits} bits, {top // 2}"
            )
        if self.dual_gain and self.low_gain_e_adu < self.gain_e_adu:
            raise UserError(f"sensor.converter.low_gain: {self.low_gain_e_adu:g} e-/ADU; allowed is {self.gain_e_adu:g} or more")


@dataclass(frozen=True, kw_only=True)
class BinningOptions:
    """Joining pixels after conversion (on-chip sums of a CCD happen before it).

    Rows of an on-chip sum are joined in the serial register, which holds `REGISTER_WELLS` full wells of a pixel, columns in the
    summing well, which holds `SUMMING_WELLS`. Charge beyond is lost.
    """

    rows: int = field(default=1, metadata={"doc": "detector rows per delivered row", "min": 1, "max": 64})
    cols: int = field(default=1, metadata={"doc": "detector columns per delivered column", "min": 1, "max": 64})
    method: str = field(
        default="mean",
        metadata={
            "doc": "how pixels are joined; a CCD sums charge, of which its register holds 2 full wells, its summing well 4",
            "choices": ("mean", "median", "weighted", "sum"),
        },
    )


@dataclass(frozen=True, kw_only=True)
class WindowOptions:
    """Part of the detector that is read out; 0 rows or columns mean all that follow the first."""

    row0: int = field(default=0, metadata={"doc": "first detector row", "min": 0, "max": 16383})
    col0: int = field(default=0, metadata={"doc": "first detector column", "min": 0, "max": 16383})
    rows: int = field(default=0, metadata={"doc": "detector rows, 0 for all", "min": 0, "max": 16384})
    cols: int = field(default=0, metadata={"doc": "detector columns, 0 for all", "min": 0, "max": 16384})

    def shape_in(self, rows: int, cols: int) -> tuple[int, int]:
        """Rows and columns that are read of a detector of so many. UserError for a window that leaves it."""
        shape = self.rows or rows - self.row0, self.cols or cols - self.col0
        if self.row0 + shape[0] > rows or self.col0 + shape[1] > cols or min(shape) < 1:
            raise UserError(
                f"sensor.window: rows {self.row0} to {self.row0 + shape[0]}, columns {self.col0} to "
                f"{self.col0 + shape[1]} must lie within a detector of {rows} x {cols} pixels"
            )
        return shape

    def offset_px_in(self, rows: int, cols: int) -> tuple[float, float]:
        """Rows and columns from the middle of a detector of so many to that of the window. UserError as `shape_in`."""
        shape = self.shape_in(rows, cols)
        return self.row0 + 0.5 * (shape[0] - rows), self.col0 + 0.5 * (shape[1] - cols)


@dataclass(frozen=True, kw_only=True)
class CalibrationOptions:
    """Calibration frames behind the dark, flat and defect maps that on-board and ground software may know."""

    dark_frames: int = field(default=64, metadata={"doc": "dark frames averaged", "min": 1, "max": 100000})
    flat_frames: int = field(default=64, metadata={"doc": "flat frames averaged", "min": 1, "max": 100000})
    flat_level: float = field(default=0.4, metadata={"doc": "flat level as a share of full well", "min": 0.01, "max": 0.9})
    flat_error: float = field(
        default=0.0,
        metadata={"doc": "rms over the field of the error that an uneven lamp leaves in the flat", "min": 0.0, "max": 0.2},
    )
    flat_change_per_year: float = field(
        default=0.0, metadata={"doc": "rms change of the pixels' response in a year of flight", "min": 0.0, "max": 0.1}
    )
    warmer_k: float = field(
        default=0.0,
        metadata={"doc": "temperature of the dark frames less that of the detector in flight", "min": -100.0, "max": 100.0},
    )
    age_years: float = field(
        default=0.0, metadata={"doc": "years of flight since the calibration frames were taken", "min": 0.0, "max": 50.0}
    )
    hot_sigma: float = field(
        default=6.0,
        metadata={"doc": "a dark signal this many read noises above the median is a defect", "min": 1.0, "max": 1000.0},
    )


@dataclass(frozen=True, kw_only=True)
class CcdOptions:
    """What only a CCD has."""

    row_transfer_us: float = field(
        default=1.0,
        metadata={
            "doc": "time in which the image moves by a row into the store while light falls; 0: a mechanical shutter closes",
            "min": 0.0,
            "max": 1e4,
        },
    )
    transfer_loss: float = field(
        default=0.0, metadata={"doc": "share of the charge left behind in each transfer (CTI)", "min": 0.0, "max": 1e-2}
    )
    transfer_tail_rows: float = field(default=3.0, metadata={"doc": "rows over which traps release it", "min": 0.1, "max": 1e3})


@dataclass(frozen=True, kw_only=True)
class SensorOptions:
    """The detector: its type and imperfections; the number and pitch of its pixels belong to the instrument."""

    type: str = field(
        default="cmos",
        metadata={
            "doc": "cmos has a rolling shutter and clips at full well; ccd exposes all rows at once, smears and bleeds",
            "choices": ("cmos", "ccd"),
        },
    )
    temperature_k: float = field(default=263.15, metadata={"doc": "temperature of the detector", "min": 100.0, "max": 400.0})
    shot_noise: bool = field(default=True, metadata={"doc": "photons and dark electrons come at random"})
    prnu: float = field(default=0.008, metadata={"doc": "rms of the pixel response (PRNU)", "min": 0.0, "max": 0.2})
    dark: DarkOptions = field(default_factory=DarkOptions, metadata={"doc": "dark current and defective pixels"})
    ccd: CcdOptions = field(default_factory=CcdOptions, metadata={"doc": "what only a CCD has"})
    telegraph: TelegraphOptions = field(default_factory=TelegraphOptions, metadata={"doc": "telegraph pixels"})
    readout: ReadoutOptions = field(default_factory=ReadoutOptions, metadata={"doc": "noise of the read-out chain"})
    structure: StructureOptions = field(
        default_factory=StructureOptions, metadata={"doc": "structure that is new in each frame, coupling, blooming"}
    )
    converter: ConverterOptions = field(default_factory=ConverterOptions, metadata={"doc": "full well and conversion"})
    binning: BinningOptions = field(default_factory=BinningOptions, metadata={"doc": "binning"})
    window: WindowOptions = field(default_factory=WindowOptions, metadata={"doc": "read-out window"})
    calibration: CalibrationOptions = field(default_factory=CalibrationOptions, metadata={"doc": "calibration frames"})

    @property
    def on_chip_sum(self) -> bool:
        """Whether charge of several pixels is joined before it is read, as a CCD that sums does."""
        return self.type == "ccd" and self.binning.method == "sum" and self.binning.rows * self.binning.cols > 1

    @property
    def read_well_e(self) -> float:
        """Charge that comes to one read-out at most: full well, or what register and summing well hold of an on-chip sum."""
        if not self.on_chip_sum:
            return self.converter.full_well_e
        in_register = min(float(self.binning.rows), REGISTER_WELLS)
        return self.converter.full_well_e * min(in_register * self.binning.cols, SUMMING_WELLS)
