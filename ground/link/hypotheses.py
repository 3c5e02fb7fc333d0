"""Streaks into hypotheses of motion: which end came first, and when the object was at each end.

An exposed row r is open from ``t_start + r tau`` to ``t_start + r tau + T``. If the shutter of its row opened on the object at
end A and closed on it at end B, then the object was at A at ``t_start + r_A tau`` and at B at ``t_start + T + r_B tau``. A streak
does not say which of its ends is A, so each one is two hypotheses. The camera may turn meanwhile: each end has the direction that
its pixel had at the epoch of the hypothesis. Under a rolling shutter there are two speeds
``v = L_row / (T + L_row tau)`` and ``v = -L_row / (T - L_row tau)``. An object that overtakes the read-out (v tau > 1) is at B
before it is at A: the same two formulae hold and the later epoch is the open one.
"""

from collections.abc import Iterable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ground.sky.rotation import turn
from ground.sky.sphere import ARCSEC_RAD, unit_vectors
from sboc_e2e.icd.errors import ContractError
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import StreakMeasurement

FULL, ENTERING, LEAVING, POINT, CROSSING = range(5)
"""Which epochs a hypothesis fixes: both ends, only the later one, only the earlier one, the middle, none."""

_SIGMA_UNKNOWN_PX = 1.0
"""End error of a streak whose fit gave no usable covariance: about that of the on-board detection."""

SHORTEST_EXPOSURE_S = 1e-6
"""Least exposure. Frames from outside may have no exposure (0), and a trail of no duration would have no speed."""

_LOG_VETO_LOSS = float(np.log(0.03))
"""Log probability that the vetter rejects a real streak. With the density of rejected streaks it sets the weight of one on a
track."""

_CHANGE_POINT_TAILS = 1.5
"""Widening of the 68 % interval of an end that is a change point, so that a Gaussian covers its exponential tails."""


_BLOCK: Final = 8192
"""Streaks per block. Intermediate arrays are several times as large as the tables."""


class StreakTable(NamedTuple):
    """Columns that linking needs of n streaks, sorted by frame and then by input order.

    frame : ordinal of the frame in time order. streak_id : inside it. flags : StreakFlag bits. mag, mag_err : NaN where unknown.
    row, col : (n, 3) px of end 0, middle, end 1. unit : (n, 3, 3) unit vectors of the same points at mid-exposure of their rows.
    turn_rad_s : (n, 3) angular velocity of the camera in the same axes.
    sigma_along_rad, (n, 2) of both ends; sigma_cross_rad (n,). scale_rad_px : (n,) plate scale.
    log_odds : (n,) of being real, from the vetter, relative to the mean of all. track : (n,) number of the on-board track, -1:
    none. snr : (n,) of the fit; track_snr : (n,) joint S/N of the track on board, 0: not known.
    """

    frame: NDArray[np.int64]
    streak_id: NDArray[np.int64]
    flags: NDArray[np.int64]
    row: NDArray[np.float64]
    col: NDArray[np.float64]
    unit: NDArray[np.float64]
    turn_rad_s: NDArray[np.float64]
    sigma_along_rad: NDArray[np.float64]
    sigma_cross_rad: NDArray[np.float64]
    scale_rad_px: NDArray[np.float64]
    log_odds: NDArray[np.float64]
    mag: NDArray[np.float64]
    mag_err: NDArray[np.float64]
    track: NDArray[np.int64]
    snr: NDArray[np.float64]
    track_snr: NDArray[np.float64]


class FrameTable(NamedTuple):
    """Frames in time order: number, start of row 0 (s after `origin_tai_ns`), exposure and line time (s), size (px)."""

    number: NDArray[np.int64]
    start_s: NDArray[np.float64]
    exposure_s: NDArray[np.float64]
    line_time_s: NDArray[np.float64]
    shape: NDArray[np.int64]
    origin_tai_ns: int


