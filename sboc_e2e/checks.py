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

from sboc_e2e.files import checkpoint
from sboc_e2e.icd.errors import ContractError, UserError
from sboc_e2e.icd.flags import MaskBit
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.layout import CodecNumber
from sboc_e2e.icd.results import check_background, check_detections, check_stars
from sboc_e2e.icd.signals import BackgroundModel, DetectorView, StarList
from sboc_e2e.icd.steps import Decoder, Encoder
from sboc_e2e.linker_exam import Failed, linker_questions
from sboc_e2e.linker_exam import expect as _expect
from sboc_e2e.registry import SEAMS, Registry, Seam
from sboc_e2e.scenario import option_models

SHAPE: Final = (256, 320)
SLOW_S: Final = 5.0
EXAMINED: Final = (
    "onboard.background",
    "onboard.star_extractor",
    "onboard.detector",
    "onboard.codec",
    "ground.decoder",
    "ground.linker",
)
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
    elif seam.name == "ground.linker":
        yield from linker_questions(step, _asked)


def _asked(question: str, trial: Callable[[], object]) -> Verdict:
    """A verdict: passed unless the trial raises; what it returns as text is a figure that the verdict reports."""
    try:
        said = trial()
    except Exception as error:  # noqa: BLE001 - a plug-in may raise anything; that is what is being examined
        text = str(error).splitlines()[0] if str(error) else "no reason given"
        kind = "" if isinstance(error, Failed | ContractError) else f"{type(error).__name__}: "
        return Verdict(question=question, passed=False, detail=f"{kind}{text}"[:200])
    return Verdict(question=question, passed=True, detail=said if isinstance(said, str) else "")


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
