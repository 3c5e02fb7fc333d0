"""Passages of a survey against the encounters of the pixel chain, and against Poisson."""

from dataclasses import replace

import numpy as np
import pytest

from sboc_e2e import scenario
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd.errors import UserError
from sboc_e2e.registry import Registry
from simulator.chain import Simulator
from simulator.randomness import Effect, generator
from simulator.scene.cast import encounter_window
from simulator.scene.encounters import draw_candidates, in_field, reach_km
from simulator.scene.surface import Surfaces
from simulator.survey.blocks import Pools, candidate_number, draw_block, pilot_instants
from simulator.survey.candidates import candidates, farthest_km, pool_of
from simulator.survey.flight import BLOCK_S, Flight, block_instants, instants_of
from simulator.survey.looks import looks_of
from simulator.survey.passages import light_of, make_passages

SMALL = ['population.classes=[{from="1 mm", to="3 mm", count=1}]']


def flight(*overrides: str) -> Flight:
    found = scenario.load("sso_antisun", registry=Registry(), overrides=overrides)
    return Flight.of(found.simulator, found.seed)


@pytest.mark.parametrize("number", [0, 2])
@pytest.mark.slow
def test_rate_is_that_of_the_pixel_chains_encounters(number: int) -> None:
    f = flight()
    options = f.options.population
    size_class = options.classes[number]
    at = instants_of(f, np.zeros(1), BLOCK_S)
    window = replace(f.window, noise_variance_e2=float(at.noise_e2[0]), duration_s=1.0)
    theirs = []
    for seed in range(3):
        drawn = draw_candidates(
            replace(options, candidates=200_000), size_class, window, np.random.default_rng(seed), even_share=0.6, over_cells=True
        )
        kept = (drawn.snr >= options.snr_min) & (drawn.rate_deg_s >= options.slowest_deg_s)
        theirs.append(drawn.per_day[kept].sum())
    rng = generator(5, Effect.SURVEY)
    mine = []
    for _ in range(3):
        found = candidates(f, at, pool_of(f, size_class, rng), 200_000, rng)
        mine.append(found.natural[found.snr >= options.snr_min].sum() * 86_400.0 / BLOCK_S)
    error = np.hypot(np.std(theirs, ddof=1), np.std(mine, ddof=1)) / np.sqrt(3.0)
    assert np.mean(mine) == pytest.approx(np.mean(theirs), abs=4.0 * error + 0.02 * np.mean(theirs))


@pytest.mark.slow
def test_blocks_scatter_as_poisson_and_repeat() -> None:
    # the Moon passes the field once in the 24 days, and the Earth's limb turns with the orbit: both change how many can be seen
    f = flight(*SMALL, "sky.moon=false", "sky.earth=false")
    numbers, pools = [candidate_number(f, pilot_instants(f), 0)], Pools()
    counts = np.array([len(draw_block(f, b, numbers, pools)[1].size_m) for b in range(96)])
    # The variance over the mean of n counts has a scatter of sqrt(2 / (n - 1)); up to 5 % of the passages may come in pairs.
    assert counts.var(ddof=1) / counts.mean() == pytest.approx(1.05, abs=3.0 * np.sqrt(2.0 / 95.0))
    again = draw_block(f, 7, numbers, Pools())[1]
    first = draw_block(f, 7, numbers, pools)[1]
    assert np.array_equal(first.position_km, again.position_km)


@pytest.mark.slow
def test_passages_lie_in_the_field_and_their_looks_within_the_stay() -> None:
    f = flight(*SMALL)
    at, p = draw_block(f, 3, [candidate_number(f, pilot_instants(f), 0)], Pools())
    camera = np.einsum("nij,nj->ni", at.attitude[p.instant], p.position_km - at.position_km[p.instant])
    assert (np.abs(camera[:, 0] / camera[:, 2]) <= f.window.half_col).all()
    assert (np.abs(camera[:, 1] / camera[:, 2]) <= f.window.half_row).all()
    assert (p.enter_s <= 0.0).all()
    assert (p.leave_s >= 0.0).all()
    looks = looks_of(f, at, p, np.random.default_rng(1))
    exposure, base = f.camera.exposure_s, at.time_s[p.instant][looks.passage]
    assert (looks.open_s + exposure + 0.03 >= base + p.enter_s[looks.passage]).all()
    assert (looks.open_s <= base + p.leave_s[looks.passage]).all()
    # each stay is stood for in full
    assert np.bincount(looks.passage, weights=looks.stands_for, minlength=len(p.size_m)) == pytest.approx(looks.frames)


def test_straight_motion_through_the_field() -> None:
    field = replace(flight(*SMALL).window, half_row=0.05, half_col=0.05)
    enter, leave = in_field(np.array([[0.0, 0.0, 100.0]]), np.array([[1.0, 0.0, 0.0]]), field)
    assert (enter[0], leave[0]) == pytest.approx((-5.0, 5.0))
    enter, leave = in_field(
        np.array([[1.0, 2.0, 100.0]]), np.array([[1.0, 0.0, 0.0]]), replace(field, mid_row=0.03, mid_col=0.04)
    )
    assert (enter[0], leave[0]) == pytest.approx((-2.0, 8.0))


