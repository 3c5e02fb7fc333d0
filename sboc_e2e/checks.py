"""The exam of a plug-in (`sboc check MODULE:CLASS`): what every step must survive, and a verdict for each question."""

import copy
import dataclasses
import inspect
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from multiprocessing.reduction import ForkingPickler
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.files import checkpoint
from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.errors import ContractError, UserError
from sboc_e2e.icd.flags import FrameFlag, MaskBit
from sboc_e2e.icd.frame import AttitudeEstimate, Calibration, FrameHeader, NominalCamera, ObserverState
from sboc_e2e.icd.layout import CodecNumber
from sboc_e2e.icd.products import FrameSolution
from sboc_e2e.icd.results import check_background, check_detections, check_stars
from sboc_e2e.icd.signals import BackgroundModel, DetectorView, StarList
from sboc_e2e.icd.steps import Decoder, Encoder
from sboc_e2e.registry import SEAMS, Registry, Seam
from sboc_e2e.scenario import option_models

SHAPE: Final = (256, 320)
SLOW_S: Final = 5.0
EXAMINED: Final = (
    "onboard.background", "onboard.star_extractor", "onboard.detector", "onboard.codec", "ground.decoder",
    "ground.astrometry",
)  # fmt: skip
"""Seams whose steps are tried on synthetic input; steps of the others are examined without being run."""


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """The answer to one question."""

    question: str
    passed: bool
    detail: str


def examine(path: str, registry: Registry, seam: str | None = None) -> tuple[Seam, list[Verdict]]:
    """Examine the class ``module:Class``; its seam is found by its methods unless it is named.

    Raises `UserError` when the class cannot be loaded, fits no seam or cannot be made with its default options.
    """
    found = registry.load_class(path)
    place = _seam_of(found, path, seam)
    registry.resolve(place.name, path, typed=True)
    try:
        step = found()
    except Exception as error:
        raise UserError(f"{path}: cannot be made with default options: {type(error).__name__}: {error}") from error
    return place, list(_questions(place, step))


def _seam_of(found: type, path: str, wanted: str | None) -> Seam:
    """The seam that a class fits."""
    if wanted is not None:
        if wanted not in SEAMS:
            raise UserError(f'--seam: unknown seam "{wanted[:60]}"; known: {", ".join(SEAMS)}')
        return SEAMS[wanted]
    fitting = [seam for seam in SEAMS.values() if all(_same_arguments(found, seam.protocol, name) for name in seam.methods)]
    if len(fitting) != 1:
        known = "; ".join(f"{seam.name}: {', '.join(seam.methods)}" for seam in SEAMS.values())
        raise UserError(f"{path}: its methods fit {len(fitting)} seams; name one with --seam. Methods by seam: {known}")
    return fitting[0]


def _same_arguments(found: type, protocol: type, method: str) -> bool:
    """Whether a class has a method with as many arguments as the Protocol asks for."""
    own = getattr(found, method, None)
    wanted = inspect.signature(getattr(protocol, method)).parameters
    return callable(own) and len(inspect.signature(own).parameters) == len(wanted)


def _questions(seam: Seam, step: Any) -> Iterator[Verdict]:
    yield _asked("matches the Protocol", lambda: _expect(isinstance(step, seam.protocol), f"not a {seam.protocol.__name__}"))
    yield _asked("can travel to another process", lambda: ForkingPickler.dumps(step) and None)
    yield _asked("options can be written in a scenario", lambda: _options_round_trip(step))
    if seam.name == "onboard.detector":
        yield from _detector_questions(step)
    elif seam.name == "onboard.star_extractor":
        yield from _extractor_questions(step)
    elif seam.name == "onboard.background":
        yield from _background_questions(step)
    elif seam.name in ("onboard.codec", "ground.decoder"):
        yield from _codec_questions(step)
    elif seam.name == "ground.astrometry":
        yield from _astrometry_questions(step)


