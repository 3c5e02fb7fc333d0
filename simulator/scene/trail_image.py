"""A moving object of one frame: its light on the image, and its row of the truth table."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from sboc_e2e import truth
from simulator.camera import Camera
from simulator.exposure import render_trail, render_trail_table
from simulator.exposure.halos import reach_px, render_halos
from simulator.optics.psf_field import HALF_PX, LARGEST_DISC_PX
from simulator.platform.earth import LIGHT_KM_S
from simulator.platform.line_of_sight import LineOfSight
from simulator.scene.aberration import aberrate
from simulator.scene.atmosphere import Atmosphere
from simulator.scene.crossing import Interval, Place, RowShutter, arc_length_px, exposed_intervals, time_bins
from simulator.scene.light import LightOptions
from simulator.scene.objects import PixelPathObject, SkyObject
from simulator.scene.reflection import FLASH_REACH, LightCurve
from simulator.scene.stars import angles_deg
from simulator.scene.turbulence import Unsteadiness

Array = NDArray[np.float64]

STEP_PX = 0.45  # longest bin of a trail (ripple: `exposure.trails`)
BLOCK_PX = 96
"""Trails are added to the image in blocks along their path, so that memory and time grow with length, not with area."""
HALO_BINS = 4  # bins that share a halo, 1.8 px: seen from 7 px and more they are one
HALO_FARTHEST_PX = 120.0
"""A trail's halo is drawn no farther from it; there it is 3e-4 of what it is at 7 px."""
FEW_FLASHES = 64  # so many are drawn finely even where bins are fewer; a budget of time, chosen, not measured
FAINTEST_E = 1e-3  # light of the trail from which a full pixel counts as saturated by it; far below the noise
OUTSIDE_MARGIN_RAD = 5e-3
"""Beyond the corner of the field: refraction, defocus and jitter reach no farther."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Path:
    """A mover during one frame. Functions of time (n,), seconds after the epoch of the run.

    place : rows and cols of the read-out window. steady_v0 : brightness in units of a V = 0 star, without the light curve.
    apparent, published : (n, 3) unit directions, GCRS axes. range_km : distance.
    turbulence : what the air of a site does to the light on the way; place and flux_v0, and so the truth, are without it.
    from_s, to_s : when its light arrives at all.
    """

    place: Place
    steady_v0: Callable[[Array], Array]
    light_curve: LightCurve
    apparent: Callable[[Array], Array]
    published: Callable[[Array], Array]
    range_km: Callable[[Array], Array]
    turbulence: Unsteadiness | None = None
    from_s: float = -np.inf
    to_s: float = np.inf

    def flux_v0(self, time_s: Array) -> Array:
        """Brightness at times, in units of a V = 0 star."""
        return np.asarray(self.steady_v0(time_s) * self.light_curve.factor(time_s))

    def shown(self, sight: LineOfSight) -> tuple[float, float]:
        """When it is there among the nodes of a frame; the first is not before the second where it is not."""
        return max(self.from_s, float(sight.node_s[0])), min(self.to_s, float(sight.node_s[-1]))

    def mean_flux_v0(self, start_s: Array, end_s: Array) -> Array:
        """Mean brightness between pairs of times; the light curve is integrated exactly, the rest changes slowly."""
        return np.asarray(self.steady_v0(0.5 * (start_s + end_s)) * self.light_curve.mean_factor(start_s, end_s))


def sky_path_of(
    thing: SkyObject,
    sight: LineOfSight,
    camera: Camera,
    sun_km: Array,
    effects: LightOptions,
    air: Atmosphere | None,
    turbulence: Unsteadiness | None = None,
) -> Path | None:
    """The path of an object with directions: splines of its apparent vector through the nodes of the frame.

    The vector (direction times range) of unaccelerated motion is linear in time, so that splines lose nothing even where the
    direction turns fast. Aberration is that of the observer's geocentric velocity: the Earth's own cancels for what moves
    with the Earth. Extinction and clouds are those of the object's own direction. None for an object far outside the field, or
    that is not there during the frame.
    """
    seen = thing.seen(sight.node_s, sight.observer_km, sun_km, effects)
    distance = np.linalg.norm(seen.vector_km, axis=-1, keepdims=True)
    delay_s = distance[:, 0] / LIGHT_KM_S if effects.light_time else np.zeros(len(distance))
    first_s, last_s = (t + float(np.interp(t, sight.node_s, delay_s)) for t in (thing.from_s, thing.to_s))
    if first_s >= sight.node_s[-1] or last_s <= sight.node_s[0]:
        return None
    outside = seen.vector_km / distance
    if effects.orbital_aberration:
        outside = aberrate(outside, sight.velocity_km_s)
    if _stays_outside(sight.to_camera(sight.node_s, outside), camera):
        return None
    published = CubicSpline(sight.node_s, seen.vector_km)
    apparent = CubicSpline(sight.node_s, distance * outside)
    lifted = apparent if air is None else CubicSpline(sight.node_s, distance * air.refracted(outside, distance[:, 0]))
    dimming = 1.0 if air is None else air.transmission(outside)
    at_1_km = CubicSpline(sight.node_s, dimming * seen.flux * distance[:, 0] ** 2)

    def unit(vectors: Array) -> Array:
        return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))

    def place(time_s: Array) -> tuple[Array, Array]:
        return camera.projection.to_pixels(sight.to_camera(time_s, lifted(time_s)))

    def range_km(time_s: Array) -> Array:
        return np.asarray(np.linalg.norm(published(time_s), axis=-1))

    def steady_v0(time_s: Array) -> Array:
        return np.asarray(np.maximum(at_1_km(time_s), 0.0) / range_km(time_s) ** 2)

    return Path(
        place=place,
        steady_v0=steady_v0,
        light_curve=thing.light_curve,
        apparent=lambda time_s: unit(apparent(time_s)),
        published=lambda time_s: unit(published(time_s)),
        range_km=range_km,
        turbulence=turbulence,
        from_s=first_s,
        to_s=last_s,
    )


def _stays_outside(directions: Array, camera: Camera) -> bool:
    """Whether unit directions (k, 3) of the camera frame, at the nodes of a frame, and what joins them avoid the field."""
    from_centre = np.arccos(np.clip(directions @ camera.direction(0.0, 0.0), -1.0, 1.0))
    step = np.linalg.norm(np.diff(directions, axis=0), axis=1).max()
    return bool(from_centre.min() - 1.6 * step > camera.radius_rad + OUTSIDE_MARGIN_RAD)


def pixel_path_of(
    thing: PixelPathObject,
    sight: LineOfSight,
    camera: Camera,
    zero_s: float,
    effects: LightOptions,
    turbulence: Unsteadiness | None = None,
) -> Path:
    """The path of an object that is given in delivered pixels; its directions follow from the camera.

    zero_s : where its time starts, seconds after the epoch of the run.
    """

    def place(time_s: Array) -> tuple[Array, Array]:
        row, col, _ = thing.place(time_s - zero_s)
        return camera.undelivered(row, col)

    def apparent(time_s: Array) -> Array:
        return sight.to_gcrs(time_s, camera.projection.to_vectors(*place(time_s)))

    def published(time_s: Array) -> Array:
        velocity_km_s = sight.observer_at(time_s)[1]
        return aberrate(apparent(time_s), -velocity_km_s) if effects.orbital_aberration else apparent(time_s)

    return Path(
        place=place,
        steady_v0=lambda time_s: thing.place(time_s - zero_s)[2],
        light_curve=thing.light_curve,
        apparent=apparent,
        published=published,
        range_km=lambda time_s: np.full(np.shape(time_s), np.inf),
        turbulence=turbulence,
    )


def add_trail(
    image_e: NDArray[np.float32],
    path: Path,
    sight: LineOfSight,
    shutter: RowShutter,
    camera: Camera,
    *,
    epoch_tai_ns: int,
) -> NDArray[np.void]:
    """Add a mover's light to the image; its rows of the truth, numbers of frame and object left open (none if unseen)."""
    blur_px = float(camera.defocus_px(path.range_km(np.array([sight.reference_s])))[0])
    margin_px = 6.0 * float(camera.sigma_at(np.zeros(1), np.zeros(1))[0]) + 0.5 * blur_px + 1.0
    lit = exposed_intervals(path.place, shutter, margin_px, *path.shown(sight))
    rows: list[NDArray[np.void]] = []
    for stretch in lit:
        inner = exposed_intervals(path.place, shutter, 0.5, stretch.start_s, stretch.end_s)
        drawn = _render(image_e, path, stretch, camera)
        if inner and drawn.flux_e > 0.0:
            kept = max(inner, key=lambda i: i.end_s - i.start_s)
            edges = Interval(
                start_s=kept.start_s,
                end_s=kept.end_s,
                edge_start=kept.start_s > stretch.start_s + 1e-9 or stretch.edge_start,
                edge_end=kept.end_s < stretch.end_s - 1e-9 or stretch.edge_end,
            )
            row = _truth_row(path, sight, edges, camera, drawn, epoch_tai_ns)
            rows.append(row)
    return np.concatenate(rows) if rows else truth.empty("streaks")


