"""Image lag: what a frame leaves in the next one, against its closed form."""

import numpy as np
import pytest

from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.registry import Registry
from sboc_e2e.scenario import document
from simulator.chain import Simulator
from simulator.radiation.hits import HitList, no_hits
from simulator.sensor.lag import hand_on, lag_of

SHARE, FULL_E = 1e-3, 30_000.0
WORLD = [
    "frames=4", "instrument.rows=96", "instrument.cols=96", "population.classes=[]", "objects.passing=[]",
    "sensor.shot_noise=false",
    'sensor.readout.read_noise="0 e-"', 'sensor.readout.row_noise="0 e-"', "sensor.converter.nonlinearity=0.0", "sensor.prnu=0.0",
    "sensor.converter.bits=16", 'sensor.converter.gain="0.1 e-/ADU"', "sensor.converter.dual_gain=false",
    'sensor.converter.full_well="6000 e-"',
]  # fmt: skip


def struck(row, col, electrons):
    """Particles of given charge."""
    one = no_hits()
    return HitList(
        row=np.array(row, np.int32), col=np.array(col, np.int32), charge_e=np.array(electrons, np.float32), tracks=one.tracks
    )


def test_a_pixel_leaves_its_share_and_a_full_one_that_of_its_well():
    """Shares of 5,000 e- and of 30,000 e-; light below 20 e- leaves less than 0.02 e- and nothing here."""
    first = np.full((20, 30), 3.0, np.float32)
    first[4, 7], first[9, 2] = 5000.0, 1e6
    left = lag_of(first, no_hits(), (0, 0), SHARE, FULL_E)
    after = np.full((20, 30), 3.0, np.float32)
    hand_on(after, lag_of(after, no_hits(), (0, 0), SHARE, FULL_E), left, SHARE)
    assert after[4, 7] == pytest.approx(3.0 + 5.0, rel=1e-6)
    assert after[9, 2] == pytest.approx(3.0 + 30.0, rel=1e-6)
    after[4, 7] = after[9, 2] = 3.0
    assert np.all(after == 3.0)


def test_steady_light_is_as_it_was():
    """What a frame loses to the next it gets from the one before."""
    light = np.random.default_rng(1).uniform(1000.0, 9000.0, (20, 30)).astype(np.float32)
    left = lag_of(light, no_hits(), (0, 0), SHARE, FULL_E)
    now = light.copy()
    hand_on(now, left, left, SHARE)
    assert now == pytest.approx(light, rel=1e-6)


def test_particles_leave_their_share_inside_the_window():
    """Two tracks through one pixel add up; a window counts from its own first pixel."""
    dark = np.zeros((20, 30), np.float32)
    left = lag_of(dark, struck([103, 103, 99], [205, 205, 205], [700.0, 300.0, 5000.0]), (100, 200), SHARE, FULL_E)
    assert left.place.tolist() == [3 * 30 + 5]
    assert left.electrons == pytest.approx([1.0], rel=1e-6)


def simulator(*more):
    scenario = document.bare("lag", {"seed": 3}, registry=Registry(), overrides=[*WORLD, *more])
    return Simulator(scenario.simulator, seed=3, catalogue=StarCatalogue.embedded())


def test_a_trail_leaves_a_copy_in_the_next_frame_only():
    """A mover of frame 0 that is gone after it: 1 % of its light stands in frame 1 at its place (one unit), none in frame 2."""
    mover = 'objects.pixel_path=[{v="6 mag",row="10 px",col="12 px",row_rate="300 px/s",col_rate="250 px/s",restart=false}]'
    dark = "stars.enabled=false"
    plain, lagging = simulator(mover, dark), simulator(mover, dark, "sensor.structure.lag=0.01")
    light = [plain.mean_electrons(k).astype(np.float64) for k in range(3)]
    trail = light[0] - light[1]
    assert trail.max() > 500.0
    differences = [lagging.frame(k)[0].pixels.astype(float) * 0.1 - plain.frame(k)[0].pixels.astype(float) * 0.1 for k in (1, 2)]
    expected = 0.01 * (np.minimum(light[0], 6000.0) - np.minimum(light[1], 6000.0))
    well_lit = light[0] > 50.0
    assert np.abs(differences[0] - expected)[well_lit].max() < 0.11
    assert np.abs(differences[1])[trail > 100.0].max() < 0.11


def test_a_frame_is_the_same_whichever_was_made_before():
    more = ("sensor.structure.lag=0.02", 'radiation.environment="saa"', "sensor.shot_noise=true")
    in_order, alone = simulator(*more), simulator(*more)
    frames = [in_order.frame(k)[0].pixels for k in range(3)]
    assert np.array_equal(alone.frame(2)[0].pixels, frames[2])
    assert np.array_equal(alone.frame(1)[0].pixels, frames[1])
    assert not np.array_equal(simulator(*more[1:]).frame(2)[0].pixels, frames[2])