def _asked(question: str, trial: Callable[[], object]) -> Verdict:
    """A verdict: passed unless the trial raises."""
    try:
        trial()
    except Exception as error:  # noqa: BLE001 - a plug-in may raise anything; that is what is being examined
        text = str(error).splitlines()[0] if str(error) else "no reason given"
        kind = "" if isinstance(error, Failed | ContractError) else f"{type(error).__name__}: "
        return Verdict(question=question, passed=False, detail=f"{kind}{text}"[:200])
    return Verdict(question=question, passed=True, detail="")


class Failed(Exception):
    """A trial's finding."""


def _expect(condition: bool, otherwise: str) -> None:
    if not condition:
        raise Failed(otherwise)


def _options_round_trip(step: Any) -> None:
    kind: Any = type(step)
    model = option_models.validate(option_models.model_of(kind), option_models.to_document(step), kind.__name__)
    _expect(option_models.build(kind, model, "options") == step, "options change when written and read back")


# -- detectors and star extractors --------------------------------------------------------------------------------------


def synthetic_view(kind: str, history_frames: int = 0) -> DetectorView:
    """A view of noise with ten stars and a streak; or empty, saturated, fully masked, or without any signal."""
    rng = np.random.default_rng(11)
    residual = rng.normal(0.0, 2.4, SHAPE).astype(np.float32)
    mask = np.zeros(SHAPE, dtype=np.uint8)
    rows, cols = np.mgrid[: SHAPE[0], : SHAPE[1]]
    if kind == "streak":
        for row, col in rng.uniform(20, 230, (10, 2)):
            residual += 800 * np.exp(-0.5 * ((rows - row) ** 2 + (cols - col) ** 2) / 0.85**2)
        for share in np.linspace(0, 1, 400):
            row, col = 60 + 90 * share, 50 + 200 * share
            window = np.s_[int(row) - 5 : int(row) + 7, int(col) - 5 : int(col) + 7]
            residual[window] += 8 * np.exp(-0.5 * ((rows[window] - row) ** 2 + (cols[window] - col) ** 2) / 0.85**2)
    elif kind == "zero":
        residual[:] = 0.0
    elif kind == "saturated":
        residual[:] = 65535.0
        mask[:] = MaskBit.SATURATED
    elif kind == "masked":
        residual[:] = 0.0
        mask[:] = MaskBit.MISSING
    elif kind == "not a number":
        residual[40:60, 40:60] = np.nan
        mask[40:60, 40:60] = MaskBit.MISSING
    mesh = np.full((4, 5), 10.0, dtype=np.float32)
    header = FrameHeader(
        frame=7, t_start_tai_ns=2_179_000_000 * 10**9, exposure_ns=200_000_000, line_time_ns=10_000, rows=SHAPE[0], cols=SHAPE[1],
        gain_e_adu=1.2, read_noise_e=2.3, saturation_adu=65535.0,
    )  # fmt: skip
    view = DetectorView(
        header=header,
        residual_adu=residual,
        background=BackgroundModel(tile_px=64, level_adu=mesh, sigma_adu=np.full_like(mesh, 2.4)),
        mask=mask,
        stars=StarList.empty(),
        psf_sigma_px=0.85,
    )
    if history_frames == 0:
        return view
    earlier = [dataclasses.replace(view, header=dataclasses.replace(header, frame=7 - k)) for k in range(history_frames, 0, -1)]
    return dataclasses.replace(view, history=tuple(earlier))


VIEWS: Final = ("noise", "streak", "zero", "saturated", "masked", "not a number")


def _detector_questions(step: Any) -> Iterator[Verdict]:
    yield from _view_questions(step.detect, lambda: int(step.history_frames), _detections_are_sound)


def _extractor_questions(step: Any) -> Iterator[Verdict]:
    yield from _view_questions(step.extract, lambda: 0, _stars_are_sound)