def test_objects_pass_a_window_off_the_boresight() -> None:
    """A corner of 1,024 x 512 pixels; those of a whole detector pass it once in 32 times."""
    f = flight(*SMALL, *(f"sensor.window.{key}" for key in ("rows=1024", "cols=512", "row0=3072", "col0=0")))
    at = block_instants(f, 3)
    rng = generator(5, Effect.SURVEY)
    p = candidates(f, at, pool_of(f, f.options.population.classes[0], rng), 20_000, rng)
    place, _ = at.in_camera(p.instant, p.position_km, p.velocity_km_s)
    row, col = f.camera.projection.to_pixels(place)
    assert len(row) > 100
    # distortion and the centre of the built camera move places by up to 10 px
    assert ((row > -5.0) & (row < 1028.0) & (col > -5.0) & (col < 516.0)).all()
    assert (row.min(), row.max(), col.min(), col.max()) == pytest.approx((0.0, 1023.0, 0.0, 511.0), abs=50.0)
    assert (p.enter_s <= 0.0).all()
    assert (p.leave_s >= 0.0).all()


def test_encounters_of_the_pixel_chain_pass_a_window_off_the_boresight() -> None:
    f = flight(*SMALL, *(f"sensor.window.{key}" for key in ("rows=1024", "cols=512", "row0=3072", "col0=0")))
    window = encounter_window(f.carrier, f.camera, f.options.light, 3.0, 0.0, 1.0)
    options = f.options.population
    drawn = draw_candidates(replace(options, candidates=2_000), options.classes[0], window, np.random.default_rng(1))
    observer = window.observer_km + drawn.time_s[:, None] * window.velocity_km_s
    row, col = f.camera.projection.to_pixels((drawn.position_km - observer) @ window.attitude.T)
    assert ((row > -5.0) & (row < 1028.0) & (col > -5.0) & (col < 516.0)).all()
    assert (row.min(), row.max(), col.min(), col.max()) == pytest.approx((0.0, 1023.0, 0.0, 511.0), abs=20.0)


def test_a_camera_that_turns_sees_the_motion_of_its_own_frame() -> None:
    """A zenith camera and an object 1,000 km above it on a circle of its plane, against differences over 0.2 s and by hand."""
    f = flight(*SMALL, 'pointing.law="nadir"')
    h = 0.1
    before, at, after = (instants_of(f, np.array([100.0 + t]), BLOCK_S) for t in (-h, 0.0, h))
    radius = np.linalg.norm(at.position_km)
    position = at.position_km * (1.0 + 1_000.0 / radius)
    velocity = at.velocity_km_s * np.sqrt(radius / (radius + 1_000.0))
    ends = [i.attitude[0] @ (position + t * velocity - i.position_km)[0] for i, t in ((before, -h), (after, h))]
    expected = (ends[1] - ends[0]) / (2.0 * h)
    # it falls back by the turn of the vertical over its radius, less its own speed: 8.563 - 7.024 km/s
    assert np.linalg.norm(expected) == pytest.approx(1.539, abs=0.002)
    place, moves = at.in_camera(np.zeros(1, np.int64), position, velocity)
    assert moves[0] == pytest.approx(expected, abs=1e-3)
    surfaces = Surfaces(albedo=np.ones(1), specular=np.zeros(1), colour=np.ones(1))
    p = make_passages(f, at, np.zeros(1, np.int64), np.ones(1), surfaces, position, velocity)
    stay = np.ravel(in_field(place, expected[None], f.window))
    assert [p.enter_s[0], p.leave_s[0]] == pytest.approx(stay, rel=1e-3)
    looks = looks_of(f, at, p, np.random.default_rng(1), turns=False)
    whole = np.median(looks.length_px)
    assert whole == pytest.approx(np.linalg.norm(expected) / 1_000.0 * f.camera.exposure_s * f.window.focal_px, rel=1e-3)


def test_the_earth_ends_the_watch_in_summer() -> None:
    f = flight(*SMALL)
    winter, summer = (block_instants(f, b) for b in (0, 4 * 150))
    assert winter.watched.all()
    assert 0.3 < summer.watched.mean() < 1.0


def test_instants_of_a_year_have_the_sun_of_their_day() -> None:
    f = flight(*SMALL)
    at = instants_of(f, np.arange(0.0, 365.0, 5.0) * 86_400.0, BLOCK_S)
    away = np.einsum("ni,ni->n", at.attitude[:, 2], at.sun_km) / np.linalg.norm(at.sun_km, axis=1)
    # the camera looks away from the Sun: 45 days of delay would make this 0.7
    assert (away < -0.999).all()


