"""The population product: exposure against the simulator's own encounters, intervals against truth, what is lacking said."""

import math
from dataclasses import replace

import numpy as np
import pytest

from ground.ingest.assembly import FIRST_TRACK_ROI
from ground.population import encounters
from ground.population.encounters import CELL_KM, Watch, _leaves_km, _stay_s, crossings, density_of, farthest_km, trail_snr
from ground.population.flux import ALBEDO, ALBEDO_SIGMA_LN, COULD_BE_SEEN_SNR, SIZE_EDGES_M, counted_of, found_shares, light_seen
from ground.population.injection import (
    DEFAULT_THRESHOLD,
    LENGTHS_PX,
    SNR_GRID,
    Image,
    _under_stars,
    images_of,
    measured_efficiency,
    threshold_of,
)
from ground.products.population import _counted, _watch, population, population_table
from ground.records import GroundProducts
from ground.sky.shadow import before_the_earth
from sboc_e2e.icd.signals import BackgroundModel, RoiGroup
from sboc_e2e.score.population import published_flux
from simulator.scene.debris import SizeClass
from simulator.scene.encounters import PopulationOptions, Window, draw_candidates, natural_flux, natural_numbers
from tests.astrometry.test_faulty_steps import fields as fields
from tests.astrometry.test_ground_chain import chain_of
from tests.population import worlds


@pytest.mark.slow
def test_exposure_is_that_of_the_simulator() -> None:
    """Effective exposure of each class by ground and from the simulator's encounters, each with its integration noise."""
    watch, found = worlds.watch_of(worlds.window()), worlds.efficiency(np.random.default_rng(0), trials=2000)
    rng = np.random.default_rng(1)
    for k, one in enumerate(worlds.classes()):
        drawn = crossings(watch, SIZE_EDGES_M[k : k + 2], 30_000, rng, albedo=ALBEDO, albedo_sigma_ln=ALBEDO_SIGMA_LN)
        ground = float((drawn.weight * found_shares(drawn, found)).sum()) / drawn.flux_km2_s
        assert ground == pytest.approx(worlds.exposure_km2_s(one, rng), rel=0.4 if k == 0 else 0.25)


@pytest.mark.parametrize("mid", [(0.0, 0.0), (0.6, 0.0), (-0.6, 0.2)])
def test_crossings_of_a_window_off_the_boresight_are_those_of_the_simulator(mid: tuple[float, float]) -> None:
    """Objects of 3 to 10 cm, up or down by 31 deg, that reach S/N 5. About the boresight ground has 2.2 and 8 times as many."""
    seen, rng = worlds.window(mid), np.random.default_rng(3)
    edges = (0.03, 0.1)
    drawn = crossings(worlds.watch_of(seen), edges, 60_000, rng, albedo=ALBEDO, albedo_sigma_ln=0.0)
    options = PopulationOptions(candidates=200_000, albedo=ALBEDO, snr_min=1.0, surface=worlds.GREY)
    one = SizeClass(from_mm=30.0, to_mm=100.0, count=1)
    theirs = draw_candidates(options, one, seen, rng)
    bright = drawn.snr.max(axis=1) >= COULD_BE_SEEN_SNR
    theirs_bright = (theirs.snr >= COULD_BE_SEEN_SNR) & (theirs.rate_deg_s >= options.slowest_deg_s)
    ground = float(drawn.weight[bright].sum()) / drawn.flux_km2_s
    simulator = float(theirs.natural[theirs_bright].sum()) / natural_flux(options, one, seen, rng)
    assert ground == pytest.approx(simulator, rel=0.35)


@pytest.mark.parametrize("edges", [(0.1, 0.3), (0.3, 1.0)])
def test_exposure_goes_as_far_as_the_slowest_counted_are(edges: tuple[float, float]) -> None:
    """Crossings that reach S/N 5 per flux, of a simulated sky without end. Out to 3,000 km they are 0.76 and 0.63 of these."""
    ground, simulator = _bright_exposures(worlds.window(), edges)
    assert ground == pytest.approx(simulator, rel=0.15)