class Nodes(NamedTuple):
    """Hypotheses, two per streak (2 k: shutter opened at end 0; 2 k + 1: at end 1); a is the earlier point, b the later.

    frame, kind : (m,). t_s : (m, 2) epochs of a and b. unit : (m, 2, 3). sigma_rad : (m, 3) along at a, along at b, cross;
    measured_rad : the same without the floor.
    vetoed : (m,) rejected by the vetter. Such a streak may join a track. It starts one only together with a streak that passed.
    length_rad, duration_s, fastest_rad_s, log_clutter, log_odds : (m,). order : (m,) nodes by frame, inside a frame by rising
    component of their middle along axis `axis`; sorted_key : (m,) those components; first : (frames + 1,) offsets into both.
    """

    frame: NDArray[np.int64]
    kind: NDArray[np.int8]
    t_s: NDArray[np.float64]
    unit: NDArray[np.float64]
    sigma_rad: NDArray[np.float64]
    measured_rad: NDArray[np.float64]
    vetoed: NDArray[np.bool_]
    length_rad: NDArray[np.float64]
    duration_s: NDArray[np.float64]
    fastest_rad_s: NDArray[np.float64]
    log_clutter: NDArray[np.float64]
    log_odds: NDArray[np.float64]
    order: NDArray[np.int64]
    sorted_key: NDArray[np.float64]
    first: NDArray[np.int64]
    axis: int


def frame_table(headers: Sequence[FrameHeader]) -> FrameTable:
    """Columns of the headers by rising start of exposure."""
    ordered = sorted(headers, key=lambda header: (header.t_start_tai_ns, header.frame))
    origin_tai_ns = ordered[0].t_start_tai_ns if ordered else 0
    return FrameTable(
        number=np.array([header.frame for header in ordered], dtype=np.int64),
        start_s=np.array([(header.t_start_tai_ns - origin_tai_ns) * 1e-9 for header in ordered]),
        exposure_s=np.array([max(header.exposure_ns * 1e-9, SHORTEST_EXPOSURE_S) for header in ordered]),
        line_time_s=np.array([header.line_time_ns * 1e-9 for header in ordered]),
        shape=np.array([(header.rows, header.cols) for header in ordered], dtype=np.int64).reshape(-1, 2),
        origin_tai_ns=origin_tai_ns,
    )


def has_sky(streak: StreakMeasurement) -> bool:
    """Whether the streak carries sky positions."""
    return not streak.flags & StreakFlag.NO_SKY and bool(np.isfinite(streak.ra_deg).all() and np.isfinite(streak.dec_deg).all())


def streak_tables(
    streaks: Iterable[StreakMeasurement], frames: FrameTable, pixel_scale_arcsec: float
) -> tuple[StreakTable, StreakTable]:
    """Columns of the streaks with sky positions, and of the streaks without. The latter are put on a plane of the given scale.

    Records are read once and not kept, so a long run may make them one after another.
    Errors: a `ContractError` for a streak whose frame has no header.
    """
    ordinal = {int(number): k for k, number in enumerate(frames.number)}
    waiting: tuple[list[StreakMeasurement], list[StreakMeasurement]] = ([], [])
    blocks: tuple[list[dict[str, NDArray[Any]]], list[dict[str, NDArray[Any]]]] = ([], [])
    scale = pixel_scale_arcsec * ARCSEC_RAD
    for streak in streaks:
        if streak.frame not in ordinal:
            raise ContractError(f"linker: streaks of frame {streak.frame} have no header among the {len(ordinal)} given")
        group = int(not has_sky(streak))
        waiting[group].append(streak)
        if len(waiting[group]) == _BLOCK:
            blocks[group].append(_columns(waiting[group], ordinal, frames, group == 0, scale))
            waiting[group].clear()
    for group in (0, 1):
        blocks[group].append(_columns(waiting[group], ordinal, frames, group == 0, scale))
    return _table(blocks[0], scale, sky=True), _table(blocks[1], scale, sky=False)