@dataclass(frozen=True, kw_only=True)
class _Light:
    flux_e: float
    snr: float
    n_saturated: int
    sigma_px: float
    defocus_px: float


def _render(image_e: NDArray[np.float32], path: Path, stretch: Interval, camera: Camera) -> _Light:
    """Integrate over bins of time, block by block along the path."""
    longest_bin_s = np.inf if path.turbulence is None else path.turbulence.step_s
    edges_s = _with_flashes(time_bins(path.place, stretch, STEP_PX, longest_bin_s), path.light_curve)
    time_s, width_s = 0.5 * (edges_s[1:] + edges_s[:-1]), np.diff(edges_s)
    row, col = path.place(time_s)
    flux_e = path.mean_flux_v0(edges_s[:-1], edges_s[1:]) * camera.illumination_at(row, col) * (camera.zero_point_e_s * width_s)
    blur_px = camera.defocus_px(path.range_km(time_s))
    sigma_px = camera.sigma_at(row, col)
    seen_sigma_px = sigma_px
    if path.turbulence is not None:
        factor, row_rad, col_rad = path.turbulence.at(time_s)
        focal_px = camera.projection.focal_px
        row, col, flux_e = row + focal_px * row_rad, col + focal_px * col_rad, flux_e * factor
        sigma_px = np.sqrt(np.maximum(sigma_px**2 - (focal_px * path.turbulence.tilt_sigma_rad) ** 2, (0.2 * sigma_px) ** 2))
    field, halo_px, extra_px2 = camera.psf_field, 0.0, sigma_px**2 - seen_sigma_px**2
    if field is not None:
        brightest_e_px = float((flux_e / np.maximum(_steps_px(row, col), 0.1)).max())
        halo_px = min(max(reach_px(field.halo, brightest_e_px), HALF_PX + 1.0), HALO_FARTHEST_PX)
    per_block = max(int(BLOCK_PX / STEP_PX), 1)
    boxes = []
    for block in [np.s_[k : k + per_block] for k in range(0, len(time_s), per_block)]:
        sigma, blur = float(sigma_px[block].mean()), float(blur_px[block].mean())
        margin = int(np.ceil(max(6.5 * sigma + 0.5 * blur + 2.0, halo_px)))
        first_row, last_row = _aligned(row[block], margin, camera.binning.rows, camera.shape[0])
        first_col, last_col = _aligned(col[block], margin, camera.binning.cols, camera.shape[1])
        if first_row < last_row and first_col < last_col:
            boxes.append((block, sigma, blur, (first_row, last_row, first_col, last_col)))
    # Light of the trail alone, from its first pixel to its last; the system gives memory only to what is written.
    top, left = (min((b[-1][k] for b in boxes), default=0) for k in (0, 2))
    bottom, right = (max((b[-1][k] for b in boxes), default=0) for k in (1, 3))
    trail_e = np.zeros((bottom - top, right - left), dtype=np.float32)
    for block, sigma, blur, (first_row, last_row, first_col, last_col) in boxes:
        place = row[block] - first_row, col[block] - first_col
        light = trail_e[first_row - top : last_row - top, first_col - left : last_col - left]
        if field is None or blur > LARGEST_DISC_PX:
            render_trail(light, *place, flux_e[block], sigma, blur, camera.instrument.obstruction)
        else:
            middle = len(time_s[block]) // 2
            node = int(field.node(row[block][middle : middle + 1], col[block][middle : middle + 1])[0])
            render_trail_table(light, *place, flux_e[block], field.at(node, float(extra_px2[block].mean()), blur))
        if field is not None and halo_px > HALF_PX + 1.0:
            axis = camera.projection.center_row - first_row, camera.projection.center_col - first_col
            render_halos(light, *_joined(*place, flux_e[block]), field.halo, axis)
    total, snr2, saturated = 0.0, 0.0, 0
    for _, _, _, (first_row, last_row, first_col, last_col) in boxes:
        box = np.s_[first_row:last_row, first_col:last_col]
        light = trail_e[first_row - top : last_row - top, first_col - left : last_col - left]
        variance = camera.variance_e2(image_e[box], first_row, first_col)
        signal, noise2 = camera.binned(light), camera.binned(variance)
        total += float(light.sum(dtype=np.float64))
        snr2 += float((signal.astype(np.float64) ** 2 / noise2).sum())
        image_e[box] += light
        saturated += int(((light > FAINTEST_E) & (image_e[box] > camera.saturation_e)).sum())
        light[...] = 0.0
    middle = len(time_s) // 2
    return _Light(
        flux_e=total,
        snr=float(np.sqrt(snr2)),
        n_saturated=saturated,
        sigma_px=float(seen_sigma_px[middle]),
        defocus_px=float(blur_px[middle]),
    )


