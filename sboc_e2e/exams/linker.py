"""The exam of a linker: objects on straight paths over a synthetic sky, with noise, gaps and false streaks, before a camera that
stands still and one that turns; what the contract asks for is judged, how well it links is reported."""

import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ground.guard import links_of
from ground.link import apply_links
from ground.streak_rows import STREAKS_PER_FRAME
from sboc_e2e.exams.verdict import Verdict, asked, expect
from sboc_e2e.files import checkpoint
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import StreakFit, StreakMeasurement, Tracklet

SLOW_S: Final = 10.0  # CPU seconds for 20 frames with some 16 streaks each. Chosen: twice the 5 s that it takes to record them.
FRAMES: Final = 20  # Five seconds at four frames a second, the least that shows each object several times.
OBJECTS: Final = 12  # The interval of a linked share of one half, the pass mark, is then +- 0.22 (Wilson). More take longer.
FALSE_PER_FRAME: Final = 6  # False streaks: a third to a half of all, far more than published frames have (0.13 in README.md).
SEEN: Final = 0.85  # Chance that an object is found in a frame: gaps occur, and a linker must bridge them. Chosen.
SIZE_PX: Final = 2048  # Side of the frames (px), half that of `sboc_like`.
FOCAL_PX: Final = 22222.0
"""Half of 44,444 px, the focal length of `sboc_like`: the same field of 5.3 deg on half the pixels a side."""
SIGMA_ALONG_PX: Final = 0.4  # Error of an end along a trail of 23 px and S/N 16: 4.39 L / S**2 (docs/scoring.md).
SIGMA_CROSS_PX: Final = 0.15  # Error of an end across at S/N 16: the bound of a straight trail, sqrt(8) s / S with s = 0.85 px.
START_TAI_NS: Final = 2_179_000_000 * 10**9
"""Nanoseconds since 1958 TAI: in January 2027, where the shipped scenarios are. Any epoch serves."""
LINE_TIME_NS: Final = 10_000  # Of the preset `sboc_like`: rows are dated apart, as a rolling shutter's are.


@dataclass(frozen=True, kw_only=True, eq=False)
class LinkerTrial:
    """Frames, their streaks, and of each streak the object (-1: false), whether end 0 came first, and epochs of its ends, ns."""

    headers: tuple[FrameHeader, ...]
    streaks: tuple[StreakMeasurement, ...]
    owner: NDArray[np.int64]
    end0_first: NDArray[np.bool_]
    epochs_ns: NDArray[np.int64]


def questions(step: Any) -> Iterator[Verdict]:
    """Questions to a linker; how well it links is the text of a verdict."""
    yield asked("links nothing where there is nothing", lambda: _nothing(step))
    for what, turn_rad_s, exposure_s in (("a camera at rest", 0.0, 0.2), ("a camera that turns by 0.3 deg/s", 5e-3, 1.0)):
        trial = linker_trial(turn_rad_s=turn_rad_s, exposure_s=exposure_s)
        yield asked(f"keeps its Protocol before {what}", partial(_checked, step, trial))
        yield asked(f"links most of {OBJECTS} objects before {what}", partial(linking_figures, step, trial))
    trial = linker_trial(turn_rad_s=0.0, exposure_s=0.2)
    yield asked("leaves its input untouched", lambda: _untouched(step, trial))
    yield asked("gives the same twice", lambda: _same_twice(step, trial))
    yield asked(f"takes less than {SLOW_S:g} s for {len(trial.streaks)} streaks", lambda: _fast(step, trial))


