"""The exam of a plug-in (`sboc check MODULE:CLASS`): the tests that every step must pass, with a verdict for each."""

import copy
import dataclasses
import inspect
import time
from collections.abc import Callable, Iterator
from multiprocessing.reduction import ForkingPickler
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.exams import astrometry, codec, detector, fitter, ground_steps, linker, tracker
from sboc_e2e.exams.codec import NOISE_ADU, SLOW_S_PER_MPX
from sboc_e2e.exams.trails import PSF_SIGMA_PX
from sboc_e2e.exams.verdict import Verdict, asked, expect
from sboc_e2e.files import checkpoint
from sboc_e2e.icd.errors import UserError
from sboc_e2e.icd.flags import MaskBit
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.layout import CodecNumber
from sboc_e2e.icd.results import check_background, check_detections, check_stars
from sboc_e2e.icd.signals import BackgroundModel, DetectorView, StarList
from sboc_e2e.icd.steps import Decoder, Encoder
from sboc_e2e.registry import SEAMS, Registry, Seam, own_names
from sboc_e2e.scenario import option_models

SHAPE: Final = (256, 320)
"""Rows and columns of the synthetic frames: unequal, so that exchanged axes show; small, for many questions."""
TILE_PX: Final = 64  # Of the synthetic mesh: the default of `onboard.background`, so that plug-ins meet what flies.
SPEED_SHAPE: Final = (1024, 1024)
"""Frame of the question of speed unless another size is asked for."""


def examine(
    path: str, registry: Registry, seam: str | None = None, shape: tuple[int, int] = SPEED_SHAPE
) -> tuple[Seam, list[Verdict]]:
    """Examine the class ``module:Class``; its seam is found by its methods unless it is named.

    shape : rows and columns of the frame that the question of speed is asked for.
    Raises `UserError` when the class cannot be loaded, fits no seam or cannot be made with its default options.
    """
    found = registry.load_class(path)
    place = _seam_of(found, path, seam)
    registry.resolve(place.name, path, typed=True)
    try:
        step = found()
    except Exception as error:
        raise UserError(f"{path}: cannot be made with default options: {type(error).__name__}: {error}") from error
    return place, list(_questions(place, step, path, registry, shape))


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


def _questions(seam: Seam, step: Any, path: str, registry: Registry, shape: tuple[int, int]) -> Iterator[Verdict]:
    yield asked("matches the Protocol", lambda: expect(isinstance(step, seam.protocol), f"not a {seam.protocol.__name__}"))
    yield asked("can travel to another process", lambda: ForkingPickler.dumps(step) and None)
    yield asked("options can be written in a scenario", lambda: _options_round_trip(step))
    yield from TRIALS[seam.name](step, path, registry, shape)


Trial = Callable[[Any, str, Registry, tuple[int, int]], Iterator[Verdict]]
"""Questions to a step: the step, what it was asked for by, who finds steps, and the frame of the question of speed."""

TRIALS: Final[dict[str, Trial]] = {
    "onboard.detector": lambda step, path, registry, shape: _detector_questions(step, shape),
    "onboard.tracker": lambda step, path, registry, shape: tracker.questions(step),
    "onboard.star_extractor": lambda step, path, registry, shape: _extractor_questions(step, shape),
    "onboard.background": lambda step, path, registry, shape: _background_questions(step),
    "onboard.codec": lambda step, path, registry, shape: _codec_questions(step, path, registry),
    "ground.decoder": lambda step, path, registry, shape: _codec_questions(step, path, registry),
    "ground.streak_fitter": lambda step, path, registry, shape: fitter.questions(step.fit),
    "ground.vetter": lambda step, path, registry, shape: ground_steps.vetter_questions(step),
    "ground.astrometry": lambda step, path, registry, shape: astrometry.questions(step),
    "ground.photometry": lambda step, path, registry, shape: ground_steps.photometer_questions(step),
    "ground.linker": lambda step, path, registry, shape: linker.questions(step),
    "ground.orbit": lambda step, path, registry, shape: ground_steps.orbit_questions(step),
}
"""By seam, every one of them: what is not called is not examined."""


