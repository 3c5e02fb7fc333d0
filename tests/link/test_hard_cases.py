"""Cases that break simple linkers: ambiguous directions, crossings, slow points, overtaken read-out, broken trails, edges."""

import math
from dataclasses import replace

import numpy as np
import pytest

from ground.link import MotionLinker, apply_links
from ground.link.resolve import reversed_streak
from sboc_e2e.icd.errors import ContractError
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakMeasurement, Tracklet
from tests.link.sky_scene import T0_NS, Camera, Mover, Truth, observe, pixel_mover, streak


def owners(tracklet: Tracklet, streaks: tuple[StreakMeasurement, ...], truth: Truth) -> list[int]:
    """Object of each member."""
    at = {(s.frame, s.streak_id): k for k, s in enumerate(streaks)}
    return [truth.owner[at[key]] for key in zip(tracklet.frames.tolist(), tracklet.streak_ids.tolist(), strict=True)]


def test_opposite_streaks_that_look_alike() -> None:
    """Seven streaks of one frame, two of them alike though one moves 2,000 px/s down and the other 3,333 px/s up.

    With tau = 100 us and T = 0.2 s both are 500 px long: 1/v6 - 1/v7 = 2 tau. The next frame tells them apart.
    """
    camera = Camera(rows=1024, cols=1024, line_time_s=100e-6, focal_px=11111.0, cadence_s=0.22)
    velocities = [(900, 300), (-700, 500), (0, 1500), (300, -1200), (1400, 0), (2000, 0), (-3333, 0)]
    starts = [(150, 100), (800, 200), (500, 100), (300, 900), (100, 450), (60, 650), (990, 800)]
    movers = [pixel_mover(camera, r, c, vr, vc, t_s=0.02) for (r, c), (vr, vc) in zip(starts, velocities, strict=True)]
    headers, streaks, truth = observe(camera, movers, 3, np.random.default_rng(2), sigma_along=0.4, sigma_cross=0.15)
    alike = [s.fit.length_px for s, owner in zip(streaks, truth.owner, strict=True) if owner in (5, 6) and s.frame == 0]
    assert abs(alike[0] - alike[1]) < 3.0
    tracklets = MotionLinker().link(headers, streaks)
    assert len(tracklets) == 7
    linked = apply_links(streaks, tracklets, headers)
    for k, (before, after) in enumerate(zip(streaks, linked, strict=True)):
        assert after.flags & StreakFlag.DIRECTION_RESOLVED
        same = (before.fit.row0, before.fit.col0) == (after.fit.row0, after.fit.col0)
        assert same == truth.end0_first[k]
    scale_deg = math.degrees(1.0 / camera.focal_px)
    for tracklet in tracklets:
        velocity = velocities[owners(tracklet, streaks, truth)[0]]
        assert tracklet.rate_deg_s / scale_deg == pytest.approx(math.hypot(*velocity), rel=0.02)


def test_crossing_parallel_and_overtaking_objects() -> None:
    """Two that meet in the middle of the field, two abreast 6 px apart, and one that runs another down on the same line."""
    camera = Camera(rows=2048, cols=2048)
    movers = [
        pixel_mover(camera, 1024, 1024, 500, 500, t_s=1.0),
        pixel_mover(camera, 1024, 1024, 500, -500, t_s=1.0),
        pixel_mover(camera, 300, 200, 0, 600, t_s=0.0),
        pixel_mover(camera, 306, 200, 0, 600, t_s=0.0),
        pixel_mover(camera, 1700, 1024, 0, 300, t_s=1.0),
        pixel_mover(camera, 1700, 1024, 0, 700, t_s=1.0),
    ]
    headers, streaks, truth = observe(camera, movers, 9, np.random.default_rng(3), false_per_frame=20)
    tracklets = MotionLinker().link(headers, streaks)
    assert sorted({owners(t, streaks, truth)[0] for t in tracklets}) == list(range(6))
    assert len(tracklets) == 6
    assert all(len(set(owners(t, streaks, truth))) == 1 for t in tracklets)


@pytest.mark.parametrize("n", [12, 26])
def test_a_train_of_satellites_is_linked_whole(n: int) -> None:
    """Satellites one behind the other, 40 px apart, with trails of 9.8 px, among false streaks.

    The distance is no multiple of the 12.25 px of a frame: at such a one nothing tells a satellite from its neighbour.
    """
    camera = Camera(rows=2048, cols=2048)
    ahead = np.array([0.5, math.sqrt(0.75)])
    starts = [1024.0 + 40.0 * (k - 0.5 * n) * ahead for k in range(n)]
    movers = [pixel_mover(camera, *start, *(49.0 * ahead), t_s=1.0) for start in starts]
    headers, streaks, truth = observe(camera, movers, 8, np.random.default_rng(1), false_per_frame=5)
    tracklets = MotionLinker().link(headers, streaks)
    assert sorted({owners(t, streaks, truth)[0] for t in tracklets}) == list(range(n))
    assert len(tracklets) == n
    assert all(len(set(owners(t, streaks, truth))) == 1 and len(t.frames) == 8 for t in tracklets)