def linker_trial(*, turn_rad_s: float, exposure_s: float, seed: int = 17) -> LinkerTrial:
    """A run of `FRAMES` frames. turn_rad_s : of the camera about its axis, by which stars go round the frame's middle."""
    rng = np.random.default_rng(seed)
    exposure_ns = round(exposure_s * 1e9)
    cadence_s = exposure_s + 0.05
    axes = _axes(131.5, 17.9)
    middle = 0.5 * (SIZE_PX - 1)
    places = rng.uniform(-0.4, 0.4, (OBJECTS, 2)) * SIZE_PX
    angle, length = rng.uniform(0.0, 2.0 * np.pi, OBJECTS), 10 ** rng.uniform(1.2, 2.2, OBJECTS)
    velocity = (length / exposure_s)[:, None] * np.stack([np.sin(angle), np.cos(angle)], axis=1)
    seen_at = rng.uniform(0.0, FRAMES * cadence_s, OBJECTS)
    headers, streaks, owner, first, epochs = [], [], [], [], []
    for frame in range(FRAMES):
        start_ns = START_TAI_NS + round(frame * cadence_s * 1e9)
        headers.append(
            FrameHeader(
                frame=frame, t_start_tai_ns=start_ns, exposure_ns=exposure_ns, line_time_ns=LINE_TIME_NS,
                rows=SIZE_PX, cols=SIZE_PX,
            )
        )  # fmt: skip
        zero_s = frame * cadence_s + 0.5 * exposure_s
        found: list[tuple[NDArray[np.float64], int, NDArray[np.float64]]] = []
        for k in range(OBJECTS):
            # places on the sky, px from the axis, turned into the frame as the camera stands at that epoch
            t_s = frame * cadence_s + np.array([0.0, exposure_s])
            for _ in range(4):
                on_sky = places[k] + velocity[k] * (t_s - seen_at[k])[:, None]
                ends = np.array([_turned(p, -turn_rad_s * t) for p, t in zip(on_sky, t_s, strict=True)]) + middle
                t_s = frame * cadence_s + np.array([0.0, exposure_s]) + 1e-9 * LINE_TIME_NS * ends[:, 0]
            if rng.random() < SEEN and ((ends > 1.0) & (ends < SIZE_PX - 2.0)).all():
                found.append((ends, k, t_s))
        for _ in range(FALSE_PER_FRAME):
            at, way, half = (
                rng.uniform(100.0, SIZE_PX - 100.0, 2),
                rng.uniform(0.0, 2.0 * np.pi),
                0.5 * 10 ** rng.uniform(0.9, 2.2),
            )
            found.append((at + half * np.array([[-np.sin(way), -np.cos(way)], [np.sin(way), np.cos(way)]]), -1, np.zeros(2)))
        for number, place in enumerate(rng.permutation(len(found))):
            ends, k, t_s = found[place]
            along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
            across = np.array([-along[1], along[0]])
            noisy = ends + rng.normal(0.0, SIGMA_ALONG_PX, (2, 1)) * along + rng.normal(0.0, SIGMA_CROSS_PX, (2, 1)) * across
            in_order = bool(noisy[0, 1] <= noisy[1, 1])
            noisy = noisy if in_order else noisy[::-1]
            points = np.stack([noisy[0], noisy.mean(axis=0), noisy[1]])
            mid_s = zero_s + 1e-9 * LINE_TIME_NS * points[:, 0]
            sky = np.array([_turned(p - middle, turn_rad_s * t) for p, t in zip(points, mid_s, strict=True)])
            ra_deg, dec_deg = _radec(sky, axes)
            streaks.append(
                _streak(frame, number, noisy, points[1], ra_deg, dec_deg, START_TAI_NS + np.rint(mid_s * 1e9).astype(np.int64),
                        _sense(axes) * turn_rad_s * axes[2])
            )  # fmt: skip
            owner.append(k)
            first.append(in_order)
            epochs.append(START_TAI_NS + np.rint(t_s * 1e9).astype(np.int64))
    return LinkerTrial(
        headers=tuple(headers),
        streaks=tuple(streaks),
        owner=np.array(owner),
        end0_first=np.array(first),
        epochs_ns=np.array(epochs).reshape(-1, 2),
    )


def linking_figures(step: Any, trial: LinkerTrial) -> str:
    """Completeness and purity, and what dates the ends of members that belong together. Fails where less than half is linked."""
    tracklets = _checked(step, trial)
    at = {s.streak_id: k for k, s in enumerate(trial.streaks)}
    detected = Counter(trial.owner[trial.owner >= 0].tolist())
    findable = {k for k, n in detected.items() if n >= 3}
    held: dict[int, int] = {}
    pure = false = 0
    for tracklet in tracklets:
        k, n = Counter(trial.owner[[at[i] for i in tracklet.streak_ids.tolist()]].tolist()).most_common(1)[0]
        pure += n if k >= 0 else 0
        false += k < 0
        held[k] = max(held.get(k, 0), n)
    complete = sum(held.get(k, 0) >= 0.5 * detected[k] for k in findable)
    members = sum(len(t.streak_ids) for t in tracklets)
    expect(complete >= 0.5 * len(findable), f"{complete} of {len(findable)} objects are linked in half of their frames or more")
    resolved = [
        (k, s)
        for k, s in enumerate(apply_links(trial.streaks, tracklets, trial.headers))
        if s.flags & StreakFlag.DIRECTION_RESOLVED and trial.owner[k] >= 0
    ]
    right = [(s.fit.row0 == trial.streaks[k].fit.row0) == trial.end0_first[k] for k, s in resolved]
    late_us = [np.abs(s.t_tai_ns[[0, 2]] - trial.epochs_ns[k]).max() * 1e-3 for k, s in resolved]
    return (
        f"completeness {complete}/{len(findable)}, purity {pure}/{members}, false tracklets {false}, ends in order "
        f"{sum(right)}/{len(right)}, epochs right to {np.median(late_us) if late_us else np.nan:.0f} us (median)"
    )


def _checked(step: Any, trial: LinkerTrial) -> tuple[Tracklet, ...]:
    """Tracklets, as the chain takes or refuses them, of two frames or more."""
    counts = Counter(s.frame for s in trial.streaks)
    tracklets = links_of(step, step.link(trial.headers, trial.streaks), counts)
    for tracklet in tracklets:
        expect(len(set(tracklet.frames.tolist())) > 1, f"tracklet {tracklet.tracklet_id} is of one frame")
    return tracklets


