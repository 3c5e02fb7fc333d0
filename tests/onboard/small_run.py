"""A small on-board chain with a detector that reports what it is told, for tests of everything around detection."""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from onboard.chain import OnboardChain, OnboardResult, OnboardState, OnboardSteps
from onboard.downlink.codec import PlanesCodec
from onboard.image.background import MeshBackground
from onboard.options import DownlinkOptions, OnboardOptions, RoiOptions
from onboard.stars.matched import MatchedStars
from sboc_e2e.icd.frame import AttitudeEstimate, Calibration, Frame, FrameHeader, NominalCamera, ObserverState
from sboc_e2e.icd.signals import Detection, DetectorView
from sboc_e2e.icd.steps import Encoder
from tests.onboard.star_fields import GAIN_E_ADU, PEDESTAL_ADU, READ_NOISE_E, star_grid

SIDE = 256
START_TAI_NS = 2_179_872_037_123_456_789
PERIOD_NS = 250_000_000
RUN_ID = 0xC0FFEE


@dataclass(frozen=True, kw_only=True)
class PlantedDetector:
    """Reports given detections, whatever it sees."""

    detections: tuple[Detection, ...] = ()
    history_frames: int = 0

    def detect(self, view: DetectorView) -> tuple[Detection, ...]:
        """The planted ones."""
        return self.detections


STREAK = Detection(row0=40.0, col0=30.0, row1=160.0, col1=200.0, snr=20.0)


def camera(side: int = SIDE) -> NominalCamera:
    """A camera like the preset's, of any size."""
    return NominalCamera(
        name="test",
        rows=side,
        cols=side,
        focal_px=44444.0,
        center_row=(side - 1) / 2,
        center_col=(side - 1) / 2,
        psf_sigma_px=0.849,
        gain_e_adu=GAIN_E_ADU,
        read_noise_e=READ_NOISE_E,
        saturation_adu=32241.0,
        full_well_e=39000.0,
        zero_point_e_s=4.7e8,
        aperture_m=0.2,
    )


def calibration(side: int = SIDE, dark_adu: float | NDArray[np.float64] = PEDESTAL_ADU) -> Calibration:
    """A dark, the same everywhere or a map, a flat of one, no defects."""
    shape = (side, side)
    return Calibration(
        camera=camera(side),
        dark_adu=np.full(shape, dark_adu, dtype=np.float32),
        flat=np.ones(shape, dtype=np.float32),
        defects=np.zeros(shape, dtype=np.uint8),
    )


def header(number: int, side: int = SIDE, *, telemetry: bool = True) -> FrameHeader:
    """Header of frame `number` of a run at four frames per second."""
    start = START_TAI_NS + number * PERIOD_NS
    attitude = AttitudeEstimate(
        quaternion=np.array([0.1, 0.2, 0.3, np.sqrt(0.86)]),
        rate_rad_s=np.array([1e-6, -2e-6, 3e-5]) * (number + 1),
        covariance_rad2=np.array([[4e-9, 1e-10, 2e-10], [1e-10, 5e-9, 3e-10], [2e-10, 3e-10, 9e-9]]),
    )
    observer = ObserverState(
        tai_ns=start + 100_000_000,
        position_m=np.array([4.7e6, 2.8e6, 4.5e6]) + number,
        velocity_m_s=np.array([-3292.5, -3611.5, 5682.6]),
        sigma_position_m=10.0,
        sigma_velocity_m_s=0.05,
    )
    return FrameHeader(
        frame=number,
        t_start_tai_ns=start,
        exposure_ns=200_000_000,
        line_time_ns=10_000,
        rows=side,
        cols=side,
        gain_e_adu=GAIN_E_ADU,
        read_noise_e=READ_NOISE_E,
        saturation_adu=32241.0,
        attitude=attitude if telemetry else None,
        observer=observer if telemetry else None,
        temperature_k=263.15,
    )


def sky(seed: int, side: int = SIDE) -> NDArray[np.uint16]:
    """A frame with a few dozen stars."""
    rng = np.random.default_rng(seed)
    return star_grid(rng, side=side, pitch=32, flux_e=(200.0, 20000.0), sigma_px=0.849).exposed(rng)


@dataclass(kw_only=True)
class Run:
    """A chain with its state, fed frame by frame."""

    chain: OnboardChain
    state: OnboardState
    results: list[OnboardResult] = field(default_factory=list)

    def feed(self, frame: Frame) -> OnboardResult:
        """Process one frame."""
        self.state, result = self.chain.process(self.state, frame)
        self.results.append(result)
        return result

    @property
    def downlink(self) -> bytes:
        """All packets so far."""
        return b"".join(result.packets for result in self.results)


def start_run(
    *,
    detections: tuple[Detection, ...] = (STREAK,),
    codec: Encoder | None = None,
    side: int = SIDE,
    with_calibration: bool = True,
    downlink: DownlinkOptions | None = None,
    roi: RoiOptions | None = None,
    steps: OnboardSteps | None = None,
    run_id: int = RUN_ID,
    dark_adu: float | NDArray[np.float64] = PEDESTAL_ADU,
) -> Run:
    """A chain before its first frame."""
    chain = OnboardChain(
        OnboardOptions(downlink=downlink or DownlinkOptions(), roi=roi or RoiOptions()),
        steps
        or OnboardSteps(
            background=MeshBackground(),
            star_extractor=MatchedStars(),
            detector=PlantedDetector(detections=detections),
            codec=codec or PlanesCodec(),
        ),
        calibration=calibration(side, dark_adu) if with_calibration else None,
        camera=camera(side),
        run_id=run_id,
    )
    return Run(chain=chain, state=chain.initial_state())


def frame(number: int, *, side: int = SIDE, telemetry: bool = True, pixels: NDArray[np.uint16] | None = None) -> Frame:
    """Frame `number`, with its own noise unless pixels are given."""
    return Frame(header=header(number, side, telemetry=telemetry), pixels=sky(number, side) if pixels is None else pixels)


def short_run(n_frames: int = 3, *, run_id: int = RUN_ID, whole_frame_every: int = 0) -> Run:
    """A run of a few frames with one streak moving through them."""
    run = start_run(run_id=run_id, downlink=DownlinkOptions(whole_frame_every=whole_frame_every))
    for number in range(n_frames):
        moved = replace(STREAK, row0=STREAK.row0 + 5.0 * number, row1=STREAK.row1 + 5.0 * number)
        step = OnboardSteps(
            background=MeshBackground(),
            star_extractor=MatchedStars(),
            detector=PlantedDetector(detections=(moved,)),
            codec=PlanesCodec(),
        )
        run.chain = OnboardChain(
            OnboardOptions(downlink=DownlinkOptions(whole_frame_every=whole_frame_every)),
            step,
            calibration=calibration(),
            camera=camera(),
            run_id=run_id,
        )
        run.feed(frame(number))
    return run
