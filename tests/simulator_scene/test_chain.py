"""The chain as a whole: light against truth, bytes, telemetry, refusals."""

from dataclasses import fields, is_dataclass, replace
from types import SimpleNamespace
from typing import get_args

import numpy as np
import pytest
from scipy.interpolate import RectBivariateSpline

from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd.errors import UserError
from simulator.chain import Simulator
from simulator.optics.psf import PsfOptions
from simulator.optics.vignetting import VignettingOptions
from simulator.options import SimulatorOptions, smoke_options
from simulator.platform.jitter import JitterOptions
from simulator.platform.line_of_sight import line_of_sight
from simulator.platform.observer import PlatformOptions
from simulator.platform.pointing import PointingOptions, commanded_attitude
from simulator.platform.rotation import rotation_vector_of
from simulator.platform.shutter import FrameTiming, ShutterOptions
from simulator.scene.encounters import PopulationOptions
from simulator.scene.sky import SkyOptions
from simulator.scene.sources import EncounterOptions, ObjectOptions, OrbitOptions, PassingOptions, PixelPathOptions
from simulator.scene.stars import StarOptions
from simulator.sensor.options import BinningOptions, SensorOptions, WindowOptions
from tests.star_light import check_places

NOBODY = PopulationOptions(classes=())
NOTHING = ObjectOptions(passing=())
DARK_SKY = SkyOptions(zodiacal=0.0, unresolved=0.0)
FLAT = VignettingOptions(corner_loss=0.0, cosine_fourth=False)


@pytest.fixture(scope="module")
def catalogue():
    return StarCatalogue.embedded()


@pytest.fixture(scope="module")
def smoke(catalogue):
    return Simulator(smoke_options(), seed=4, catalogue=catalogue)


def small(**changes):
    """A 512 x 512 camera without sky and population; the light alone."""
    base = smoke_options()
    defaults = {"population": NOBODY, "objects": NOTHING, "sky": DARK_SKY, "vignetting": FLAT}
    return replace(base, **(defaults | changes))


@pytest.mark.slow
def test_any_frame_alone_has_the_same_bytes(smoke, catalogue):
    again = Simulator(smoke_options(), seed=4, catalogue=catalogue)
    late, late_truth = again.frame(3)
    early, _ = again.frame(0)
    first, _ = smoke.frame(0)
    fourth, fourth_truth = smoke.frame(3)
    assert early.pixels.tobytes() == first.pixels.tobytes()
    assert late.pixels.tobytes() == fourth.pixels.tobytes()
    assert late.header.attitude.quaternion.tobytes() == fourth.header.attitude.quaternion.tobytes()
    for name in ("frame", "stars", "streaks", "cosmics"):
        assert getattr(late_truth, name).tobytes() == getattr(fourth_truth, name).tobytes()


@pytest.mark.slow
def test_another_seed_gives_another_sky(smoke, catalogue):
    other, _ = Simulator(smoke_options(), seed=5, catalogue=catalogue).frame(0)
    assert other.pixels.tobytes() != smoke.frame(0)[0].pixels.tobytes()


def test_star_light_lies_where_the_truth_says(catalogue):
    """Centroids of rendered stars, without noise, against truth positions: 0.001 px."""
    options = small(
        stars=StarOptions(faint_limit_mag=0.0),
        psf=PsfOptions(fwhm_px=2.0, corner_growth=0.0),
        jitter=JitterOptions(highest_hz=20.0),
    )
    simulator = Simulator(options, seed=1, catalogue=catalogue)
    image = simulator.mean_electrons(0).astype(np.float64)
    assert check_places(image, simulator.frame(0)[1].stars, 1e-3) >= 5


def test_trail_light_lies_where_the_truth_says(catalogue):
    """The light-weighted centroid and the total flux of a trail, against the path of the truth: 0.001 px."""
    options = small(
        stars=StarOptions(enabled=False),
        psf=PsfOptions(corner_growth=0.0),
        objects=ObjectOptions(
            passing=(), encounter=(EncounterOptions(size_m=0.2, range_km=60.0, across_km_s=6.0, heading_deg=37.0),)
        ),
    )
    simulator = Simulator(options, seed=1, catalogue=catalogue)
    image = simulator.mean_electrons(2).astype(np.float64)
    (streak,) = simulator.frame(2)[1].streaks
    assert not streak["edge0"]
    assert not streak["edge1"]
    assert streak["length_px"] > 20.0
    assert image.sum() == pytest.approx(streak["flux_e"], rel=1e-5)
    weight = streak["path_flux_e_s"]
    mean_row = np.trapezoid(streak["path_row"] * weight) / np.trapezoid(weight)
    mean_col = np.trapezoid(streak["path_col"] * weight) / np.trapezoid(weight)
    rows, cols = np.indices(image.shape)
    assert abs((image * rows).sum() / image.sum() - mean_row) < 1e-3
    assert abs((image * cols).sum() / image.sum() - mean_col) < 1e-3
    seconds = (streak["t1_tai_ns"] - streak["t0_tai_ns"]) * 1e-9
    assert streak["flux_e"] == pytest.approx(np.trapezoid(weight) / (len(weight) - 1) * seconds, rel=1e-3)