def test_nothing_is_exposed_in_the_shadow() -> None:
    """From the middle of the night away from the Sun no object has light: no exposure, and the table says why it has no flux."""
    seen = worlds.window(behind_deg=90.0, earth_shadow=True)
    ground, simulator = _bright_exposures(seen, (0.1, 0.3))
    assert (ground, simulator) == (0.0, pytest.approx(0.0, abs=1e-6))


def test_exposure_ends_where_the_shadow_begins() -> None:
    """17 deg down from the terminator the sight enters the shadow after 2,300 km. Without one 20 times as much is seen."""
    dark = worlds.window((-0.3, 0.0), earth_shadow=True)
    ground, simulator = _bright_exposures(dark, (0.1, 0.3))
    assert ground == pytest.approx(simulator, rel=0.15)


def test_the_earth_hides_what_is_behind_it() -> None:
    """A camera at 7,078 km, and a station on a pole, which lies inside the sphere of the equator's radius and looks up."""
    place = np.array([[7078.0, 0.0, 0.0]] * 4)
    there = np.array([[-7078.0, 0.0, 0.0], [7078.0, 3000.0, 0.0], [6500.0, 0.0, 0.0], [-2000.0, 6378.0, 0.0]])
    assert before_the_earth(there, place).tolist() == [False, True, True, False]
    assert before_the_earth(np.array([[500.0, 0.0, 7000.0]]), np.array([[0.0, 0.0, 6356.8]])).all()


def _bright_exposures(seen: Window, edges: tuple[float, float]) -> tuple[float, float]:
    """Crossings of a class that reach S/N 5 over its flux, by ground and by the simulator."""
    rng = np.random.default_rng(3)
    drawn = crossings(worlds.watch_of(seen), edges, 60_000, rng, albedo=ALBEDO, albedo_sigma_ln=0.0)
    options = PopulationOptions(
        candidates=400_000, albedo=ALBEDO, snr_min=1.0, surface=worlds.GREY, farthest_km=worlds.FARTHEST_KM
    )
    one = SizeClass(from_mm=1e3 * edges[0], to_mm=1e3 * edges[1], count=1)
    theirs = draw_candidates(options, one, seen, rng, even_share=worlds.EVEN_SHARE, over_cells=True)
    bright = drawn.snr.max(axis=1, initial=0.0) >= COULD_BE_SEEN_SNR
    theirs_bright = (theirs.snr >= COULD_BE_SEEN_SNR) & (theirs.rate_deg_s >= options.slowest_deg_s)
    simulator = float(theirs.natural[theirs_bright].sum()) / natural_flux(options, one, seen, rng)
    return float(drawn.weight[bright].sum()) / drawn.flux_km2_s, simulator


def _watch_at(t_s: np.ndarray) -> Watch:
    """A camera that stays where it is, so that every frame has the same sky."""
    seen, n = worlds.window(), len(t_s)
    place, velocity, attitude = (
        np.repeat(x[None], n, axis=0) for x in (seen.observer_km, seen.velocity_km_s, seen.attitude)
    )  # fmt: skip
    return replace(worlds.watch_of(seen), t_s=t_s, position_km=place, velocity_km_s=velocity, attitude=attitude)


def _counted_crossings(watch: Watch) -> float:
    """Expected crossings of 10 to 30 cm that could be seen; candidates are the same for every watch."""
    drawn = crossings(watch, (0.1, 0.3), 60_000, np.random.default_rng(3), albedo=ALBEDO, albedo_sigma_ln=0.0)
    return float(drawn.weight[(drawn.snr.max(axis=1) >= COULD_BE_SEEN_SNR) & (drawn.frames_lit >= 2)].sum())