def _columns(
    streaks: Sequence[StreakMeasurement], ordinal: dict[int, int], frames: FrameTable, sky: bool, scale_rad_px: float
) -> dict[str, NDArray[Any]]:
    """Columns of a `StreakTable` for some streaks, in their order; errors in px, and the vetter's probability for its odds."""
    frame = np.array([ordinal[s.frame] for s in streaks], dtype=np.int64)
    row = np.array([(s.fit.row0, s.row_mid, s.fit.row1) for s in streaks]).reshape(-1, 3)
    col = np.array([(s.fit.col0, s.col_mid, s.fit.col1) for s in streaks]).reshape(-1, 3)
    if sky:
        ra, dec = (np.radians([getattr(s, name) for s in streaks]).reshape(-1, 3) for name in ("ra_deg", "dec_deg"))
        unit = unit_vectors(ra, dec)
        turn_rad_s = np.array([s.turn_rad_s for s in streaks], dtype=np.float64).reshape(-1, 3)
    else:
        turn_rad_s = np.zeros((len(streaks), 3))
        centre = 0.5 * frames.shape[frame].astype(np.float64)
        plane = np.stack([(col - centre[:, 1:]) * scale_rad_px, (row - centre[:, :1]) * scale_rad_px, np.ones_like(row)], axis=-1)
        unit = plane / np.linalg.norm(plane, axis=-1, keepdims=True)
    along_px, cross_px = end_errors_px(streaks)
    return {
        "frame": frame,
        "streak_id": np.array([s.streak_id for s in streaks], dtype=np.int64),
        "flags": np.array([int(s.flags | s.fit.flags) for s in streaks], dtype=np.int64),
        "row": row,
        "col": col,
        "unit": unit,
        "turn_rad_s": turn_rad_s,
        "sigma_along_rad": along_px,
        "sigma_cross_rad": cross_px,
        "log_odds": np.array([s.probability for s in streaks], dtype=np.float64),
        "mag": np.array([s.mag for s in streaks], dtype=np.float64),
        "mag_err": np.array([s.mag_err for s in streaks], dtype=np.float64),
        "track": np.array([s.track for s in streaks], dtype=np.int64),
        "snr": np.array([s.fit.snr for s in streaks], dtype=np.float64),
        "track_snr": np.array([s.track_snr for s in streaks], dtype=np.float64),
    }


def _table(blocks: list[dict[str, NDArray[Any]]], scale_rad_px: float, *, sky: bool) -> StreakTable:
    """The table of all blocks; the blocks are consumed. scale_rad_px : used where the streaks do not determine the scale."""
    order = np.argsort(np.concatenate([block["frame"] for block in blocks]), kind="stable")
    joined = {name: np.concatenate([block.pop(name) for block in blocks])[order] for name in list(blocks[0])}
    scale = scale_rad_px
    if sky and len(order):
        scale = _plate_scale_rad_px(joined["frame"], joined["row"], joined["col"], joined["unit"], scale_rad_px)
    joined["sigma_along_rad"] *= scale
    joined["sigma_cross_rad"] *= scale
    joined["scale_rad_px"] = np.full(len(order), scale)
    vetoed = (joined["flags"] & StreakFlag.VETOED) != 0
    joined["log_odds"] = relative_log_odds(joined["log_odds"], vetoed)
    return StreakTable(**joined)