def test_seven_streaks_in_closed_form(catalogue):
    """Exposed duration T / |1 - v tau|; two opposite vertical streaks of 400 and 667 px both become 500 px."""
    paths = (
        PixelPathOptions(name="down", row_px=60.0, col_px=120.0, row_rate_px_s=1000.0),
        PixelPathOptions(name="up", row_px=440.0, col_px=220.0, row_rate_px_s=-1666.6666666666667),
        PixelPathOptions(name="right", row_px=100.0, col_px=60.0, col_rate_px_s=900.0),
        PixelPathOptions(name="left", row_px=380.0, col_px=480.0, col_rate_px_s=-900.0),
        PixelPathOptions(name="diagonal", row_px=200.0, col_px=300.0, row_rate_px_s=500.0, col_rate_px_s=500.0),
        PixelPathOptions(name="slow", row_px=300.0, col_px=400.0, row_rate_px_s=150.0),
        PixelPathOptions(name="faster than the shutter", row_px=-3300.0, col_px=40.0, row_rate_px_s=60000.0),
    )
    line_s, exposure_s = 2e-4, 0.2
    options = small(
        frames=1,
        frame_rate_hz=2.0,
        stars=StarOptions(enabled=False),
        objects=ObjectOptions(passing=(), pixel_path=paths),
        shutter=ShutterOptions(exposure_s=exposure_s, line_time_us=line_s * 1e6),
        jitter=JitterOptions(cross_rms_arcsec=0.0, roll_rms_arcsec=0.0, lines=()),
    )
    rolling = Simulator(options, seed=1, catalogue=catalogue).frame(0)[1].streaks
    still = replace(options, shutter=ShutterOptions(exposure_s=exposure_s, line_time_us=0.0))
    still = Simulator(still, seed=1, catalogue=catalogue).frame(0)[1].streaks
    assert len(rolling) == len(still) == 7
    for streak in rolling:
        path = paths[streak["object_id"]]
        stretch = abs(1.0 - path.row_rate_px_s * line_s)
        seconds = (streak["t1_tai_ns"] - streak["t0_tai_ns"]) * 1e-9
        if not (streak["edge0"] or streak["edge1"]):
            assert seconds == pytest.approx(exposure_s / stretch, rel=1e-6)
        opened = streak["path_row"] * line_s
        since = (streak["path_t_tai_ns"] - streak["path_t_tai_ns"][0]) * 1e-9
        row = streak["path_row"][0] + path.row_rate_px_s * since
        assert np.abs(row - streak["path_row"]).max() < 1e-3
        t = (streak["path_row"] - path.row_px) / path.row_rate_px_s if path.row_rate_px_s else None
        if t is not None:
            assert (t - opened).min() > -1e-7
            assert (t - opened).max() < exposure_s + 1e-7
    lengths = {paths[s["object_id"]].name: s["length_px"] for s in rolling}
    assert lengths["down"] == pytest.approx(250.0, abs=1e-3)
    assert lengths["up"] == pytest.approx(250.0, abs=1e-3)
    original = {paths[s["object_id"]].name: s["length_px"] for s in still}
    assert original["down"] == pytest.approx(200.0, abs=1e-3)
    assert original["up"] == pytest.approx(333.333, abs=1e-2)


def test_path_whose_end_is_cut_by_the_edge(catalogue):
    path = PixelPathOptions(row_px=256.0, col_px=450.0, col_rate_px_s=1000.0)
    options = small(frames=1, stars=StarOptions(enabled=False), objects=ObjectOptions(passing=(), pixel_path=(path,)))
    (streak,) = Simulator(options, seed=1, catalogue=catalogue).frame(0)[1].streaks
    assert (bool(streak["edge0"]), bool(streak["edge1"])) == (False, True)
    assert streak["col1"] == pytest.approx(511.5, abs=1e-3)