def _view_questions(
    method: Callable[[DetectorView], Any], history: Callable[[], int], sound: Callable[[Any], None]
) -> Iterator[Verdict]:
    for kind in VIEWS:

        def survived(kind: str = kind) -> None:
            sound(method(synthetic_view(kind, history())))

        yield _asked(f"survives a frame: {kind}", survived)
    yield _asked("survives without history", lambda: sound(method(synthetic_view("streak"))))
    yield _asked("leaves its input untouched", lambda: _input_untouched(method, synthetic_view("streak", history())))
    yield _asked("gives the same twice", lambda: _same_twice(method, synthetic_view("streak", history())))
    yield _asked(f"takes less than {SLOW_S:g} s for 256 x 320 pixels", lambda: _fast(method, synthetic_view("streak", history())))


def _detections_are_sound(found: Any) -> None:
    _expect(isinstance(found, tuple), f"returned a {type(found).__name__}, expected a tuple")
    check_detections(found, SHAPE)
    order = [detection.snr for detection in found]
    _expect(order == sorted(order, reverse=True), "detections are not ordered by falling S/N")


def _stars_are_sound(found: Any) -> None:
    check_stars(found, SHAPE)
    inside = (found.row >= -1) & (found.row <= SHAPE[0]) & (found.col >= -1) & (found.col <= SHAPE[1])
    _expect(bool(inside.all()), "a star lies outside the frame")


def _input_untouched(method: Callable[[DetectorView], Any], view: DetectorView) -> None:
    # The contract's read-only flag protects views; a plug-in may still write through the array's base.
    before = copy.deepcopy((view.residual_adu, view.mask))
    method(view)
    same = np.array_equal(before[0], view.residual_adu, equal_nan=True) and np.array_equal(before[1], view.mask)
    _expect(same, "changed the arrays that it was given")


def _same_twice(method: Callable[[DetectorView], Any], view: DetectorView) -> None:
    _expect(checkpoint.to_bytes(method(view)) == checkpoint.to_bytes(method(view)), "two calls gave different results")


def _fast(method: Callable[[DetectorView], Any], view: DetectorView) -> None:
    method(view)
    start = time.process_time()
    method(view)
    taken_s = time.process_time() - start
    _expect(taken_s < SLOW_S, f"took {taken_s:.1f} s")


# -- background and codecs ----------------------------------------------------------------------------------------------


def _background_questions(step: Any) -> Iterator[Verdict]:
    rng = np.random.default_rng(5)
    level = (110 + rng.normal(0, 2.4, SHAPE)).astype(np.uint16)
    dark, free = np.full(SHAPE, 100, dtype=np.int16), np.zeros(SHAPE, dtype=np.uint8)

    def sound(pixels: NDArray[Any], mask: NDArray[np.uint8], near: float | None) -> None:
        model = step.estimate(pixels, dark, mask)
        check_background(model, SHAPE)
        if near is not None:
            _expect(
                abs(float(np.median(model.level_adu)) - near) < 1.0, f"level {np.median(model.level_adu):.1f}, expected {near}"
            )

    yield _asked("finds the level of a plain sky", lambda: sound(level, free, 9.5))
    yield _asked("survives a frame: saturated", lambda: sound(np.full(SHAPE, 65535, np.uint16), free, None))
    yield _asked("survives a frame: masked", lambda: sound(level, np.full(SHAPE, MaskBit.MISSING, np.uint8), None))