def relative_log_odds(probability: NDArray[np.float64], vetoed: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Log odds (n,) of being real relative to the mean of those that passed; NaN: even odds."""
    known = np.clip(np.where(np.isfinite(probability), probability, 0.5), 1e-6, 1.0 - 1e-6)
    logit = np.log(known / (1.0 - known))
    typical = float(known[~vetoed].mean()) if not vetoed.all() else 0.5
    base = np.log(typical / (1.0 - typical))
    return np.where(vetoed, _LOG_VETO_LOSS, np.clip(logit - base, -2.3, 2.3))


def _plate_scale_rad_px(
    frame: NDArray[np.int64],
    row: NDArray[np.float64],
    col: NDArray[np.float64],
    unit: NDArray[np.float64],
    default_rad_px: float,
) -> float:
    """Median of sky distance over pixel distance: of the ends of streaks, and of neighbours in the list of one frame."""
    own = np.linalg.norm(unit[:, 2] - unit[:, 0], axis=-1), np.hypot(row[:, 2] - row[:, 0], col[:, 2] - col[:, 0])
    same = frame[1:] == frame[:-1]
    step = np.linalg.norm(unit[1:, 1] - unit[:-1, 1], axis=-1)[same], np.hypot(np.diff(row[:, 1]), np.diff(col[:, 1]))[same]
    chord, pixels = np.concatenate([own[0], step[0]]), np.concatenate([own[1], step[1]])
    usable = pixels > 20.0
    scale = float(np.median(chord[usable] / pixels[usable])) if usable.any() else default_rad_px
    return scale if scale > 0.0 else default_rad_px  # a broken WCS may map all pixels to one direction


def end_errors_px(streaks: Sequence[StreakMeasurement]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Errors of both ends along (n, 2) and across (n,) the chord; 68 % intervals where they are wider than the covariance."""
    covariance = np.array([s.fit.covariance_px2 for s in streaks]).reshape(-1, 4, 4)
    interval = np.array([s.fit.end_interval_px for s in streaks]).reshape(-1, 2, 2)
    ends = np.array([(s.fit.row0, s.fit.col0, s.fit.row1, s.fit.col1) for s in streaks]).reshape(-1, 4)
    chord = ends[:, 2:] - ends[:, :2]
    length = np.linalg.norm(chord, axis=1)
    along = np.where(length[:, None] > 1e-6, chord / np.maximum(length, 1e-6)[:, None], np.array([1.0, 0.0]))
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    blocks = np.stack([covariance[:, :2, :2], covariance[:, 2:, 2:]], axis=1)
    var_along = np.einsum("ni,nkij,nj->nk", along, blocks, along)
    var_across = np.einsum("ni,nkij,nj->nk", across, blocks, across).max(axis=1, initial=0.0)
    half_width = 0.5 * np.nan_to_num(np.abs(interval[:, :, 1] - interval[:, :, 0]))
    not_gaussian = np.array([bool((s.flags | s.fit.flags) & StreakFlag.ENDS_NOT_GAUSSIAN) for s in streaks], dtype=np.bool_)
    half_width *= np.where(not_gaussian, _CHANGE_POINT_TAILS, 1.0)[:, None]
    sigma_along = np.sqrt(np.where(np.isfinite(var_along) & (var_along > 0.0), var_along, _SIGMA_UNKNOWN_PX**2))
    sigma_across = np.sqrt(np.where(np.isfinite(var_across) & (var_across > 0.0), var_across, _SIGMA_UNKNOWN_PX**2))
    return np.maximum(sigma_along, half_width), sigma_across


def end_epochs_s(
    row_open: NDArray[np.float64],
    row_close: NDArray[np.float64],
    start_s: NDArray[np.float64],
    exposure_s: NDArray[np.float64],
    line_time_s: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Epochs at which the object was where its row's shutter opened and closed on it (s, same zero as `start_s`)."""
    return start_s + line_time_s * row_open, start_s + exposure_s + line_time_s * row_close


def nodes_of(table: StreakTable, frames: FrameTable, sigma_floor_px: float) -> Nodes:
    """Both hypotheses of every streak, with the density of chance streaks in its frame.

    sigma_floor_px : added in quadrature to the fits' errors; pointing and motion model are not perfect.
    """
    n = len(table.frame)
    count = np.zeros((2, len(frames.number)))
    np.add.at(count, (((table.flags & StreakFlag.VETOED) != 0).astype(np.int64), table.frame), 1.0)
    columns: dict[str, NDArray[Any]] = {}
    for low in range(0, max(n, 1), _BLOCK):
        part = StreakTable._make(column[low : low + _BLOCK] for column in table)
        made = _hypotheses(part, frames, count, sigma_floor_px)
        if not columns:
            columns = {name: np.empty((2 * n, *values.shape[1:]), dtype=values.dtype) for name, values in made.items()}
        for name, values in made.items():
            columns[name][2 * low : 2 * low + len(values)] = values
    spread = table.unit[:, 1].std(axis=0) if n else np.zeros(3)
    axis = int(np.argmax(spread))
    key = np.repeat(table.unit[:, 1, axis], 2)
    order = np.lexsort((key, columns["frame"]))
    first = np.searchsorted(columns["frame"][order], np.arange(len(frames.number) + 1))
    return Nodes(**columns, order=order, sorted_key=np.ascontiguousarray(key[order]), first=first.astype(np.int64), axis=axis)


def _hypotheses(
    table: StreakTable, frames: FrameTable, count: NDArray[np.float64], sigma_floor_px: float
) -> dict[str, NDArray[Any]]:
    """The columns of `Nodes` for some streaks. count : (2, frames) streaks of each frame that passed the vetter, and others."""
    n = len(table.frame)
    frame = np.repeat(table.frame, 2)
    row_open, row_close = table.row[:, [0, 2]].ravel(), table.row[:, [2, 0]].ravel()
    start, exposure, line = frames.start_s[frame], frames.exposure_s[frame], frames.line_time_s[frame]
    t_open, t_close = end_epochs_s(row_open, row_close, start, exposure, line)
    swap = t_close < t_open
    turned = np.repeat(table.turn_rad_s, 2, axis=0) * (0.5 * exposure)[:, None]
    unit_open = turn(table.unit[:, [0, 2]].reshape(-1, 3), -turned)
    unit_close = turn(table.unit[:, [2, 0]].reshape(-1, 3), turned)
    sigma_open, sigma_close = table.sigma_along_rad.ravel(), table.sigma_along_rad[:, ::-1].ravel()
    flags = np.repeat(table.flags, 2)
    edge0, edge1 = (flags & StreakFlag.EDGE0) != 0, (flags & StreakFlag.EDGE1) != 0
    second = np.arange(2 * n) % 2 == 1
    cut_open, cut_close = np.where(second, edge1, edge0), np.where(second, edge0, edge1)
    cut_a, cut_b = np.where(swap, cut_close, cut_open), np.where(swap, cut_open, cut_close)
    kind = np.select([cut_a & cut_b, cut_a, cut_b], [CROSSING, ENTERING, LEAVING], FULL)
    point = (flags & StreakFlag.POINT_LIKE) != 0
    # A point has no direction, so one hypothesis is enough. The other is excluded by the kind CROSSING.
    kind = np.where(point, np.where(second, CROSSING, POINT), kind)

    t_s = np.stack([np.where(swap, t_close, t_open), np.where(swap, t_open, t_close)], axis=1)
    unit = np.stack([np.where(swap[:, None], unit_close, unit_open), np.where(swap[:, None], unit_open, unit_close)], axis=1)
    sigma = np.stack([np.where(swap, sigma_close, sigma_open), np.where(swap, sigma_open, sigma_close)], axis=1)
    length = np.linalg.norm(unit[:, 1] - unit[:, 0], axis=1)
    duration = t_s[:, 1] - t_s[:, 0]
    scale = np.repeat(table.scale_rad_px, 2)
    middle = np.repeat(table.unit[:, 1], 2, axis=0)
    t_s[point] = (start + 0.5 * exposure + line * np.repeat(table.row[:, 1], 2))[point, None]
    unit[point] = middle[point][:, None, :]
    cross = np.repeat(table.sigma_cross_rad, 2)
    sigma[point] = np.maximum(sigma, cross[:, None])[point]
    measured = np.column_stack([sigma, cross])
    # No time passes between the ends, so the speed is unknown.
    kind = np.where(~point & (duration < 1e-3 * exposure), CROSSING, kind)
    fastest = np.where(point, (length + 3.0 * scale) / np.maximum(exposure, 1e-9), np.inf)

    area = scale**2 * np.prod(frames.shape, axis=1)[frame]
    vetoed = (flags & StreakFlag.VETOED) != 0
    # Chance streaks are counted separately: thousands may be rejected by the vetter, and tens accepted.
    crowd = count[vetoed.astype(np.int64), frame]
    octaves = np.log(2.0 * np.hypot(*frames.shape.T))[frame]
    # chance streaks: uniform over the frame, in direction and in log length; in the coordinates of the fit's residuals
    direction = np.log(2.0 * np.pi * np.maximum(length, scale))
    vector = direction + np.log(np.maximum(length, scale) * octaves)
    log_clutter = np.log(crowd / area) - np.select([kind == FULL, kind == POINT], [vector, 0.0], direction)

    return {
        "frame": frame,
        "kind": kind.astype(np.int8),
        "t_s": t_s,
        "unit": unit,
        "sigma_rad": np.hypot(measured, sigma_floor_px * scale[:, None]),
        "measured_rad": measured,
        "vetoed": vetoed,
        "length_rad": length,
        "duration_s": duration,
        "fastest_rad_s": fastest,
        "log_clutter": log_clutter,
        "log_odds": np.repeat(table.log_odds, 2),
    }
