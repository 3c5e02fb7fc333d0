"""Whether objects of the geostationary ring slip through a fence: they are flown through it one by one."""

import numpy as np

from ground.planning.fence import RING_KM, Fence, FenceOptions, fence_of
from ground.planning.light import PlannedCamera
from ground.planning.options import ConstraintOptions, PlanOptions
from ground.planning.sky import Orbit, sky_of
from sboc_e2e.icd import tai

MU = 398600.4418
CAMERA = PlannedCamera(
    zero_point_e_s=6.5e8, exposure_s=2.0, period_s=2.5, noise_e=8.0, sigma_px=0.85, scale_arcsec=4.64,
    half_field_rad=np.radians(2.64),
)  # fmt: skip


def station(start: int) -> Orbit:
    """700 km, 98.2 deg, plane across the direction of the Sun (right ascension 311 deg on this day)."""
    a, i, node = 7078.0, np.radians(98.2), np.radians(311.0 + 90.0)
    c, s = np.cos(node), np.sin(node)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    speed = np.sqrt(MU / a)
    state = np.concatenate([turn @ [a, 0.0, 0.0], turn @ [0.0, speed * np.cos(i), speed * np.sin(i)]])
    return Orbit(state=state, epoch_tai_ns=start)


def fence(visit_s: float) -> tuple[Fence, int]:
    start = tai.from_jd_parts(2461434.5, 0.0)  # 2027-01-28
    options = PlanOptions(days=1.1, visit_s=visit_s, constraints=ConstraintOptions(limb_deg=0.0, moon_deg=0.0))
    return fence_of(station(start), CAMERA, start, options, FenceOptions(latitude_deg=9.0)), start


def caught(made: Fence, start: int) -> float:
    """Share of 1,000 ring objects of up to 8.5 deg inclination that are inside the field in the middle of some visit."""
    rng = np.random.default_rng(1)
    inclination, node, phase = np.radians(8.5) * rng.random(1000), *(2 * np.pi * rng.random((2, 1000)))
    middle = np.array([(visit.start_tai_ns + visit.end_tai_ns) // 2 for visit in made.schedule.visits])
    sky = sky_of(station(start), middle)
    seen = np.zeros(1000, dtype=bool)
    for k, visit in enumerate(made.schedule.visits):
        u = phase + np.sqrt(MU / RING_KM**3) * (middle[k] - start) * 1e-9
        x, y, z = np.cos(u), np.sin(u) * np.cos(inclination), np.sin(u) * np.sin(inclination)
        place = RING_KM * np.stack([x * np.cos(node) - y * np.sin(node), x * np.sin(node) + y * np.cos(node), z], axis=1)
        line = place - sky.station_km[k]
        seen |= line @ np.array(visit.boresight) > np.cos(CAMERA.half_field_rad) * np.linalg.norm(line, axis=1)
    return float(np.mean(seen))


def test_nothing_slips_through_a_fence_that_says_so() -> None:
    made, start = fence(60.0)
    assert made.leak_proof, (made.longest_gap_s, made.crossing_s)
    assert caught(made, start) == 1.0


def test_the_fence_stands_where_the_ring_is_lit_best() -> None:
    """Its mean phase angle against that of the same visits at meridians all around; all of its visits are allowed."""
    made, start = fence(60.0)
    assert made.held == 1.0
    middle = np.array([(visit.start_tai_ns + visit.end_tai_ns) // 2 for visit in made.schedule.visits])
    sky = sky_of(station(start), middle)
    line = np.array([visit.boresight for visit in made.schedule.visits])
    # the field's centre at the ring: where the line of sight meets the sphere of its radius
    along = np.sum(line * sky.station_km, axis=1)
    reach = -along + np.sqrt(along**2 - np.sum(sky.station_km**2, axis=1) + RING_KM**2)
    place = sky.station_km + reach[:, None] * line
    height, around = place[:, 2], np.hypot(place[:, 0], place[:, 1])

    def phase_deg(ra_deg: float) -> float:
        ra = np.radians(ra_deg)
        there = np.stack([around * np.cos(ra), around * np.sin(ra), height], axis=1)
        to_sun, to_camera = sky.sun_km - there, sky.station_km - there
        cosine = np.sum(to_sun * to_camera, axis=1) / np.linalg.norm(to_sun, axis=1) / np.linalg.norm(to_camera, axis=1)
        return float(np.degrees(np.arccos(cosine)).mean())

    assert phase_deg(made.meridian_deg) <= min(phase_deg(ra) for ra in range(0, 360, 5)) + 0.5


def test_a_slow_fence_leaks_and_says_so() -> None:
    made, start = fence(400.0)
    assert not made.leak_proof
    assert caught(made, start) < 0.9