def test_slow_point_is_linked_and_static_point_is_not() -> None:
    """A geostationary object (15 arcsec/s, 0.8 px per frame) over 40 frames; a hot pixel and a star residual stay unlinked."""
    camera = Camera(rows=512, cols=512)
    mover = pixel_mover(camera, 200.0, 300.0, 0.0, 15.04 / 4.64, t_s=0.0, range_km=37_000.0)
    headers, streaks, truth = observe(
        camera, [mover], 40, np.random.default_rng(4), sigma_along=0.25, sigma_cross=0.25, p_seen=0.8
    )
    rng = np.random.default_rng(5)
    fixed = []
    for frame in range(40):
        for number, (row, col) in enumerate([(100.0, 100.0), (400.0, 350.0)]):
            where = np.array([[row, col], [row, col]]) + rng.normal(0.0, 0.05 if number == 0 else 0.25, 2)
            fixed.append(streak(camera, frame, 10_000 + 2 * frame + number, where, 0.25, 0.25, StreakFlag.POINT_LIKE))
    tracklets = MotionLinker().link(headers, (*streaks, *fixed))
    assert len(tracklets) == 1
    assert set(tracklets[0].streak_ids.tolist()) <= {s.streak_id for s in streaks}
    assert len(tracklets[0].frames) >= 0.9 * len(streaks)
    assert tracklets[0].rate_deg_s * 3600.0 == pytest.approx(15.04, rel=0.03)
    assert len(truth.owner) == len(streaks)


def test_object_that_overtakes_the_read_out() -> None:
    """At v tau = 1.25 the shutter closes on the first end before it opens on the other: order and epochs, and FAST_ROWS.

    Such an object is in no other frame of a camera that reads out one frame after the other, so its motion is given here.
    """
    camera = Camera(rows=4096, cols=4096, line_time_s=250e-6, exposure_s=0.02, cadence_s=1.1)
    mover = pixel_mover(camera, 50.0, 2000.0, 5000.0, 300.0, t_s=0.1)
    headers, streaks, truth = observe(camera, [mover], 1, np.random.default_rng(6), sigma_along=0.3)
    times = np.linspace(*truth.epochs_s[0], 5)
    pixels = np.array([mover.pixel(camera, t)[:2] for t in times])
    ra, dec = camera.radec(pixels[:, 0], pixels[:, 1])
    t_ns = T0_NS + np.round(times * 1e9).astype(np.int64)
    tracklet = Tracklet(
        tracklet_id=3, streak_ids=np.array([0]), frames=np.array([0]), t_tai_ns=t_ns, ra_deg=ra, dec_deg=dec,
        sigma_along_arcsec=np.ones(5), sigma_cross_arcsec=np.ones(5), t_ref_tai_ns=int(t_ns[2]), ra_ref_deg=ra[2],
        dec_ref_deg=dec[2], rate_deg_s=6.5, rate_err_deg_s=0.1, position_angle_deg=180.0, mag=9.0, mag_err=0.1, chi2_nu=1.0,
        probability=1.0, direction_resolved=True, flags=StreakFlag.DIRECTION_RESOLVED,
    )  # fmt: skip
    linked = apply_links(streaks, (tracklet,), headers)[0]
    assert linked.flags & StreakFlag.FAST_ROWS
    assert linked.tracklet_id == 3
    assert linked.fit.row1 - linked.fit.row0 == pytest.approx(400.0, abs=2.0)
    # half a pixel of end error is 125 us of row epoch
    np.testing.assert_allclose((linked.t_tai_ns[[0, 2]] - T0_NS) * 1e-9, truth.epochs_s[0], atol=5e-4)


def test_edge_cut_crossing_of_two_frames() -> None:
    """An object that enters in one frame and leaves in the next: both streaks are cut, the tracklet and its rate are right."""
    camera = Camera()
    mover = pixel_mover(camera, 2000.0, -550.0, 150.0, 11_000.0, t_s=0.0)
    headers, streaks, truth = observe(camera, [mover], 3, np.random.default_rng(7), false_per_frame=3)
    edges = [s.flags & (StreakFlag.EDGE0 | StreakFlag.EDGE1) for s, o in zip(streaks, truth.owner, strict=True) if o == 0]
    assert len(edges) == 2
    assert all(edges)
    tracklets = MotionLinker().link(headers, streaks)
    assert len(tracklets) == 1
    assert tracklets[0].rate_deg_s == pytest.approx(math.degrees(11_001.0 / camera.focal_px), rel=0.01)
    linked = apply_links(streaks, tracklets, headers)
    for k, after in enumerate(linked):
        if truth.owner[k] == 0:
            np.testing.assert_allclose((after.t_tai_ns[[0, 2]] - T0_NS) * 1e-9, truth.epochs_s[k], atol=2e-3)