@pytest.mark.parametrize(
    ("epoch", "brightest"),
    [("2027-01-29T00:00:00", 6.0), ("2027-06-23T00:00:00", 1e6), ("2027-03-22T18:00:00", 1e6)],
    ids=["dark", "the Earth's limb 6 deg from the field", "full Moon"],
)
def test_the_sky_is_that_of_the_pixel_chain(epoch: str, brightest: float) -> None:
    """Mean electrons of a frame without stars, in the middle of the field, where the Earth and the Moon scatter light into it."""
    small = [f"sensor.window.{key}" for key in ("rows=64", "cols=64", "row0=2016", "col0=2016")]
    found = scenario.load(
        "sso_antisun", registry=Registry(),
        overrides=[f'epoch_utc="{epoch}"', "stars.enabled=false", "population.classes=[]", "objects.passing=[]",
                   "sky.structure=0", "frames=1", *small],
    )  # fmt: skip
    f = Flight.of(found.simulator, found.seed)
    at = instants_of(f, np.array([0.1]), 1.0)
    image = Simulator(found.simulator, seed=found.seed, catalogue=StarCatalogue.embedded()).mean_electrons(0)
    # vignetting is nothing there; the field's middle moves by 0.01 deg in a frame
    assert at.sky_e[0] == pytest.approx(float(np.median(image)), rel=0.02)
    assert 3.0 < at.sky_e[0] < brightest


def test_a_site_is_refused() -> None:
    found = scenario.load("ground_site_tracking", registry=Registry())
    with pytest.raises(UserError, match="a survey needs a camera in orbit"):
        Flight.of(found.simulator, 1)


@pytest.mark.parametrize("roll_deg_s", [40.0, -360.0])
def test_a_roll_of_any_rate_is_the_turn_itself(roll_deg_s: float) -> None:
    f = flight(*SMALL, f'pointing.roll_rate="{roll_deg_s} deg/s"')
    at = instants_of(f, np.array([100.0]), BLOCK_S)
    # the anti-Sun point adds 2e-7 rad/s
    assert at.spin_rad_s[0] == pytest.approx([0.0, 0.0, np.radians(roll_deg_s)], abs=1e-6)


def test_snr_is_that_of_the_trail_on_the_detector() -> None:
    """A camera that turns with the orbit and a piece at rest before it, 100 km below: 0.06 deg/s over the stars."""
    f = flight(*SMALL, 'pointing.law="nadir"', 'pointing.tilt="0 deg"')
    at = instants_of(f, np.array([3_600.0]), BLOCK_S)
    line = 100.0 * at.attitude[0, 2]
    rests = at.velocity_km_s + np.cross(at.attitude[0].T @ at.spin_rad_s[0], line)
    surfaces = Surfaces(albedo=np.ones(1), specular=np.zeros(1), colour=np.ones(1))
    population = replace(f.options.population, slowest_deg_s=0.0)
    f = replace(f, options=replace(f.options, population=population, light=replace(f.options.light, earth_shadow=False)))
    p = make_passages(f, at, np.zeros(1, np.int64), np.ones(1), surfaces, at.position_km + line, rests)
    assert p.rate_deg_s[0] == pytest.approx(np.degrees(np.linalg.norm(at.spin_rad_s[0])), rel=1e-6)
    assert 0.055 < p.rate_deg_s[0] < 0.065
    light_e = light_of(f, at, p.instant, p.size_m, p.surfaces, p.position_km)[0] * f.camera.zero_point_e_s * f.camera.exposure_s
    sigma = np.hypot(f.window.sigma_px, f.window.aperture_m * 1e-5 * f.window.focal_px / 4.0)
    # a point: the matched filter has the noise of 4 pi sigma^2 pixels
    assert p.snr[0] == pytest.approx(light_e / np.sqrt(4.0 * np.pi * sigma**2 * at.noise_e2[0]), rel=1e-4)


def test_pieces_that_the_camera_follows_are_drawn_as_far_as_they_can_be_seen() -> None:
    """With a turn of `slowest` and more a piece can rest on the detector: it reaches as far as one at rest."""
    f = flight(*SMALL, 'pointing.law="nadir"', 'pointing.roll_rate="0.5 deg/s"')
    at = instants_of(f, np.array([100.0]), BLOCK_S)
    corners = [f.camera.direction(row, col) for row in (-1.0, 1.0) for col in (-1.0, 1.0)]
    fastest = max(np.linalg.norm(np.cross(at.spin_rad_s[0], corner)) for corner in corners)
    assert fastest == pytest.approx(at.fastest_turn_rad_s(f.camera.radius_rad), rel=0.3)
    assert fastest <= at.fastest_turn_rad_s(f.camera.radius_rad)
    size_m, surfaces = np.ones(1), Surfaces(albedo=np.ones(1), specular=np.zeros(1), colour=np.ones(1))
    slowest = np.radians(f.options.population.slowest_deg_s)
    rests = reach_km(size_m, surfaces, f.options.population.snr_min, f.window)
    assert farthest_km(f, f.window, size_m, surfaces, slowest) == pytest.approx(rests)
    assert farthest_km(f, f.window, size_m, surfaces) < 0.9 * rests