def test_reading_upwards_and_alternating_turn_line_times(catalogue):
    down, up, both = (
        Simulator(
            small(stars=StarOptions(enabled=False), shutter=ShutterOptions(direction=direction, line_time_us=80.0)),
            seed=1,
            catalogue=catalogue,
        )
        for direction in ("down", "up", "alternating")
    )
    assert down.frame(1)[0].header.line_time_ns == 80_000
    assert up.frame(1)[0].header.line_time_ns == -80_000
    assert [both.frame(k)[0].header.line_time_ns for k in (0, 1)] == [80_000, -80_000]
    first, last = down.frame(0)[1].frame, up.frame(0)[1].frame
    # the first row to open does so at the epoch, whatever the direction
    assert last["t_start_true_tai_ns"][0] - first["t_start_true_tai_ns"][0] == 80_000 * 511


def test_truth_grid_agrees_with_star_truth(smoke):
    """A star's truth pixel, interpolated in the truth grid, points to where its light comes from."""
    made = smoke.frame(0)[1]
    grid = made.frame[0]
    stars = made.stars[made.stars["star_id"] > 0]
    found = StarCatalogue.embedded().cone(130.0, 18.0, 6.0, epoch_jyear=2027.08)
    where = {int(k): n for n, k in enumerate(found.source_id)}
    known = [(s, where[int(s["star_id"])]) for s in stars if int(s["star_id"]) in where][:300]
    index = np.array([n for _, n in known])
    rows, cols = np.array([s["row"] for s, _ in known]), np.array([s["col"] for s, _ in known])
    nodes = np.unique(grid["grid_row"]), np.unique(grid["grid_col"])
    dec = RectBivariateSpline(*nodes, grid["grid_dec_app_deg"].reshape(9, 9))(rows, cols, grid=False)
    offset_arcsec = (dec - found.dec_deg[index]) * 3600.0
    sigma_arcsec = found.sigma_mas[index] / 1000.0
    # what remains is aberration, smooth over the field, and the catalogue's own errors
    smooth = np.polynomial.polynomial.polyvander2d(rows / 512, cols / 512, [2, 2])
    residual = offset_arcsec - smooth @ np.linalg.lstsq(smooth, offset_arcsec, rcond=None)[0]
    assert np.median(np.abs(residual)) < 1.5 * np.median(sigma_arcsec)
    assert np.median(np.abs(residual)) > 0.3 * np.median(sigma_arcsec)  # the true sky is not the catalogue


def test_telemetry_errs_as_it_says(smoke):
    def matrix(q):
        x, y, z, w = q
        return np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        )

    frame, made = smoke.frame(0)
    error = rotation_vector_of(matrix(frame.header.attitude.quaternion) @ matrix(made.frame["q_true"][0]).T)
    sigma = np.sqrt(np.diag(frame.header.attitude.covariance_rad2))
    assert (np.abs(error) < 4.0 * sigma).all()
    assert np.abs(error).max() > 0.05 * sigma.min()
    assert np.abs(frame.header.observer.position_m - made.frame["position_m"][0]).max() < 4.5 * 10.0
    assert frame.header.t_start_tai_ns == made.frame["t_start_clock_tai_ns"][0] != made.frame["t_start_true_tai_ns"][0]


def test_binning_and_window_keep_light_and_truth(catalogue):
    path = PixelPathOptions(row_px=40.0, col_px=30.0, col_rate_px_s=250.0, row_rate_px_s=100.0, v_mag=6.0)
    base = small(frames=1, stars=StarOptions(enabled=False), objects=ObjectOptions(passing=(), pixel_path=(path,)))
    sensor = SensorOptions(
        binning=BinningOptions(rows=2, cols=2, method="sum"), window=WindowOptions(row0=64, col0=32, rows=256, cols=320)
    )
    simulator = Simulator(replace(base, sensor=sensor), seed=1, catalogue=catalogue)
    frame, made = simulator.frame(0)
    (streak,) = made.streaks
    assert frame.pixels.shape == (128, 160)
    assert (frame.header.window_row0, frame.header.bin_cols) == (64, 2)
    image = simulator.mean_electrons(0).astype(np.float64)
    rows, cols = np.indices(image.shape)
    # delivered pixel p covers window pixels 2p and 2p + 1
    assert ((image * rows).sum() / image.sum() - 0.5) / 2.0 == pytest.approx(0.5 * (streak["row0"] + streak["row1"]), abs=2e-3)
    assert ((image * cols).sum() / image.sum() - 0.5) / 2.0 == pytest.approx(0.5 * (streak["col0"] + streak["col1"]), abs=2e-3)
    assert streak["length_px"] == pytest.approx(np.hypot(250.0, 100.0) * 0.2, rel=0.02)
    assert frame.header.line_time_ns == 160_000