def test_broken_trail_goes_to_its_track() -> None:
    """A trail that the detector broke in two (a star was masked) is two members of the tracklet, not two unlinked streaks."""
    camera = Camera()
    mover = pixel_mover(camera, 1000.0, 500.0, 200.0, 1500.0, t_s=0.0)
    headers, streaks, _ = observe(camera, [mover], 7, np.random.default_rng(8))
    broken = []
    for s in streaks:
        if s.frame != 3:
            broken.append(s)
            continue
        ends = np.array([[s.fit.row0, s.fit.col0], [s.fit.row1, s.fit.col1]])
        for number, (low, high) in enumerate([(0.0, 0.4), (0.5, 1.0)]):
            part = ends[0] + np.array([[low], [high]]) * (ends[1] - ends[0])
            broken.append(streak(camera, 3, 500 + number, part, 0.5, 0.15, StreakFlag(0)))
    tracklets = MotionLinker().link(headers, broken)
    assert len(tracklets) == 1
    assert {500, 501} <= set(tracklets[0].streak_ids.tolist())
    linked = {s.streak_id: s for s in apply_links(broken, tracklets, headers)}
    middle_s = 3 * camera.cadence_s + camera.line_time_s * 1150.0
    for number, (low, high) in enumerate([(0.0, 0.4), (0.5, 1.0)]):
        epochs_s = (linked[500 + number].t_tai_ns[[0, 2]] - T0_NS) * 1e-9
        np.testing.assert_allclose(epochs_s, middle_s + np.array([low, high]) * camera.exposure_s, atol=3e-3)


def test_single_crossing_stays_unlinked() -> None:
    """A streak without a partner keeps its two hypotheses: no tracklet, SINGLE_FRAME."""
    camera = Camera()
    headers, streaks, _ = observe(
        camera, [pixel_mover(camera, 2000.0, -1000.0, 0.0, 30_000.0, t_s=0.0)], 2, np.random.default_rng(9)
    )
    tracklets = MotionLinker().link(headers, streaks)
    assert tracklets == ()
    linked = apply_links(streaks, tracklets, headers)
    assert len(linked) >= 1
    assert all(s.flags & StreakFlag.SINGLE_FRAME and s.tracklet_id == -1 for s in linked)


def test_empty_and_inconsistent_input() -> None:
    """Nothing gives nothing; a streak of an unknown frame is named."""
    camera = Camera()
    assert MotionLinker().link((), ()) == ()
    headers, streaks, _ = observe(camera, [pixel_mover(camera, 500.0, 500.0, 0.0, 900.0, t_s=0.0)], 4, np.random.default_rng(1))
    assert MotionLinker().link(headers, ()) == ()
    with pytest.raises(ContractError, match="frame 3 have no header"):
        MotionLinker().link(headers[:3], streaks)


def test_order_of_input_does_not_matter() -> None:
    """The same tracklets whatever the order of headers and streaks."""
    camera = Camera()
    movers: list[Mover] = [pixel_mover(camera, 500.0 * k, 300.0, 100.0 * k, 1000.0, t_s=0.0) for k in range(1, 5)]
    headers, streaks, _ = observe(camera, movers, 6, np.random.default_rng(10), false_per_frame=10)
    one = MotionLinker().link(headers, streaks)
    other = MotionLinker().link(headers[::-1], streaks[::-1])
    assert [t.streak_ids.tolist() for t in one] == [t.streak_ids.tolist() for t in other]


def test_reversing_twice_is_nothing() -> None:
    """Exchanging ends twice gives the same streak; once exchanges covariance blocks, intervals, edges and signs."""
    camera = Camera()
    one = streak(camera, 0, 1, np.array([[10.0, 20.0], [200.0, 300.0]]), 0.5, 0.2, StreakFlag.EDGE0)
    one = replace(one, fit=replace(one.fit, covariance_px2=np.diag([1.0, 2.0, 3.0, 4.0]), sagitta_px=0.3))
    once, twice = reversed_streak(one), reversed_streak(reversed_streak(one))
    assert once.flags == StreakFlag.EDGE1
    assert once.fit.sagitta_px == -0.3
    np.testing.assert_array_equal(np.diag(once.fit.covariance_px2), [3.0, 4.0, 1.0, 2.0])
    np.testing.assert_array_equal(once.ra_deg, one.ra_deg[::-1])
    np.testing.assert_array_equal(twice.fit.covariance_px2, one.fit.covariance_px2)
    assert (twice.fit.row0, twice.flags) == (one.fit.row0, one.flags)