def test_two_visits_far_apart_count_as_two() -> None:
    """Nothing of 0.1 deg/s or more stays for 200 s in 5 degrees: both together have the crossings of one twice."""
    t = worlds.FRAME_S * np.arange(worlds.FRAMES)
    one = _counted_crossings(_watch_at(t))
    assert _counted_crossings(_watch_at(np.concatenate([t, 200.0 + t]))) == pytest.approx(2.0 * one, rel=0.02)


@pytest.mark.parametrize("lost", [0.1, 0.2, 0.3, 0.6])
def test_frames_lost_inside_a_run_cost_the_crossings_that_they_cost(lost: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Four minutes of frames, some dropped at random, against objects let in one after another at random times.

    Of those of the whole run 1.00, 1.00, 1.00 and 0.98 are left: most stay for seconds. Gaps taken as watched left 1 - lost.
    """
    stays = []

    def noted(camera: np.ndarray, relative: np.ndarray, watch: Watch) -> tuple[np.ndarray, np.ndarray]:
        stays.append(_stay_s(camera, relative, watch))
        return stays[-1]

    t = worlds.FRAME_S * np.arange(960)
    kept = t[np.random.default_rng(8).random(960) >= lost]
    with monkeypatch.context() as patched:
        patched.setattr(encounters, "_stay_s", noted)
        drawn = crossings(_watch_at(t), (0.1, 0.3), 60_000, np.random.default_rng(3), albedo=ALBEDO, albedo_sigma_ln=0.0)
    good = np.flatnonzero((drawn.snr.max(axis=1) >= COULD_BE_SEEN_SNR) & (drawn.weight > 0.0))
    stay = stays[0][1][good] - stays[0][0][good]
    rng, half, seen = np.random.default_rng(9), 0.5 * worlds.EXPOSURE_S, np.zeros(2)
    for _ in range(40):
        enters = rng.uniform(t[0] - stay, t[-1])
        for k, frames in enumerate((t, kept)):
            lit = np.searchsorted(frames, enters + stay + half, side="right") - np.searchsorted(frames, enters - half)
            seen[k] += float(drawn.weight[good] @ (lit >= 2))
    told = _counted_crossings(_watch_at(kept)) / _counted_crossings(_watch_at(t))
    assert told == pytest.approx(seen[1] / seen[0], rel=0.02)


def test_where_objects_become_too_slow_and_where_a_line_of_sight_leaves_a_shell() -> None:
    """Two circular orbits of 7,078 km head on: 15.0 km/s over 0.1 deg/s are 8,600 km. From 7,000 km to a sphere of 8,000 km."""
    speed = math.sqrt(398600.4418 / 7078.0)
    head_on = farthest_km(np.array([[0.0, speed, 0.0]]), np.array([7078.0]), np.zeros(1))
    assert head_on == pytest.approx(2.0 * speed / math.radians(0.1))
    place, sight = np.array([[7000.0, 0.0, 0.0]] * 3), np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    assert _leaves_km(place, sight, np.full(3, 8000.0)) == pytest.approx([1000.0, 15000.0, math.sqrt(15e6)])
    assert _leaves_km(place[:1], sight[:1], np.array([6900.0])) == 0.0


def test_straight_motion_through_a_window_off_the_boresight() -> None:
    """At 100 km a field of +-5 km about (4, 3) km: from (1, 2) at 1 km/s along columns it takes 8 s to the far side."""
    seen = replace(worlds.watch_of(worlds.window((0.03, 0.04))), half_row=0.05, half_col=0.05)
    start, stop = _stay_s(np.array([[1.0, 2.0, 100.0]]), np.array([[1.0, 0.0, 0.0]]), seen)
    assert (start[0], stop[0]) == pytest.approx((-2.0, 8.0))


def test_the_field_watched_is_that_of_the_readout_window(fields: list) -> None:
    """1,024 x 512 px whose first is (3072, 0) of 4096 x 4096: in tangents its middle and half its sides."""
    products, frames = _finished(fields)
    products = _with_observer(products)
    tile = BackgroundModel(
        tile_px=512, level_adu=np.zeros((8, 8), np.float32), sigma_adu=np.full((8, 8), 3.0, np.float32)
    )  # fmt: skip
    frames = [replace(f, background=tile) for f in frames]
    camera = chain_of(fields[0]).camera
    whole = _watch(products, frames, camera, [])
    assert whole is not None
    # the drawn camera's own centre is 1.8 and -1.3 px off
    assert (whole.mid_row, whole.mid_col) == pytest.approx((0.0, 0.0), abs=3.0 / camera.focal_px)
    cut = replace(
        products,
        headers=tuple(replace(h, rows=1024, cols=512, window_row0=3072) for h in products.headers),
        solutions=[replace(s, camera=replace(s.camera, center_row=s.camera.center_row - 3072.0)) for s in products.solutions],
    )
    seen = _watch(cut, frames, camera, [])
    assert seen is not None
    assert (seen.half_row, seen.half_col) == pytest.approx((512.0 / camera.focal_px, 256.0 / camera.focal_px))
    # from the whole frame's middle to the window's; distortion and the camera's centre move it by some pixels
    assert seen.mid_row == pytest.approx((3072.0 + 511.5 - 2047.5) / camera.focal_px, abs=6.0 / camera.focal_px)
    assert seen.mid_col == pytest.approx((255.5 - 2047.5) / camera.focal_px, abs=6.0 / camera.focal_px)


@pytest.mark.parametrize(("a", "e", "i_deg"), [(7078.0, 0.01, 98.0), (9000.0, 0.2, 30.0), (7500.0, 0.001, 63.0)])
def test_the_density_of_an_orbit_sums_to_one_object(a: float, e: float, i_deg: float) -> None:
    """Over the shell that holds the orbit, 300,000 places even in volume: 1 within the scatter of the sum."""
    rng, n = np.random.default_rng(2), 300_000
    low, high = a * (1.0 - e) - 2.0 * CELL_KM, a * (1.0 + e) + 2.0 * CELL_KM
    radius = np.cbrt(low**3 + rng.random(n) * (high**3 - low**3))
    sine, longitude = rng.uniform(-1.0, 1.0, n), rng.uniform(0.0, 2.0 * np.pi, n)
    flat = np.sqrt(1.0 - sine**2)
    place = radius[:, None] * np.stack([flat * np.cos(longitude), flat * np.sin(longitude), sine], axis=1)
    density = density_of(place, np.full(n, a), np.full(n, e), np.full(n, np.radians(i_deg)))
    total = float(density.mean()) * 4.0 / 3.0 * np.pi * (high**3 - low**3)
    assert total == pytest.approx(1.0, abs=5.0 * float(density.std() / density.mean()) / np.sqrt(n) + 0.01)


@pytest.mark.slow
def test_intervals_hold_the_truth_in_forty_runs() -> None:
    """Runs as lists whose light and orbits are off as the systematic terms say: 90 % intervals of N(> d)."""
    watch, made = worlds.watch_of(worlds.window()), worlds.classes()
    rng = np.random.default_rng(5)
    inside = []
    for _ in range(40):
        flux, truth = worlds.run(made, watch, rng, expected=5.0, as_assumed=False)
        larger = np.cumsum(truth[::-1])[::-1]
        inside.append((flux.total_larger[:, 0] <= larger) & (larger <= flux.total_larger[:, 2]))
    assert 0.84 <= np.mean(inside) <= 0.97


def test_injection_into_plain_noise_is_a_threshold() -> None:
    """Half of what has the threshold's S/N is found, the search across adding 0.2 at most; controls are normal."""
    rng = np.random.default_rng(4)
    noise = Image(
        value_e=3.0 * rng.standard_normal((600, 600)), sigma_e=np.full((600, 600), 3.0), usable=np.ones((600, 600), dtype=bool)
    )
    found = measured_efficiency([noise], "test", (7.0, 10), 0.9, rng)
    share = found.found.sum(axis=1) / found.tried.sum(axis=1)
    assert share[SNR_GRID.index(4.0)] < 0.02
    assert 0.4 < share[SNR_GRID.index(7.0)] < 0.75
    assert share[SNR_GRID.index(9.0)] > 0.93
    assert np.std(found.control) == pytest.approx(1.0, abs=0.1)
    assert found.lengths_px == LENGTHS_PX
    p = found.share(np.array([2.0, 6.5, 100.0]), np.array([50.0, 50.0, 50.0]))
    assert p[0] == 0.0
    assert p[1] < p[2]
    assert p[2] > 0.95


def test_masked_pixels_cost_light() -> None:
    rng = np.random.default_rng(4)
    shape = (400, 400)
    whole = Image(value_e=rng.standard_normal(shape), sigma_e=np.ones(shape), usable=np.ones(shape, dtype=bool))
    half = replace(whole, usable=rng.random(shape) < 0.5)
    a, b = (measured_efficiency([image], "test", (7.2, 1), 0.9, np.random.default_rng(1)) for image in (whole, half))
    at = SNR_GRID.index(9.0)
    assert b.found[at].sum() < 0.5 * a.found[at].sum()


def test_threshold_is_read_from_what_came_down(fields: list) -> None:
    frames = [f.frame for f in fields]
    snr = [g.detection.snr for f in frames for g in f.rois]
    value, n = threshold_of(frames)
    assert n == len(snr)
    assert min(snr) * 0.6 < value <= min(snr)
    assert threshold_of([replace(f, rois=()) for f in frames]) == (DEFAULT_THRESHOLD, 0)


def _of_track(group: RoiGroup, snr: float) -> RoiGroup:
    """The region as a track over several frames sends it, with this S/N in its own frame."""
    detection = replace(group.detection, snr=snr)
    return replace(group, roi_id=FIRST_TRACK_ROI, track=0, track_snr=9.0, detection=detection)


def test_threshold_is_that_of_single_frames(fields: list) -> None:
    """Members that only a track found are below it; a member whose own strip was lost may be. Others with a track tell."""
    frames = [f.frame for f in fields]
    alone = threshold_of(frames)
    faint = [replace(f, rois=(*f.rois, _of_track(f.rois[0], 3.7))) for f in frames]
    assert threshold_of(faint) == alone
    whole = [f.rois[0] for f in frames]
    lost = [replace(_of_track(g, 3.7), roi_id=g.roi_id, n_strips=g.n_strips + 1) for g in whole]
    assert threshold_of([replace(f, rois=(*f.rois, g)) for f, g in zip(frames, lost, strict=True)]) == alone
    assert threshold_of([replace(f, rois=tuple(replace(g, track=0) for g in f.rois)) for f in frames]) == alone


@pytest.mark.parametrize(("tracked", "counted", "gaps"), [((), 1, (2.0, 2.0)), ((1,), 1, (1.0, 2.0)), ((0, 1, 3), 0, (0.0, 0.0))])
def test_only_what_single_frames_show_is_counted(
    fields: list, tracked: tuple[int, ...], counted: int, gaps: tuple[float, float]
) -> None:
    """A tracklet of four bright frames, `tracked` of them found by a track alone: seen and expected between its ends."""
    run, _ = _finished(
        [
            replace(f, frame=replace(f.frame, rois=tuple(_of_track(g, g.detection.snr) for g in f.frame.rois)))
            if k in tracked
            else f
            for k, f in enumerate(fields)
        ]
    )
    assert [len(t.frames) for t in run.tracklets] == [4]
    got = _counted(run, worlds.efficiency(np.random.default_rng(0), trials=2000))
    assert (len(got.size_m), got.n_tracked) == (counted, 1 - counted)
    assert (got.frames_seen, got.frames_expected) == pytest.approx(gaps, abs=0.01)


def test_signal_to_noise_is_the_closed_form() -> None:
    """S = F / sqrt(2 sqrt(pi) s (L + 2 sqrt(pi) s) V) against the sum over pixels of a drawn trail."""
    watch = worlds.watch_of(worlds.window())
    s, length, flux = watch.psf_sigma_px, 60.0, 4000.0
    row, col = np.mgrid[-12:13, -60:61]
    along = np.linspace(-30.0, 30.0, 2001)
    light = np.exp(-0.5 * (row[..., None] ** 2 + (col[..., None] - along) ** 2) / s**2).mean(axis=-1) * flux / (2 * np.pi * s**2)
    direct = np.sqrt(np.sum(light**2)) / watch.noise_e
    assert float(trail_snr(np.array([flux]), np.array([length]), np.array([1e9]), watch)[0]) == pytest.approx(direct, rel=0.01)


def _finished(fields: list, **changes: object) -> tuple[GroundProducts, list]:
    """Products of the frames, each changed as told."""
    frames = [replace(f.frame, **changes) for f in fields]
    chain = chain_of(fields[0])
    state, products = chain.initial_state(), []
    for frame in frames:
        state, product = chain.process_frame(state, frame)
        products.append(product)
    return chain.finish(frames, products), frames


def test_each_gap_of_a_downlink_is_said(fields: list) -> None:
    """One frame, no observer, no meshes, no whole frames: a table all the same, with the reason and without a number."""
    camera = chain_of(fields[0]).camera
    products, frames = _finished(fields)
    one = replace(products, headers=products.headers[:1], photometry=products.photometry[:1], solutions=[products.solutions[0]])
    table = population_table(population(one, frames[:1], camera))
    assert "1 frame: tracklets and the time watched need two" in table.meta["lacks"]
    assert np.isnan(np.asarray(table["larger"])).all()

    blind = replace(products, headers=tuple(replace(h, observer=None) for h in products.headers))
    table = population_table(population(blind, frames, camera))
    assert "fewer than two frames with direction and observer" in table.meta["lacks"]
    assert np.isnan(np.asarray(table["exposure_km2_year"])).all()

    bare = [replace(f, background=None, whole_frame=None) for f in frames]
    assert images_of(bare, 1.0) == ([], "none")
    found = population(_with_observer(products), bare, camera)
    assert found.flux is None
    assert "no background mesh" in "; ".join(found.lacks)
    assert published_flux(population_table(found), {})["larger_than"] == []


def _with_observer(products: GroundProducts) -> GroundProducts:
    """The products as if GPS had come down."""
    from sboc_e2e.icd.frame import ObserverState

    def at(tai_ns: int) -> ObserverState:
        return ObserverState(
            tai_ns=tai_ns, position_m=np.array([7.078e6, 0.0, 0.0]), velocity_m_s=np.array([0.0, 1000.0, 7400.0]),
            sigma_position_m=1.0, sigma_velocity_m_s=0.01,
        )  # fmt: skip

    return replace(products, headers=tuple(replace(h, observer=at(h.t_start_tai_ns)) for h in products.headers))


def test_slow_and_unsized_tracklets_are_told_apart() -> None:
    counted = counted_of([(0.01, 0.9, 1.0), (np.nan, 0.8, 2.0), (0.5, 0.9, 0.01)], [(90.0, 110.0)], [0.99, 0.5], 4)
    assert counted.n_slow == 1
    assert np.isnan(counted.size_m).tolist() == [False, True]
    assert counted.n_single_false == pytest.approx(0.51)
    assert counted.range_sigma_ln == pytest.approx(np.log(110.0 / 90.0) / 3.29)


def test_score_compares_the_published_flux_with_truth() -> None:
    """A table that holds the truth at one of two sizes."""
    from astropy.table import Table

    table = Table({"from_m": [0.001, 0.1], "n_tracklets": [1, 3]}, meta={"lacks": ""})
    for name, values in (("larger", [5.0, 2.0]), ("larger_low", [3.0, 1.5]), ("larger_high", [8.0, 2.5])):
        table[name] = values
    table["larger_total_low"], table["larger_total_high"] = [2.0, 1.0], [9.0, 2.6]
    truth = {
        "classes": [{"from_mm": 1.0, "boost": 2.0, "flux_km2_year": 2.0}, {"from_mm": 100.0, "boost": 3.0, "flux_km2_year": 1.0}]
    }
    got = published_flux(table, truth)
    assert [row["true_per_km2_year"] for row in got["larger_than"]] == [7.0, 3.0]
    assert [row["inside"] for row in got["larger_than"]] == [True, False]
    assert got["holds_truth"]["value"] == 0.5
    assert published_flux(None, truth)["holds_truth"]["value"] is None

    truth["classes"][1]["density_boost"] = 2.5
    precise = published_flux(table, truth)
    assert [row["true_per_km2_year"] for row in precise["larger_than"]] == [6.5, 2.5]
    truth["classes"][0]["boost_at_any_range"] = 1.5
    anywhere = published_flux(table, truth)
    assert [row["true_per_km2_year"] for row in anywhere["larger_than"]] == [5.5, 2.5]
    placed = published_flux(table, truth, [0.05])
    assert [row["inside"] for row in placed["larger_than"]] == [None, True]
    assert placed["holds_truth"]["n"] == 1


def test_natural_number_does_not_hang_on_a_run() -> None:
    """Nature's number of large objects scatters by 20 % among the candidates of runs; the integral is their mean."""
    seen, one, options = worlds.window(), SizeClass(from_mm=100.0, to_mm=3000.0), PopulationOptions()
    runs = []
    for seed in range(12):
        found = draw_candidates(options, one, seen, np.random.default_rng(seed), even_share=0.6)
        runs.append(found.natural[(found.snr >= options.snr_min) & (found.rate_deg_s >= options.slowest_deg_s)].sum())
    assert natural_numbers(options, one, seen)[0] == pytest.approx(np.mean(runs), abs=3.5 * np.std(runs) / np.sqrt(len(runs)))


def test_share_of_frames_kept_is_read_from_gaps() -> None:
    """Without gaps 0.95 and 7 %; with 30 of 40 frames the posterior is near 0.78 and known to 8 %."""
    bare = counted_of([], [], [], 0)
    assert bare.kept == pytest.approx((0.95, 0.066), abs=0.005)
    share, sigma_ln = counted_of([], [], [], 0, [(3.0, 4.0)] * 10).kept
    assert share == pytest.approx(39.5 / 50.0)
    assert 0.05 < sigma_ln < 0.09


def test_light_near_the_threshold_is_seen_too_bright() -> None:
    """Two frames at the threshold: those found are sqrt(2 / pi) sigma too bright; far above it nothing is."""
    efficiency = worlds.efficiency(np.random.default_rng(0), trials=5000)
    drawn = crossings(
        worlds.watch_of(worlds.window()), (0.1, 0.3), 3000, np.random.default_rng(1), albedo=ALBEDO, albedo_sigma_ln=0.5
    )
    for snr, expected in ((worlds.THRESHOLD, math.sqrt(2.0 / math.pi) / worlds.THRESHOLD), (40.0, 0.0)):
        two = np.where(np.arange(drawn.snr.shape[1]) < 2, snr, 0.0) * np.ones((len(drawn.snr), 1))
        light = light_seen(replace(drawn, snr=two), efficiency, np.random.default_rng(2))
        assert light.mean() - 1.0 == pytest.approx(expected, abs=4.0 / snr / math.sqrt(2.0 * len(light)))


def test_stars_of_the_list_are_left_out(fields: list) -> None:
    """A pixel under a listed star takes no part; the sky between the stars does."""
    frame = next(f.frame for f in fields if len(f.frame.stars.row))
    hidden = _under_stars(frame)
    assert hidden[np.rint(frame.stars.row).astype(int), np.rint(frame.stars.col).astype(int)].all()
    assert hidden.mean() < 0.5