def test_objects_and_summary(smoke):
    objects = smoke.objects()
    assert [str(k) for k in objects["name"][:2]] == ["far-1", "far-2"]
    assert (objects["kind"] == "population").sum() >= 12
    assert np.isfinite(objects["range_km"]).mean() > 0.7
    summary = smoke.population_summary()
    assert summary["drawn"] == (objects["kind"] == "population").sum()
    weight = objects["weight"][objects["kind"] == "population"].sum()
    assert weight == pytest.approx(summary["natural_in_run"])
    # pieces below 1 cm are too faint at 3,000 km, where the sky of the run ends; some of what is larger than 10 cm lies beyond
    for row in summary["classes"]:
        share = row["natural_at_any_range"] / row["natural_expected"]
        assert share == 1.0 if row["to_mm"] <= 10.0 else share >= 1.0
        assert 1.02 < share < 2.0 or row["from_mm"] < 100.0
        assert row["boost_at_any_range"] == pytest.approx(row["density_boost"] / share)


def test_calibration_is_of_the_nominal_camera(smoke):
    calibration = smoke.calibration()
    assert calibration.flat.shape == (512, 512)
    assert calibration.camera.focal_px == pytest.approx(400e3 / 72.0)
    assert calibration.camera.center_row == 255.5
    assert 0.02 < calibration.camera.colour_term < 0.6 or -0.6 < calibration.camera.colour_term < -0.02


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"epoch_utc": "2099-01-01T00:00:00"}, "Earth-orientation"),
        ({"epoch_utc": "yesterday"}, "epoch_utc"),
        ({"shutter": ShutterOptions(exposure_s=0.5)}, "exposure"),
        # 2.56 s of read-out at 4 frames/s
        ({"shutter": ShutterOptions(line_time_us=5000.0)}, r"shutter.line_time: 5000 us .* 2.56 s.*; allowed is up to 488.3 us"),
        (
            {"shutter": ShutterOptions(line_time_us=5000.0), "sensor": SensorOptions(type="ccd")},
            r"shutter.line_time: 5000 us .* 2.56 s.*; allowed is up to 488.3 us",
        ),
        (
            {"shutter": ShutterOptions(line_time_us=100.0, direction="alternating")},
            r"shutter.exposure: 0.2 s .* beside a read-out of 0.0512 s that alternates; allowed is up to 0.1988 s",
        ),
        ({"sensor": SensorOptions(binning=BinningOptions(rows=2, cols=4))}, r"sensor\.binning: 2 x 4 is not square; .* equal"),
        (
            # 175 deg in half of 0.95 s and 512 rows of 80 us
            {
                "pointing": PointingOptions(roll_rate_deg_s=-360.0),
                "frame_rate_hz": 1.0,
                "shutter": ShutterOptions(exposure_s=0.95, line_time_us=80.0),
            },
            r"pointing\.roll_rate: -360 deg/s .* allowed is up to 353\.2 deg/s",
        ),
        ({"pointing": PointingOptions(law="object", target="nobody")}, "nobody"),
        ({"objects": ObjectOptions(passing=(PassingOptions(name="x", range_km=9e5),))}, "'x'"),
        ({"objects": ObjectOptions(passing=(), orbit=(OrbitOptions(name="deep", eccentricity=0.5),))}, "inside the Earth"),
        ({"objects": ObjectOptions(passing=(), encounter=(EncounterOptions(name="y", closing_km_s=-15.0),))}, "'y'"),
        ({"population": PopulationOptions(nearest_km=2000.0, snr_min=900.0)}, "population.classes"),
        ({"platform": PlatformOptions(kind="site"), "pointing": PointingOptions(law="inertial", dec_deg=-89.0)}, "elevation"),
    ],
)
def test_impossible_runs_are_refused_by_name(catalogue, changes, words):
    with pytest.raises(UserError, match=words) as caught:
        Simulator(small(**changes), seed=1, catalogue=catalogue)
    assert "\n" not in str(caught.value)


def test_a_roll_up_to_the_limit_is_as_commanded():
    """175 deg on both sides of mid-exposure: the light of the first and the last moment lies where the roll puts it."""
    roll = PointingOptions(law="inertial", ra_deg=30.0, dec_deg=20.0, roll_rate_deg_s=350.0)
    attitude = commanded_attitude(roll, None, 0)
    still = SimpleNamespace(state=lambda _: (np.zeros(3), np.zeros(3)), rotation_vector=lambda t: np.zeros((len(t), 3)))
    timing = FrameTiming(t_start_tai_ns=0, clock_tai_ns=0, exposure_ns=1_000_000_000, line_time_ns=0, rows=1)
    sight = line_of_sight(timing, 0, still, attitude, still)
    star = np.array([[0.7, 0.5, 0.5]])
    for t in (0.0, 0.25, 0.5, 1.0):
        assert sight.to_camera(np.array([t]), star)[0] == pytest.approx(attitude(round(t * 1e9)) @ star[0], abs=1e-6)