def _steps_px(row: Array, col: Array) -> Array:
    """Length of path (n,) that each bin stands for."""
    if len(row) < 2:
        return np.ones(len(row))
    step = np.hypot(np.diff(row), np.diff(col))
    return np.asarray(0.5 * (np.concatenate([step[:1], step]) + np.concatenate([step, step[-1:]])))


def _joined(row: Array, col: Array, flux_e: Array) -> tuple[Array, Array, Array]:
    """Every few bins as one: what is far from a trail does not see them apart."""
    first = np.arange(0, len(row), HALO_BINS)
    total = np.add.reduceat(flux_e, first)
    weight = np.where(total > 0.0, total, 1.0)
    return np.add.reduceat(row * flux_e, first) / weight, np.add.reduceat(col * flux_e, first) / weight, total


def _with_flashes(edges_s: Array, curve: LightCurve) -> Array:
    """Edges of bins with finer ones where a flash is shorter than a bin, so that its light falls where it should.

    Only where flashes are fewer than bins, or few: the cost grows as the number of bins does.
    """
    bins = len(edges_s) - 1
    span_s = float(edges_s[-1] - edges_s[0])
    many = span_s > curve.period_s * max(bins, FEW_FLASHES)
    if curve.glint_factor == 0.0 or many or curve.glint_width_s * bins > 2.0 * span_s:
        return edges_s
    steps = np.linspace(-FLASH_REACH, FLASH_REACH, 17) * curve.glint_width_s
    fine_s = (curve.flashes_s(edges_s[0], edges_s[-1])[:, None] + steps).ravel()
    return np.unique(np.concatenate([edges_s, fine_s[(fine_s > edges_s[0]) & (fine_s < edges_s[-1])]]))