def _codec_questions(step: Any) -> Iterator[Verdict]:
    def numbered() -> None:
        shipped = {int(number) for number in CodecNumber}
        number = int(step.number)
        own = type(step).__module__.startswith(("onboard.", "ground."))
        _expect(number in shipped if own else 128 <= number <= 255, f"codec number {number}; plug-ins use 128 to 255")

    yield _asked("has a codec number of its own", numbered)
    if isinstance(step, Encoder):
        rng = np.random.default_rng(3)
        for name, values in (
            ("noise", rng.normal(100, 2.4, (40, 13)).astype(np.int32)),
            ("one pixel", np.array([[7]], np.int32)),
            ("extremes", np.array([[-65535, 65535], [0, 65535]], np.int32)),
        ):

            def encoded(values: NDArray[np.int32] = values) -> None:
                block = step.encode(values, level_adu=100, sigma_adu=2.4)
                _expect(isinstance(block, bytes), f"returned a {type(block).__name__}, expected bytes")

            yield _asked(f"encodes {name}", encoded)
    if isinstance(step, Decoder):
        for name, block in (("nothing", b""), ("noise", bytes(range(256)) * 3)):

            def refused(block: bytes = block) -> None:
                try:
                    values = step.decode(block, (40, 13), level_adu=100, sigma_adu=2.4)
                except UserError:
                    return
                _expect(np.shape(values) == (40, 13), f"returned shape {np.shape(values)}, expected (40, 13)")

            yield _asked(f"decodes or refuses {name}", refused)


# -- astrometry ---------------------------------------------------------------------------------------------------------

FOCAL_PX: Final = 5000.0
ROUND_TRIP_PX: Final = 1e-3


def star_frame(catalogue: StarCatalogue) -> tuple[Calibration, DownlinkFrame]:
    """Catalogue stars through a camera without distortion; aberration, which moves all of them alike, is left out."""
    camera = NominalCamera(
        name="exam", rows=SHAPE[0], cols=SHAPE[1], focal_px=FOCAL_PX, center_row=0.5 * (SHAPE[0] - 1),
        center_col=0.5 * (SHAPE[1] - 1), psf_sigma_px=0.85, gain_e_adu=1.0, read_noise_e=2.3, saturation_adu=65535.0,
        full_well_e=39e3, zero_point_e_s=4.7e8, aperture_m=0.2,
    )  # fmt: skip
    calibration = Calibration(
        camera=camera, dark_adu=np.zeros(SHAPE, np.float32), flat=np.ones(SHAPE, np.float32), defects=np.zeros(SHAPE, np.uint8)
    )
    stars = catalogue.cone(270.0, 0.0, 4.0, epoch_jyear=2027.0)
    # camera axes: boresight at right ascension 270 deg on the equator, columns to the east, rows to the north
    axes = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    ra, dec = np.radians(stars.ra_deg), np.radians(stars.dec_deg)
    seen = np.stack((np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)), axis=-1) @ axes.T
    row, col = camera.center_row + FOCAL_PX * seen[:, 1] / seen[:, 2], camera.center_col + FOCAL_PX * seen[:, 0] / seen[:, 2]
    inside = np.flatnonzero((row > 1.0) & (row < SHAPE[0] - 2.0) & (col > 1.0) & (col < SHAPE[1] - 2.0))
    inside = inside[np.argsort(stars.v_mag[inside], kind="stable")]
    flux = 4.7e8 * 0.2 * 10.0 ** (-0.4 * stars.v_mag[inside].astype(np.float64))
    epoch_ns = 2_179_000_000 * 10**9
    header = FrameHeader(
        frame=7, t_start_tai_ns=epoch_ns, exposure_ns=200_000_000, line_time_ns=0, rows=SHAPE[0], cols=SHAPE[1],
        gain_e_adu=1.0, read_noise_e=2.3,
        attitude=AttitudeEstimate(
            quaternion=np.array([-np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]), rate_rad_s=np.zeros(3), covariance_rad2=np.eye(3) * 1e-7
        ),
        observer=ObserverState(
            tai_ns=epoch_ns, position_m=np.array([7.0e6, 0.0, 0.0]), velocity_m_s=np.zeros(3), sigma_position_m=10.0,
            sigma_velocity_m_s=0.1,
        ),
    )  # fmt: skip
    listed = StarList(
        row=row[inside],
        col=col[inside],
        flux_e=flux.astype(np.float32),
        snr=np.sqrt(flux).astype(np.float32),
        flags=np.zeros(len(inside), dtype=np.uint8),
    )
    frame = DownlinkFrame(
        header=header, flags=FrameFlag(0), housekeeping=None, stars=listed, rois=(), background=None, thumbnail_adu=None,
        whole_frame=None,
    )  # fmt: skip
    return calibration, frame