def test_frames_beyond_the_run_are_refused(smoke):
    with pytest.raises(UserError, match="frame 6"):
        smoke.frame(6)


def test_defaults_are_the_default_scenario():
    options = SimulatorOptions()
    assert (options.frames, options.frame_rate_hz, options.instrument.rows) == (24, 4.0, 4096)
    assert options.epoch_utc.startswith("2027-01-29")
    assert sum(c.count for c in options.population.classes) >= 12
    assert len(options.objects.passing) >= 2


def test_moving_pointing_does_not_depend_on_the_order_of_frames(catalogue):
    """The zenith sweeps the sky; stars held from an earlier frame must give the same bytes as a fresh search."""
    options = small(frames=4, frame_rate_hz=0.2, pointing=PointingOptions(law="nadir", tilt_deg=180.0), sky=SkyOptions())
    forwards = Simulator(options, seed=2, catalogue=catalogue)
    for index in (0, 1):
        forwards.frame(index)
    alone = Simulator(options, seed=2, catalogue=catalogue)
    assert forwards.frame(2)[0].pixels.tobytes() == alone.frame(2)[0].pixels.tobytes()
    assert forwards.mean_electrons(3).tobytes() == alone.mean_electrons(3).tobytes()


def test_defocused_trail_keeps_its_light(catalogue):
    """A piece 1.5 km away is a disc of 27 arcsec; its light is all there and lies around the path."""
    near = EncounterOptions(size_m=0.005, range_km=1.5, across_km_s=0.05, closing_km_s=0.1, heading_deg=-60.0)
    options = small(stars=StarOptions(enabled=False), objects=ObjectOptions(passing=(), encounter=(near,)))
    options = replace(options, instrument=replace(options.instrument, pixel_um=18.0))
    simulator = Simulator(options, seed=1, catalogue=catalogue)
    image = simulator.mean_electrons(2).astype(np.float64)
    (streak,) = simulator.frame(2)[1].streaks
    disc_px = options.instrument.aperture_m / (streak["range_km"] * 1e3) * 0.4 / 18e-6
    assert streak["defocus_px"] == pytest.approx(disc_px, rel=0.02)
    assert image.sum() == pytest.approx(streak["flux_e"], rel=1e-4)
    weight = streak["path_flux_e_s"]
    rows, cols = np.indices(image.shape)
    assert abs((image * rows).sum() / image.sum() - np.trapezoid(streak["path_row"] * weight) / np.trapezoid(weight)) < 5e-3
    assert abs((image * cols).sum() / image.sum() - np.trapezoid(streak["path_col"] * weight) / np.trapezoid(weight)) < 5e-3


def option_tables(options_type, name="simulator"):
    yield name, options_type
    for f in fields(options_type):
        if is_dataclass(f.type):
            yield from option_tables(f.type, f"{name}.{f.name}")
        for part in get_args(f.type):
            if is_dataclass(part):
                yield from option_tables(part, f"{name}.{f.name}[]")


@pytest.mark.parametrize(("name", "table"), list(option_tables(SimulatorOptions)), ids=lambda v: v if isinstance(v, str) else "")
def test_every_option_says_what_it_is_and_what_is_allowed(name, table):
    free_text = {"name", "object", "target", "file", "sizes_file", "catalogue_file", "epoch_utc"}
    for f in fields(table):
        assert f.metadata.get("doc"), f"{name}.{f.name}"
        if f.type in (int, float):
            assert f.metadata["min"] <= f.default <= f.metadata["max"], f"{name}.{f.name}"
        elif f.type is str and f.name not in free_text:
            assert f.default in f.metadata["choices"], f"{name}.{f.name}"


def test_stray_light_is_a_ramp_across_the_columns_and_knows_no_vignetting(catalogue):
    camera = replace(smoke_options().instrument, stray_light_e_px_s=30.0, stray_gradient=0.4)
    options = small(instrument=camera, vignetting=VignettingOptions(corner_loss=0.5), stars=StarOptions(enabled=False))
    mean_e = Simulator(options, seed=1, catalogue=catalogue).mean_electrons(0)
    across = np.linspace(-0.5, 0.5, mean_e.shape[1])
    expected = 30.0 * options.shutter.exposure_s * (1.0 + 0.4 * across)
    assert np.abs(mean_e - expected[None, :]).max() < 1e-4