def _aligned(centre: Array, margin: int, step: int, size: int) -> tuple[int, int]:
    """First and last-plus-one pixel around positions, on borders of delivered pixels, inside the frame."""
    first = max(0, int(np.floor(centre.min())) - margin) // step * step
    last = min(size, -(-(int(np.ceil(centre.max())) + margin + 1) // step) * step)
    return first, last


def _truth_row(
    path: Path, sight: LineOfSight, seen: Interval, camera: Camera, drawn: _Light, epoch_tai_ns: int
) -> NDArray[np.void]:
    """One row of the truth of streaks; positions in delivered pixels."""
    out = truth.empty("streaks", 1)
    time_s = np.linspace(seen.start_s, seen.end_s, truth.PATH_NODES)
    window_row, window_col = path.place(time_s)

    row, col = camera.delivered(window_row, window_col)
    tai = epoch_tai_ns + np.round(time_s * 1e9).astype(np.int64)
    # Means over the nodes' shares of time, so that the trapezoidal rule gives the whole light whatever flashed between them.
    half_s = 0.5 * (time_s[1] - time_s[0])
    shares = np.maximum(time_s - half_s, seen.start_s), np.minimum(time_s + half_s, seen.end_s)
    flux_rate = path.mean_flux_v0(*shares) * camera.illumination_at(window_row, window_col) * camera.zero_point_e_s
    middle = np.array([0.5 * (seen.start_s + seen.end_s)])
    step = np.array([0.25 * (seen.end_s - seen.start_s)])
    around = np.concatenate([middle - step, middle + step])
    seen_at = sight.to_camera(around, path.apparent(around))
    angle = np.arctan2(np.linalg.norm(np.cross(seen_at[0], seen_at[1])), seen_at[0] @ seen_at[1])
    drow, dcol = row[-1] - row[0], col[-1] - col[0]
    chord = np.hypot(drow, dcol)
    mid_row, mid_col = camera.delivered(*path.place(middle))
    off_row, off_col = mid_row[0] - 0.5 * (row[0] + row[-1]), mid_col[0] - 0.5 * (col[0] + col[-1])
    sagitta_px = (off_row * dcol - off_col * drow) / chord if chord > 1e-9 else 0.0
    distance_km = path.range_km(middle)[0]
    ra, dec = angles_deg(path.published(time_s))
    ra_app, dec_app = angles_deg(path.apparent(middle))
    # A uniform disc of diameter d has the variance d^2/16 along each axis, an annulus of obstruction o (1 + o^2) times that.
    disc_sigma_px = 0.25 * drawn.defocus_px * np.sqrt(1.0 + camera.instrument.obstruction**2)
    values = {
        "row0": row[0],
        "col0": col[0],
        "row1": row[-1],
        "col1": col[-1],
        "edge0": seen.edge_start,
        "edge1": seen.edge_end,
        "t0_tai_ns": tai[0],
        "t1_tai_ns": tai[-1],
        "length_px": arc_length_px(chord, sagitta_px),
        "flux_e": drawn.flux_e,
        "snr": drawn.snr,
        "psf_sigma_px": np.hypot(drawn.sigma_px, disc_sigma_px) / camera.binning.cols,
        "defocus_px": drawn.defocus_px / camera.binning.cols,
        "sagitta_px": sagitta_px,
        "gradient": 2.0 * (flux_rate[-1] - flux_rate[0]) / max(flux_rate[-1] + flux_rate[0], 1e-300),
        "rate_deg_s": np.degrees(angle) / (2.0 * step[0]),
        "range_km": distance_km if np.isfinite(distance_km) else np.nan,  # a path over pixels is at no distance
        "mag": -2.5 * np.log10(max(path.flux_v0(middle)[0], 1e-40)),
        "ra_app_deg": ra_app[0],
        "dec_app_deg": dec_app[0],
        "n_saturated": drawn.n_saturated,
        "path_row": row,
        "path_col": col,
        "path_flux_e_s": flux_rate,
        "path_t_tai_ns": tai,
        "path_ra_deg": ra,
        "path_dec_deg": dec,
    }
    for name, value in values.items():
        out[name] = value
    return out
