"""S/N of trails without an image: against closed forms, an integral of its own, and the pixel chain's trails and stars."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import erf

from sboc_e2e import scenario
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.registry import Registry
from simulator.bare_trails import NOBODY, bare_trails
from simulator.chain import Simulator
from simulator.survey.flight import Flight, instants_of
from simulator.survey.looks import looks_of
from simulator.trail_noise import PIXEL_VARIANCE_PX2, gaussian_energy

SMALL = [f"sensor.window.{key}" for key in ("rows=512", "cols=512", "row0=1792", "col0=1792")]


def flight(*overrides: str) -> Flight:
    found = scenario.load("sso_antisun", registry=Registry(), overrides=[*SMALL, *overrides])
    return Flight.of(found.simulator, found.seed)


@pytest.mark.parametrize("length", [0.001, 1.0, 15.0, 300.0])
def test_energy_of_a_gaussian_trail(length: float) -> None:
    """The squared profile of a box of `length` blurred by a Gaussian, integrated along it; across it 1 / (2 sqrt(pi) s)."""
    sigma = 0.9

    def profile(x: float) -> float:
        ends = [erf((x + side * 0.5 * length) / (sigma * np.sqrt(2.0))) for side in (1.0, -1.0)]
        return float((0.5 * (ends[0] - ends[1]) / length) ** 2)

    along, _ = quad(profile, -0.5 * length - 8.0, 0.5 * length + 8.0, limit=400)
    expected = along / (2.0 * np.sqrt(np.pi) * sigma)
    assert gaussian_energy(np.array([length]), np.array([sigma]))[0] == pytest.approx(expected, rel=1e-6)


def test_a_gaussian_camera_has_the_closed_form_and_a_disc_takes_from_it() -> None:
    f = flight("psf.preset=ideal")
    middle, length = np.full(3, 255.0), np.array([5.0, 50.0, 500.0])
    sigma = np.sqrt(f.camera.sigma_at(middle, middle) ** 2 + PIXEL_VARIANCE_PX2)
    assert f.energy.of(length, middle, middle, np.zeros(3)) == pytest.approx(gaussian_energy(length, sigma))
    wide = f.energy.of(length, middle, middle, np.full(3, 40.0))
    # a disc of 40 px, 10 px rms along either axis: a long trail's light falls on 11 times as many pixels
    assert wide[2] / gaussian_energy(length, sigma)[2] == pytest.approx(1.0 / 11.5, rel=0.15)


@pytest.mark.slow
def test_looks_have_the_signal_to_noise_of_the_pixel_chains_trails() -> None:
    """The same objects, steady, in the same frames without stars: within 0.5 % in the middle, 3 % for nine of ten trails."""
    f = flight("stars.enabled=false", "frames=6", "population.tumbling_share=0", "sky.structure=0")
    made = bare_trails(f, StarCatalogue.embedded(), range(6))
    at, p = made.as_passages(f)
    looks = looks_of(f, at, p, np.random.default_rng(1), only=(0, 5))
    frame = np.rint(looks.open_s * f.options.frame_rate_hz).astype(np.int64)
    mine = {key: k for k, key in enumerate(zip(looks.passage.tolist(), frame.tolist(), strict=True))}
    whole = made.trails[(made.trails["edge0"] == 0) & (made.trails["edge1"] == 0) & (made.trails["snr"] > 4.0)]
    pairs = [(row, mine.get((int(row["object_id"]), int(row["frame"])))) for row in whole]
    ratio = np.array([row["snr"] / looks.snr[k] for row, k in pairs if k is not None])
    assert len(ratio) > 80
    assert np.median(ratio) == pytest.approx(1.0, abs=0.005)
    assert np.quantile(np.abs(ratio - 1.0), 0.9) < 0.03


@pytest.mark.parametrize(
    "sky", [(), ('epoch_utc="2026-12-21T00:00:00"',), ("sky.zodiacal=10",)], ids=["high latitude", "Milky Way", "bright sky"]
)
@pytest.mark.slow
def test_the_share_that_stars_leave_is_that_of_a_frame(sky: tuple[str, ...]) -> None:
    """Mean of 1 / variance over a frame with stars over that of one without, in 7 square degrees."""
    larger = [f"sensor.window.{key}" for key in ("rows=2048", "cols=2048", "row0=1024", "col0=1024")]
    f = flight(*larger, *sky, "sky.structure=0")
    options = replace(f.options, objects=NOBODY, population=replace(f.options.population, classes=()), frames=1)
    catalogue = StarCatalogue.embedded()
    stars, dark = (
        Simulator(replace(options, stars=replace(options.stars, enabled=on)), seed=f.seed, catalogue=catalogue).mean_electrons(0)
        for on in (True, False)
    )
    share = (1.0 / f.camera.variance_e2(stars, 0, 0)).mean() / (1.0 / f.camera.variance_e2(dark, 0, 0)).mean()
    assert instants_of(f, np.array([0.1]), 6.0).star_share[0] == pytest.approx(share, abs=0.006)