def _options_round_trip(step: Any) -> None:
    kind: Any = type(step)
    model = option_models.validate(option_models.model_of(kind), option_models.to_document(step), kind.__name__)
    expect(option_models.build(kind, model, "options") == step, "options change when written and read back")


# -- detectors and star extractors --------------------------------------------------------------------------------------


def synthetic_view(kind: str, history_frames: int = 0, shape: tuple[int, int] = SHAPE) -> DetectorView:
    """A view of noise with ten stars and a streak; or empty, saturated, fully masked, or without any signal."""
    rng = np.random.default_rng(11)
    residual = rng.normal(0.0, 2.4, shape).astype(np.float32)
    mask = np.zeros(shape, dtype=np.uint8)
    rows, cols = np.mgrid[: shape[0], : shape[1]]
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
    return _view(residual, mask, history_frames)


def _view(residual: NDArray[np.float32], mask: NDArray[np.uint8], history_frames: int) -> DetectorView:
    """A view of pixels whose noise is known, after as many like it."""
    rows, cols = residual.shape
    mesh = np.full((-(-rows // TILE_PX), -(-cols // TILE_PX)), 10.0, dtype=np.float32)
    header = FrameHeader(
        frame=7, t_start_tai_ns=2_179_000_000 * 10**9, exposure_ns=200_000_000, line_time_ns=10_000, rows=rows, cols=cols,
        gain_e_adu=1.2, read_noise_e=2.3, saturation_adu=65535.0,
    )  # fmt: skip
    view = DetectorView(
        header=header,
        residual_adu=residual,
        background=BackgroundModel(tile_px=TILE_PX, level_adu=mesh, sigma_adu=np.full_like(mesh, NOISE_ADU)),
        mask=mask,
        stars=StarList.empty(),
        psf_sigma_px=PSF_SIGMA_PX,
    )
    if history_frames == 0:
        return view
    earlier = [dataclasses.replace(view, header=dataclasses.replace(header, frame=7 - k)) for k in range(history_frames, 0, -1)]
    return dataclasses.replace(view, history=tuple(earlier))


VIEWS: Final = ("noise", "streak", "zero", "saturated", "masked", "not a number")


def _detector_questions(step: Any, shape: tuple[int, int]) -> Iterator[Verdict]:
    yield from _view_questions(step.detect, lambda: int(step.history_frames), _detections_are_sound, shape)
    yield from detector.finding(step)


def _extractor_questions(step: Any, shape: tuple[int, int]) -> Iterator[Verdict]:
    yield from _view_questions(step.extract, lambda: 0, _stars_are_sound, shape)


def _view_questions(
    method: Callable[[DetectorView], Any], history: Callable[[], int], sound: Callable[[Any], None], shape: tuple[int, int]
) -> Iterator[Verdict]:
    for kind in VIEWS:

        def survived(kind: str = kind) -> None:
            sound(method(synthetic_view(kind, history())))

        yield asked(f"survives a frame: {kind}", survived)
    yield asked("survives without history", lambda: sound(method(synthetic_view("streak"))))
    yield asked("leaves its input untouched", lambda: _input_untouched(method, synthetic_view("streak", history())))
    yield asked("gives the same twice", lambda: _same_twice(method, synthetic_view("streak", history())))
    limit_s = SLOW_S_PER_MPX * shape[0] * shape[1] / 1e6
    words = f"takes less than {limit_s:.3g} s for {shape[0]} x {shape[1]} pixels ({SLOW_S_PER_MPX:g} s a million)"
    yield asked(words, lambda: _fast(method, synthetic_view("streak", history(), shape), limit_s))


def _detections_are_sound(found: Any) -> None:
    expect(isinstance(found, tuple), f"returned a {type(found).__name__}, expected a tuple")
    check_detections(found, SHAPE)
    order = [detection.snr for detection in found]
    expect(order == sorted(order, reverse=True), "detections are not ordered by falling S/N")


def _stars_are_sound(found: Any) -> None:
    check_stars(found, SHAPE)
    inside = (found.row >= -1) & (found.row <= SHAPE[0]) & (found.col >= -1) & (found.col <= SHAPE[1])
    expect(bool(inside.all()), "a star lies outside the frame")


def _input_untouched(method: Callable[[DetectorView], Any], view: DetectorView) -> None:
    # The contract's read-only flag protects views; a plug-in may still write through the array's base.
    before = copy.deepcopy((view.residual_adu, view.mask))
    method(view)
    same = np.array_equal(before[0], view.residual_adu, equal_nan=True) and np.array_equal(before[1], view.mask)
    expect(same, "changed the arrays that it was given")


def _same_twice(method: Callable[[DetectorView], Any], view: DetectorView) -> None:
    expect(checkpoint.to_bytes(method(view)) == checkpoint.to_bytes(method(view)), "two calls gave different results")


def _fast(method: Callable[[DetectorView], Any], view: DetectorView, limit_s: float) -> str:
    method(synthetic_view("streak", len(view.history)))  # the first call compiles the kernels
    start = time.process_time()
    method(view)
    taken_s = time.process_time() - start
    expect(taken_s < limit_s, f"took {taken_s:.1f} s")
    return f"{taken_s:.2f} s"


# -- background and codecs ----------------------------------------------------------------------------------------------


def _background_questions(step: Any) -> Iterator[Verdict]:
    rng = np.random.default_rng(5)
    level = (110 + rng.normal(0, 2.4, SHAPE)).astype(np.uint16)
    dark, free = np.full(SHAPE, 100, dtype=np.int16), np.zeros(SHAPE, dtype=np.uint8)

    def sound(pixels: NDArray[Any], mask: NDArray[np.uint8], near: float | None) -> None:
        model = step.estimate(pixels, dark, mask)
        check_background(model, SHAPE)
        if near is not None:
            expect(
                abs(float(np.median(model.level_adu)) - near) < 1.0, f"level {np.median(model.level_adu):.1f}, expected {near}"
            )

    yield asked("finds the level of a plain sky", lambda: sound(level, free, 9.5))
    yield asked("survives a frame: saturated", lambda: sound(np.full(SHAPE, 65535, np.uint16), free, None))
    yield asked("survives a frame: masked", lambda: sound(level, np.full(SHAPE, MaskBit.MISSING, np.uint8), None))


def _codec_questions(step: Any, path: str, registry: Registry) -> Iterator[Verdict]:
    def numbered() -> None:
        shipped = {int(number) for number in CodecNumber}
        number = int(step.number)
        own = type(step).__module__.startswith(("onboard.", "ground."))
        expect(number in shipped if own else 128 <= number <= 255, f"codec number {number}; plug-ins use 128 to 255")

    yield asked("has a codec number of its own", numbered)
    if isinstance(step, Encoder):
        rng = np.random.default_rng(3)
        for name, values in (
            ("noise", rng.normal(100, 2.4, (40, 13)).astype(np.int32)),
            ("one pixel", np.array([[7]], np.int32)),
            ("extremes", np.array([[-65535, 65535], [0, 65535]], np.int32)),
        ):

            def encoded(values: NDArray[np.int32] = values) -> None:
                block = step.encode(values, level_adu=100, sigma_adu=2.4)
                expect(isinstance(block, bytes), f"returned a {type(block).__name__}, expected bytes")

            yield asked(f"encodes {name}", encoded)
        decoder = registry.decoder_for(path, step) or _shipped("ground.decoder", step.number, registry)
        if decoder is None:
            reason = f"none in its module reads codec number {step.number}; without one nothing of it can be scored"
            yield Verdict(question="has a decoder", passed=False, detail=reason)
        else:
            yield from codec.round_trip(step, decoder)
    if isinstance(step, Decoder):
        for name, block in (("nothing", b""), ("noise", bytes(range(256)) * 3)):

            def refused(block: bytes = block) -> None:
                try:
                    values = step.decode(block, (40, 13), level_adu=100, sigma_adu=2.4)
                except UserError:
                    return
                expect(np.shape(values) == (40, 13), f"returned shape {np.shape(values)}, expected (40, 13)")

            yield asked(f"decodes or refuses {name}", refused)


def _shipped(seam: str, number: int, registry: Registry) -> Any | None:
    """The project's own half of a codec."""
    made = (registry.resolve(seam, name)() for name in own_names(seam))
    return next((step for step in made if step.number == number), None)