def _nothing(step: Any) -> None:
    trial = linker_trial(turn_rad_s=0.0, exposure_s=0.2)
    for headers in ((), trial.headers[:1], trial.headers):
        found = step.link(headers, ())
        expect(isinstance(found, tuple) and not found, f"{len(headers)} frames without a streak gave {found!r}"[:100])
    alone = tuple(s for s in trial.streaks if s.frame == 0)
    expect(not step.link(trial.headers[:1], alone), "streaks of one frame were linked")


def _membership(tracklets: Sequence[Tracklet]) -> list[tuple[int, list[int]]]:
    return [(t.tracklet_id, t.streak_ids.tolist()) for t in tracklets]


def _same_twice(step: Any, trial: LinkerTrial) -> None:
    one, other = (_membership(step.link(trial.headers, trial.streaks)) for _ in range(2))
    expect(one == other, "two calls gave different tracklets")


def _untouched(step: Any, trial: LinkerTrial) -> None:
    before = checkpoint.to_bytes((trial.headers, trial.streaks))
    step.link(trial.headers, trial.streaks)
    expect(checkpoint.to_bytes((trial.headers, trial.streaks)) == before, "changed the streaks that it was given")


def _fast(step: Any, trial: LinkerTrial) -> None:
    step.link(trial.headers, trial.streaks)
    start = time.process_time()
    step.link(trial.headers, trial.streaks)
    taken_s = time.process_time() - start
    expect(taken_s < SLOW_S, f"took {taken_s:.1f} s")


def _turned(place: NDArray[np.float64], angle_rad: float) -> NDArray[np.float64]:
    """A place (row, col) from the axis, turned about it."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([c * place[0] - s * place[1], s * place[0] + c * place[1]])


def _axes(ra_deg: float, dec_deg: float) -> NDArray[np.float64]:
    """Rows: directions in which cols and rows grow, and of the axis."""
    ra, dec = np.radians(ra_deg), np.radians(dec_deg)
    axis = np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    east = np.array([-np.sin(ra), np.cos(ra), 0.0])
    return np.array([-east, -np.cross(axis, east), axis])


def _sense(axes: NDArray[np.float64]) -> float:
    """Which way round the axis (row, col) turns to (row - s col, col + s row): a positive angle takes rows to cols."""
    return float(np.sign(np.cross(axes[1], axes[0]) @ axes[2]))


def _radec(places: NDArray[np.float64], axes: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Right ascension and declination, deg, of places (n, 2), row and col px from the axis."""
    v = np.column_stack([places[:, ::-1] / FOCAL_PX, np.ones(len(places))]) @ axes
    return np.degrees(np.arctan2(v[:, 1], v[:, 0])) % 360.0, np.degrees(np.arctan2(v[:, 2], np.hypot(v[:, 0], v[:, 1])))


def _streak(
    frame: int,
    number: int,
    ends: NDArray[np.float64],
    middle: NDArray[np.float64],
    ra_deg: NDArray[np.float64],
    dec_deg: NDArray[np.float64],
    t_tai_ns: NDArray[np.int64],
    turn_rad_s: NDArray[np.float64],
) -> StreakMeasurement:
    """A measurement as it comes to a linker."""
    along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    across = np.array([-along[1], along[0]])
    block = SIGMA_ALONG_PX**2 * np.outer(along, along) + SIGMA_CROSS_PX**2 * np.outer(across, across)
    fit = StreakFit(
        row0=float(ends[0, 0]), col0=float(ends[0, 1]), row1=float(ends[1, 0]), col1=float(ends[1, 1]),
        covariance_px2=np.kron(np.eye(2), block).astype(np.float64),
        end_interval_px=np.array([[-SIGMA_ALONG_PX, SIGMA_ALONG_PX]] * 2),
        sigma_cross_px=SIGMA_CROSS_PX, flux_e=1000.0, flux_err_e=50.0, snr=20.0, sagitta_px=0.0, sagitta_err_px=0.1, gradient=0.0,
        width_px=0.85, width_err_px=0.02, chi2_nu=1.0, n_pixels=300, flags=StreakFlag(0),
        light_curve_e_px=np.zeros(0, dtype=np.float32),
    )  # fmt: skip
    return StreakMeasurement(
        frame=frame, streak_id=frame * STREAKS_PER_FRAME + number, roi_id=number, fit=fit, row_mid=float(middle[0]),
        col_mid=float(middle[1]), ra_deg=ra_deg, dec_deg=dec_deg, t_tai_ns=t_tai_ns, sigma_along_arcsec=2.6,
        sigma_cross_arcsec=1.0, mag=10.0, mag_err=0.1, probability=0.9, tracklet_id=-1, flags=StreakFlag(0),
        turn_rad_s=turn_rad_s,
    )  # fmt: skip