def _astrometry_questions(step: Any) -> Iterator[Verdict]:
    catalogue = StarCatalogue.embedded()
    calibration, frame = star_frame(catalogue)
    shared = {"catalogue": catalogue}
    solutions: list[FrameSolution] = []

    def solved(given: DownlinkFrame) -> tuple[Any, FrameSolution]:
        state, solution = step.solve(step.initial_state(calibration, catalogue), given)
        _expect(isinstance(solution, FrameSolution), f"returned a {type(solution).__name__}, expected a FrameSolution")
        solutions.append(solution)
        return state, solution

    def without_stars() -> None:
        _, solution = solved(dataclasses.replace(frame, stars=StarList.empty()))
        _expect(bool(solution.flags & FrameFlag.NO_SOLUTION), "gave a solution without a star; expected the flag NO_SOLUTION")

    def round_trip() -> None:
        _, solution = solved(frame)
        line = np.linspace(0.0, 1.0, 9)
        row, col = (a.ravel() for a in np.meshgrid(line * (SHAPE[0] - 1), line * (SHAPE[1] - 1), indexing="ij"))
        vectors = solution.camera.unproject(row, col)
        _expect(np.shape(vectors) == (81, 3), f"unproject returned shape {np.shape(vectors)}, expected (81, 3)")
        _expect(bool(np.allclose(np.linalg.norm(vectors, axis=1), 1.0, atol=1e-9)), "unproject returned vectors not of length 1")
        back = solution.camera.project(vectors)
        off = float(np.hypot(back[0] - row, back[1] - col).max())
        _expect(off <= ROUND_TRIP_PX, f"pixel to direction to pixel is off by {off:.3g} px, allowed are {ROUND_TRIP_PX:g}")

    def behind() -> None:
        row, col = solved(frame)[1].camera.project(np.array([[0.0, 0.0, -1.0]]))
        _expect(
            bool(np.isnan(row).all() and np.isnan(col).all()), "project gave a pixel for what is behind the camera; expected NaN"
        )

    def kept() -> None:
        state, solution = solved(frame)
        checkpoint.from_bytes(checkpoint.to_bytes(state, shared), shared)
        again = checkpoint.from_bytes(checkpoint.to_bytes(solution))
        place = np.array([3.0]), np.array([5.0])
        same = np.array_equal(again.camera.unproject(*place), solution.camera.unproject(*place))
        _expect(same, "a camera that was written to a file and read gives other directions")

    def travels() -> None:
        ForkingPickler.dumps(solved(frame)[1])

    def named() -> None:
        lists = [tuple(p.name for p in solution.camera.parameters()) for solution in solutions]
        bad = [name for name in lists[0] if not name.isidentifier() or name != name.lower()]
        _expect(not bad, f"parameters {bad}: names are small letters, digits and underscores")
        _expect(len(set(lists)) == 1, "the names of the parameters differ between frames")

    def same_twice() -> None:
        _expect(
            checkpoint.to_bytes(solved(frame)[1]) == checkpoint.to_bytes(solved(frame)[1]), "two calls gave different results"
        )

    yield _asked("survives a frame without stars", without_stars)
    yield _asked("pixel to direction to pixel comes back", round_trip)
    yield _asked("what is behind the camera has no pixel", behind)
    yield _asked("state and solution can be kept in a file", kept)
    yield _asked("a solution can travel to another process", travels)
    yield _asked("the camera's parameters have names", named)
    yield _asked("gives the same twice", same_twice)
