"""`population.ecsv`: flux of debris by size per km^2 and year, from what came down and the camera's calibration alone."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from astropy.table import Column, Table
from numpy.typing import NDArray

from ground.ingest.assembly import is_of_track_only
from ground.orbit.size import sun_direction
from ground.population.encounters import SLOWEST_DEG_S, Watch
from ground.population.flux import (
    ALBEDO,
    ALBEDO_SIGMA_LN,
    COULD_BE_SEEN_SNR,
    SIZE_EDGES_M,
    Counted,
    Flux,
    counted_of,
    flux_of,
)
from ground.population.injection import (
    LENGTHS_PX,
    SNR_GRID,
    Efficiency,
    images_of,
    measured_efficiency,
    robust_sigma,
    threshold_of,
)
from ground.records import GroundProducts
from ground.sky.rotation import matrix_of
from ground.streaks.trail_model import PIXEL_VARIANCE_PX2
from sboc_e2e.icd.camera import CameraModel
from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.flags import FrameFlag, StreakFlag
from sboc_e2e.icd.frame import FrameHeader, NominalCamera
from sboc_e2e.icd.products import FrameSolution, Tracklet
from sboc_e2e.icd.version import CONTRACT_VERSION

_Own = tuple[NDArray[np.int64], NDArray[np.int64]]
"""Frames and streaks of a tracklet that were found in single frames."""

SEED: Final = 20270129
"""Any number: fixed, so that the same products always give the same flux."""

COLUMNS: Final = (
    ("from_m", "m", "smallest diameter of the class"),
    ("to_m", "m", "largest diameter"),
    ("n_tracklets", None, "tracklets by estimated size, false ones not subtracted"),
    ("false_expected", None, "of these, false ones by their own probabilities"),
    ("efficiency", None, "share of the visible crossings that give a tracklet"),
    ("exposure_km2_year", "km2 yr", "area watched x time x efficiency, for objects of the class"),
    ("range_km", "km", "within which 90 % of the objects found would be"),
    ("flux_low", "1 / (km2 yr)", "5 % point of the flux of the class, counting errors"),
    ("flux", "1 / (km2 yr)", "median"),
    ("flux_high", "1 / (km2 yr)", "95 % point"),
    ("flux_total_low", "1 / (km2 yr)", "5 % point, systematic term included"),
    ("flux_total_high", "1 / (km2 yr)", "95 % point, systematic term included"),
    ("larger_low", "1 / (km2 yr)", "5 % point of the flux of objects larger than from_m, counting errors"),
    ("larger", "1 / (km2 yr)", "median"),
    ("larger_high", "1 / (km2 yr)", "95 % point"),
    ("larger_total_low", "1 / (km2 yr)", "5 % point, systematic term included"),
    ("larger_total_high", "1 / (km2 yr)", "95 % point, systematic term included"),
    ("systematic_ln", None, "one sigma of ln(larger): albedo, phase function, orbits, response; the same error in all rows"),
)
WORDS: Final = (
    "flux: density times relative speed at the camera, of objects in low orbits that move at "
    f"{SLOWEST_DEG_S:g} deg/s or more; counted: tracklets that the detector found in two single frames or more; "
    "exposure: sunlit places in sight, prior orbits of catalogued fragments "
    f"with break-up velocities, Lambert spheres of albedo {ALBEDO:g} with a scatter of {ALBEDO_SIGMA_LN:g} in ln, crossings that "
    f"reach S/N {COULD_BE_SEEN_SNR:g}; share of finds kept by fit, vetting and linking: "
    "from gaps of tracklets; 90 % intervals of the posterior"
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Population:
    """What a run says of the population. flux None where it says nothing; lacks : what is missing and what follows from that."""

    flux: Flux | None
    efficiency: Efficiency | None
    counted: Counted | None
    watch: Watch | None
    lacks: tuple[str, ...]


def population(products: GroundProducts, frames: Sequence[DownlinkFrame], camera: NominalCamera) -> Population:
    """The flux of a run. camera : nominal, of whole frames."""
    lacks: list[str] = []
    watch = _watch(products, frames, camera, lacks)
    if watch is None:
        return Population(flux=None, efficiency=None, counted=None, watch=None, lacks=tuple(lacks))
    rng = np.random.default_rng(SEED)
    images, kind = images_of(frames, camera.gain_e_adu)
    if not images:
        lacks.append("neither whole frames nor background meshes came down: no efficiency, no flux")
        return Population(flux=None, efficiency=None, counted=None, watch=watch, lacks=tuple(lacks))
    if kind != "whole frames":
        lacks.append("no whole frame came down: efficiency is that of noise by the background mesh, without stars and hits")
    threshold = threshold_of(frames)
    if threshold[1] == 0:
        lacks.append(f"no region tells the detector's threshold: {threshold[0]:g} is assumed")
    efficiency = measured_efficiency(images, kind, threshold, watch.psf_sigma_px, rng)
    counted = _counted(products, efficiency)
    flux = flux_of(counted, watch, efficiency, rng)
    if not flux.exposure_km2_year.any():
        lacks.append("no object could be seen (light of the Sun, noise): no exposure, no flux")
    elif not counted.size_m.size:
        lacks.append("no tracklet: fluxes are upper limits")
    return Population(
        flux=flux,
        efficiency=efficiency,
        counted=counted,
        watch=watch,
        lacks=tuple(lacks),
    )


def population_table(found: Population) -> Table:
    """One row for each class of diameters; what is lacking and how it was made in the metadata."""
    k = len(SIZE_EDGES_M) - 1
    nan = np.full(k, np.nan)
    flux = found.flux
    columns: list[Any] = [np.array(SIZE_EDGES_M[:-1]), np.array(SIZE_EDGES_M[1:])]
    if flux is None:
        columns += [np.zeros(k, dtype=np.int64), *[nan] * 15]
    else:
        columns += [flux.n_tracklets, flux.false_expected, flux.efficiency, flux.exposure_km2_year, flux.range_km]
        columns += [*flux.flux.T, flux.total[:, 0], flux.total[:, 2]]
        columns += [*flux.flux_larger.T, flux.total_larger[:, 0], flux.total_larger[:, 2], flux.systematic_ln]
    made = [Column(v, name=name, unit=unit, description=text) for v, (name, unit, text) in zip(columns, COLUMNS, strict=True)]
    meta: dict[str, Any] = {"table": "population", "contract_version": CONTRACT_VERSION, "definition": WORDS}
    meta["lacks"] = "; ".join(found.lacks)
    if found.watch is not None:
        meta["watched_s"] = round(found.watch.span_s, 6)
        meta["frames_used"] = len(found.watch.t_s)
    if flux is not None:
        meta["systematic_terms_ln"] = json.dumps(
            {name: [round(float(v), 4) for v in values] for name, values in flux.terms_ln.items()}
        )
    if found.counted is not None:
        counted = found.counted
        meta["tracklets_too_slow"] = counted.n_slow
        meta["tracklets_of_tracks_only"] = counted.n_tracked
        meta["tracklets_without_size"] = int(np.isnan(counted.size_m).sum())
        meta["single_frame_detections"] = counted.n_single
        meta["single_frame_false_expected"] = round(counted.n_single_false, 4)
        meta["streaks_vetoed"] = counted.n_vetoed
        meta["frames_kept"] = round(counted.kept[0], 4)
        meta["frames_kept_sigma_ln"] = round(counted.kept[1], 4)
        meta["frames_between_ends"] = json.dumps([round(counted.frames_seen, 2), round(counted.frames_expected, 2)])
    if found.efficiency is not None:
        meta |= _injection_meta(found.efficiency)
    return Table(made, meta=meta)


def _injection_meta(efficiency: Efficiency) -> dict[str, Any]:
    """What was injected into what, how much of it was found, and what the filter says where nothing was."""
    control = efficiency.control
    return {
        "injected_into": efficiency.images,
        "injection_images": efficiency.n_images,
        "threshold_snr": round(efficiency.threshold, 4),
        "threshold_from_detections": efficiency.n_threshold,
        "injection_snr": json.dumps(SNR_GRID),
        "injection_length_px": json.dumps(efficiency.lengths_px or LENGTHS_PX),
        "injection_tried": json.dumps(efficiency.tried.tolist()),
        "injection_found": json.dumps(efficiency.found.tolist()),
        "control_trials": len(control),
        "control_above_threshold": int((control > efficiency.threshold).sum()),
        "control_sigma": round(robust_sigma(control), 4),
    }


def _watch(products: GroundProducts, frames: Sequence[DownlinkFrame], camera: NominalCamera, lacks: list[str]) -> Watch | None:
    """What was watched; None with the reason in `lacks`."""
    headers = products.headers
    if len(headers) < 2:
        lacks.append(f"{len(headers)} frame: tracklets and the time watched need two")
        return None
    placed = [(h, a, s.camera) for h, s in zip(headers, products.solutions, strict=True) if (a := _attitude(h, s)) is not None]
    if len(placed) < len(headers):
        lacks.append(f"{len(headers) - len(placed)} of {len(headers)} frames without a direction: their time is not counted")
    known = [entry for entry in placed if entry[0].observer is not None]
    if placed and len(known) < len(placed):
        lacks.append(
            f"{len(placed) - len(known)} of {len(placed)} frames without the observer's state: their time is not counted"
        )
    if len(known) < 2:
        lacks.append("fewer than two frames with direction and observer: no exposure, no flux")
        return None
    zero_points = [p.zero_point_mag for p in products.photometry if np.isfinite(p.zero_point_mag)]
    if not zero_points and camera.zero_point_e_s is None:
        lacks.append("no zero point: no brightness of an object, no flux")
        return None
    if not zero_points:
        lacks.append("no zero point was measured: the camera's nominal one is used")
        zero_points = [2.5 * float(np.log10(camera.zero_point_e_s or 1.0))]
    noise = [_noise_e(frame, camera) for frame in frames if frame.background is not None]
    if not noise:
        lacks.append("no background mesh: no noise, no flux")
        return None
    psf = [frame.psf_sigma_px for frame in frames if frame.psf_sigma_px is not None] or [camera.psf_sigma_px]
    t_ns = np.array([h.t_start_tai_ns + h.exposure_ns // 2 for h, *_ in known], dtype=np.int64)
    first, _, solved = known[0]
    mid_row, mid_col = _middle_of_field(first, solved)
    return Watch(
        t_s=(t_ns - t_ns[0]) * 1e-9,
        position_km=np.array([h.observer.position_m for h, *_ in known if h.observer is not None]) * 1e-3,
        velocity_km_s=np.array([h.observer.velocity_m_s for h, *_ in known if h.observer is not None]) * 1e-3,
        attitude=np.array([a for _, a, _ in known]),
        sun=sun_direction(int(t_ns[len(t_ns) // 2])),
        half_row=0.5 * first.rows / camera.focal_px,
        half_col=0.5 * first.cols / camera.focal_px,
        mid_row=mid_row,
        mid_col=mid_col,
        focal_px=camera.focal_px,
        exposure_s=first.exposure_ns * 1e-9,
        frame_s=float(np.median(np.diff(t_ns))) * 1e-9,
        zero_point_mag=float(np.median(zero_points)),
        noise_e=float(np.median(noise)),
        psf_sigma_px=float(np.sqrt(np.median(psf) ** 2 + PIXEL_VARIANCE_PX2)),
        aperture_m=camera.aperture_m,
    )


def _middle_of_field(header: FrameHeader, camera: CameraModel) -> tuple[float, float]:
    """Tangents of the middle of a frame along rows and columns: 0 at the boresight."""
    x, y, z = camera.unproject(np.array([0.5 * (header.rows - 1)]), np.array([0.5 * (header.cols - 1)]))[0]
    return float(y / z), float(x / z)


def _attitude(header: FrameHeader, solution: FrameSolution) -> np.ndarray[Any, np.dtype[np.float64]] | None:
    """GCRS to camera (3, 3): solved from stars, or as telemetered."""
    if not solution.flags & FrameFlag.NO_SOLUTION:
        return np.asarray(matrix_of(np.asarray(solution.quaternion)))
    return None if header.attitude is None else np.asarray(matrix_of(np.asarray(header.attitude.quaternion)))


def _noise_e(frame: DownlinkFrame, camera: NominalCamera) -> float:
    gain = frame.header.gain_e_adu or camera.gain_e_adu
    return float(np.nanmedian(frame.background.sigma_adu)) * gain if frame.background is not None else float("nan")


def _gaps(products: GroundProducts, efficiency: Efficiency, own: Sequence[_Own]) -> list[tuple[float, float]]:
    """Frames between the ends of each tracklet: those with a member, and those in which the filter would have found it.

    own : of each tracklet. Members that only an on-board track found are no finds of the filter: they neither count as members
    nor end a tracklet.
    """
    numbers = np.array([h.frame for h in products.headers])
    streaks = {s.streak_id: s for s in products.streaks}
    out = []
    for tracklet, (frames, streak_ids) in zip(products.tracklets, own, strict=True):
        members = [streaks[i] for i in streak_ids.tolist() if i in streaks]
        if len(frames) < 2 or not members or tracklet.rate_deg_s < SLOWEST_DEG_S:
            continue
        between = int(((numbers > frames[0]) & (numbers < frames[-1])).sum())
        snr, length = (
            np.array([float(np.median(v))]) for v in ([m.fit.snr for m in members], [m.fit.length_px for m in members])
        )
        out.append((float(len(frames) - 2), between * float(efficiency.share(snr, length)[0])))
    return out


def _own(tracklet: Tracklet, tracked: NDArray[np.int64]) -> _Own:
    """Frames in which the detector itself found the object, and the streaks. tracked : streaks that only tracks found."""
    own = ~np.isin(tracklet.streak_ids, tracked)
    return np.unique(tracklet.frames[own]), tracklet.streak_ids[own]


def _counted(products: GroundProducts, efficiency: Efficiency) -> Counted:
    """Tracklets with their sizes, detections of single frames, and what was missed between.

    Injection measures what the detector finds in single frames, two of which make a tracklet. So only those are counted that it
    found in two frames, with or without a tracker.
    """
    orbits = {o.tracklet_id: o for o in products.orbits if o.converged}
    linked = {t.tracklet_id for t in products.tracklets if len(np.unique(t.frames)) > 1}
    singles, tracked, vetoed = [], [], 0
    for streak in products.streaks:
        if is_of_track_only(streak.roi_id):
            tracked.append(streak.streak_id)
        if streak.flags & StreakFlag.VETOED:
            vetoed += 1
        elif streak.tracklet_id not in linked:  # a tracklet of pieces in one frame has no second frame either
            singles.append(streak.probability)
    of_tracks = np.array(tracked, dtype=np.int64)
    own = [_own(tracklet, of_tracks) for tracklet in products.tracklets]
    sizes = [
        (float(orbits[t.tracklet_id].size_m[1]) if t.tracklet_id in orbits else float("nan"), t.probability, t.rate_deg_s)
        for t, (frames, _) in zip(products.tracklets, own, strict=True)
        if len(frames) > 1
    ]
    n_tracked = len(linked) - len(sizes)
    ranges = [(float(o.range_km[0]), float(o.range_km[2])) for o in orbits.values()]
    return counted_of(sizes, ranges, singles, vetoed, _gaps(products, efficiency, own), n_tracked)
