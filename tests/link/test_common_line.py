"""Members of on-board tracks moved onto one line: pulls and errors over the joint Cramér-Rao bound, with a camera of its own."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import ndtr

from ground.link.common_line import PlacedTrail, on_common_line
from ground.link.measured import SIGMA_ACCELERATION_ARCSEC_S2
from ground.sky.sphere import ARCSEC_RAD, east_north, spherical_deg
from ground.streaks.fit_record import reversed_ends
from ground.streaks.forced import forced_fit
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakFit, StreakMeasurement, StreakPixels
from sboc_e2e.icd.signals import Detection

Array = NDArray[np.float64]
SCALE_ARCSEC, TURNED_RAD, POINTING_PX = 5.0, 0.7, 0.02
CENTRE = np.array([0.36, 0.48, 0.8])
AXES = np.array(east_north(CENTRE))
TO_PLANE = SCALE_ARCSEC * ARCSEC_RAD * np.array(
    [[np.sin(TURNED_RAD), np.cos(TURNED_RAD)], [np.cos(TURNED_RAD), -np.sin(TURNED_RAD)]]
)  # fmt: skip
FRAME_S, EXPOSURE_S = 0.25, 0.2


def directions(px: Array) -> Array:
    """Unit vectors (n, 3) of pixels (n, 2), row and col from the optical axis."""
    seen = CENTRE + px @ TO_PLANE.T @ AXES
    return np.asarray(seen / np.linalg.norm(seen, axis=1)[:, None])


def jacobian(px: Array) -> Array:
    """East and north in arcsec by row and col at pixels (n, 2)."""
    here = directions(px)
    steps = np.stack([directions(px + step) - here for step in np.eye(2)], axis=2)
    return np.array([np.array(east_north(h)) @ s for h, s in zip(here, steps, strict=True)]) / ARCSEC_RAD


def trail(ends: Array, frame: int, sigma_px: float, snr: float, tilt: bool, track: int = 0) -> PlacedTrail:
    """A member with ends (2, 2); across they share one error, or have that of a line fit."""
    along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    across = np.outer(*[np.array([-along[1], along[0]])] * 2)
    # ends of variance 4 and covariance -2: a place of variance 1, a difference of 12, as of a trail of even light
    block = np.array([[4.0, -2.0], [-2.0, 4.0]]) if tilt else np.ones((2, 2))
    fit = StreakFit(
        row0=ends[0, 0], col0=ends[0, 1], row1=ends[1, 0], col1=ends[1, 1],
        covariance_px2=np.kron(np.eye(2), np.outer(along, along)) + sigma_px**2 * np.kron(block, across),
        end_interval_px=np.ones((2, 2)), sigma_cross_px=sigma_px, flux_e=1.0, flux_err_e=1.0, snr=snr, sagitta_px=0.0,
        sagitta_err_px=1.0, gradient=0.0, width_px=0.9, width_err_px=0.1, chi2_nu=1.0, n_pixels=50, flags=StreakFlag(0),
        light_curve_e_px=np.zeros(0, dtype=np.float32),
    )  # fmt: skip
    points = np.array([ends[0], ends.mean(axis=0), ends[1]])
    ra_deg, dec_deg = spherical_deg(directions(points))
    start = 10**18 + round(1e9 * FRAME_S * frame)
    streak = StreakMeasurement(
        frame=frame, streak_id=frame, roi_id=0, fit=fit, row_mid=points[1, 0], col_mid=points[1, 1], ra_deg=ra_deg,
        dec_deg=dec_deg, t_tai_ns=start + np.array([0, round(0.5e9 * EXPOSURE_S), round(1e9 * EXPOSURE_S)]),
        sigma_along_arcsec=1.0, sigma_cross_arcsec=1.0, mag=12.0, mag_err=0.1, probability=1.0, tracklet_id=0,
        flags=StreakFlag.DIRECTION_RESOLVED, track=track,
    )  # fmt: skip
    return PlacedTrail(streak=streak, jacobian_arcsec=jacobian(points), pointing_arcsec=POINTING_PX * SCALE_ARCSEC)


def on_line(trails: list[PlacedTrail]) -> dict[int, StreakMeasurement]:
    """Members that are moved."""
    return on_common_line(trails).members


def drawn(rng: np.random.Generator, n: int) -> tuple[list[PlacedTrail], Array, Array, float]:
    """A group of n members with S/N as noise shows it; the true ends (n, 2, 2) in px, the direction across (2,), the true S/N."""
    angle, length, snr = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(15.0, 60.0), rng.uniform(3.5, 8.0)
    way = np.array([np.sin(angle), np.cos(angle)])
    side = np.array([-way[1], way[0]])
    t = FRAME_S * np.arange(n)[:, None] + np.array([0.0, EXPOSURE_S])
    t = t - t.mean()
    bend = rng.normal(0.0, SIGMA_ACCELERATION_ARCSEC_S2 / SCALE_ARCSEC)
    start = rng.uniform(-300.0, 300.0, 2)
    true = start + (length / EXPOSURE_S * t)[..., None] * way + (0.5 * bend * t**2)[..., None] * side
    trails = []
    for k in range(n):
        seen = max(snr + rng.normal(), 1.5)
        tilt, sigma = bool(seen > 7.0), 1.3 / snr
        off = rng.normal(0.0, sigma) + rng.normal(0.0, POINTING_PX)
        turned = rng.normal(0.0, sigma * np.sqrt(12.0)) if tilt else rng.normal(0.0, 0.5)
        shift = np.array([off - 0.5 * turned, off + 0.5 * turned])
        along = rng.normal(0.0, 1.0, 2)
        trails.append(trail(true[k] + shift[:, None] * side + along[:, None] * way, k, 1.3 / seen, seen, tilt))
    return trails, true, side, snr


@pytest.mark.parametrize("n", [2, 4, 9])
def test_members_on_the_line_err_as_stated_and_reach_the_joint_bound(n: int) -> None:
    """250 groups of faint and bright frames: pulls of places and ends 0.9 to 1.1; errors over the bound of all frames 1.0."""
    rng = np.random.default_rng(n)
    pulls, ends, ratio, own = [], [], [], []
    for _ in range(250):
        trails, true, side, snr = drawn(rng, n)
        moved = on_line(trails)
        for k, streak in moved.items():
            fit = streak.fit
            error = (np.array([[fit.row0, fit.col0], [fit.row1, fit.col1]]) - true[k]) @ side
            error += rng.normal(0.0, POINTING_PX)  # the frame's own attitude
            pulls.append(error.mean() / fit.sigma_cross_px)
            blocks = np.asarray(fit.covariance_px2).reshape(2, 2, 2, 2)
            ends += [error[e] / np.sqrt(side @ blocks[e, :, e] @ side) for e in range(2)]
            own.append(fit.sigma_cross_px / trails[k].streak.fit.sigma_cross_px)
            ratio.append(np.square(error.mean()) / _bound_px2(trails, k, snr))
    assert len(pulls) > 400
    assert np.std(pulls) == pytest.approx(1.0, abs=0.1)
    assert np.std(ends) == pytest.approx(1.0, abs=0.1)
    assert np.sqrt(np.mean(ratio)) == pytest.approx(1.0, abs=0.1)
    assert np.median(own) < {2: 1.05, 4: 0.85, 9: 0.6}[n]


@pytest.mark.parametrize("n", [3, 8])
def test_ends_share_the_errors_of_the_line(n: int) -> None:
    """Mean place and rate across of all ends of 300 groups: pulls 0.85 to 1.15 by shared errors, 1.5 by independent ones."""
    rng = np.random.default_rng(20 + n)
    mean, slope, apart = [], [], []
    for _ in range(300):
        trails, true, side, _ = drawn(rng, n)
        line = on_common_line(trails)
        if len(line.members) < n:
            continue
        t_s = (FRAME_S * np.arange(n)[:, None] + np.array([0.0, EXPOSURE_S])).ravel()
        t_s -= t_s.mean()
        errors = []
        for k, streak in line.members.items():
            fit = streak.fit
            errors.append((np.array([[fit.row0, fit.col0], [fit.row1, fit.col1]]) - true[k]) @ side * SCALE_ARCSEC)
        off, shared = np.concatenate(errors), np.concatenate([line.shared_arcsec[k] for k in line.members])
        # pixels of the axes turn to the sky with either sign, which a variance does not see
        for pulls, weight in ((mean, np.full(2 * n, 0.5 / n)), (slope, t_s / (t_s @ t_s))):
            pulls.append(weight @ off / np.linalg.norm(weight @ shared))
        apart.append(off.mean() / np.sqrt(np.sum(shared**2)) * 2 * n)
    assert len(mean) > 200
    assert np.std(mean) == pytest.approx(1.0, abs=0.15)
    assert np.std(slope) == pytest.approx(1.0, abs=0.15)
    assert np.std(apart) > 1.5


def _bound_px2(trails: list[PlacedTrail], k: int, snr: float) -> float:
    """Joint bound of the place in frame k, px^2: Fisher matrix of place, slope and bend (with its prior) over frames."""
    frames = FRAME_S * (np.arange(len(trails)) - 0.5 * (len(trails) - 1))
    rows = np.stack([np.ones_like(frames), frames, 0.5 * frames**2], axis=1)
    information = np.diag([0.0, 0.0, (SIGMA_ACCELERATION_ARCSEC_S2 / SCALE_ARCSEC) ** -2])
    for row, each in zip(rows, trails, strict=True):
        variance = (1.3 / snr) ** 2
        information += np.outer(row, row) / (variance + POINTING_PX**2)
        if each.streak.fit.snr > 7.0:
            step = np.array([0.0, EXPOSURE_S, EXPOSURE_S * row[1]])
            information += np.outer(step, step) / (12.0 * variance)
    return float(rows[k] @ np.linalg.inv(information) @ rows[k]) + POINTING_PX**2


def test_a_star_beside_one_frame_does_not_bend_the_line_and_the_member_lies_on_it() -> None:
    """One of nine members 3 px off: the others lie on the line that they have without it, and so does that one."""
    rng = np.random.default_rng(5)
    trails, true, side, _ = drawn(rng, 9)
    k = next(iter(on_line(trails)))
    streak = trails[k].streak
    ends = np.array([[streak.fit.row0, streak.fit.col0], [streak.fit.row1, streak.fit.col1]]) + 3.0 * side
    spoilt = [*trails]
    spoilt[k] = trail(ends, streak.frame, streak.fit.sigma_cross_px, streak.fit.snr, tilt=False)
    moved = on_line(spoilt)
    without = on_line([t for i, t in enumerate(trails) if i != k])
    fit = moved.pop(k).fit
    off = float((np.array([fit.row0 + fit.row1, fit.col0 + fit.col1]) / 2.0 - true[k].mean(axis=0)) @ side)
    assert abs(off) < 3.5 * fit.sigma_cross_px < 1.0
    assert [m.fit.row0 for _, m in sorted(moved.items())] == pytest.approx([m.fit.row0 for _, m in sorted(without.items())])


def test_a_star_that_the_joint_refit_left_out_does_not_bend_the_line_and_lies_on_it() -> None:
    """One of nine, brighter than the others by a star, 0.3 px off with an error of 0.2: placed by the eight others."""
    rng = np.random.default_rng(7)
    trails, true, side, _ = drawn(rng, 9)
    trails = [replace(t, streak=replace(t.streak, flags=t.streak.flags | StreakFlag.REFIT)) for t in trails]
    star = trail(true[4] + 0.3 * side, 4, 0.2, 26.0, tilt=True)
    moved = on_line([*trails[:4], star, *trails[5:]])
    without = on_line([*trails[:4], *trails[5:]])
    assert [moved[k].fit.row0 for k in range(4)] == pytest.approx([without[k].fit.row0 for k in range(4)])
    fit = moved[4].fit
    off = float((np.array([fit.row0 + fit.row1, fit.col0 + fit.col1]) / 2.0 - true[4].mean(axis=0)) @ side)
    assert abs(off) < 3.5 * fit.sigma_cross_px < 0.7


def test_what_is_of_no_on_board_track_or_foretold_stays() -> None:
    """Only members of on-board tracks are moved; three places that disagree move none."""
    rng = np.random.default_rng(6)
    trails, _, side, _ = drawn(rng, 6)
    moved = on_line(trails)
    assert set(moved) == set(range(6))
    assert all(m.flags & StreakFlag.REFIT for m in moved.values())
    assert on_line([replace(t, streak=replace(t.streak, track=-1)) for t in trails]) == {}
    foretold = [replace(t, streak=replace(t.streak, fit=replace(t.streak.fit, track_frames=32.0))) for t in trails]
    assert on_line(foretold) == {}
    apart = []
    for k, each in enumerate(trails[:3]):
        fit = each.streak.fit
        ends = np.array([[fit.row0, fit.col0], [fit.row1, fit.col1]]) + (30.0 if k == 1 else 0.0) * side
        apart.append(trail(ends, k, 0.3, 4.0, tilt=False))
    assert on_line(apart) == {}


def test_light_on_the_line_is_not_what_noise_adds_where_a_frame_puts_its_trail() -> None:
    """40 groups of seven frames of S/N 4: fluxes where frames put trails are 0.12 of their errors higher than on the line."""
    rng = np.random.default_rng(40)
    own, on_the_line = [], []
    for _ in range(40):
        trails, flux_e = _exposed_group(rng, 7, 4.0)
        for k, streak in on_line(trails).items():
            before, after = trails[k].streak.fit, streak.fit
            own.append((before.flux_e - flux_e) / before.flux_err_e)
            on_the_line.append((after.flux_e - flux_e) / after.flux_err_e)
    assert len(own) > 240
    assert np.mean(own) - np.mean(on_the_line) == pytest.approx(0.12, abs=0.05)
    assert np.std(on_the_line) == pytest.approx(1.0, abs=0.1)


def _exposed_group(rng: np.random.Generator, n: int, snr: float) -> tuple[list[PlacedTrail], float]:
    """Members measured by forced fits in white noise, on one line that their track has 0.3 px off; and their true flux."""
    length, noise_e, psf_px = 25.0, 10.0, 0.9
    width = np.hypot(psf_px, np.sqrt(1.0 / 12.0))
    flux_e = snr * noise_e * np.sqrt(2.0 * np.sqrt(np.pi) * width * length)
    angle = rng.uniform(0.0, 2.0 * np.pi)
    way = np.array([np.sin(angle), np.cos(angle)])
    side = np.array([-way[1], way[0]])
    trails = []
    for k in range(n):
        middle = (k - 0.5 * (n - 1)) * length / EXPOSURE_S * FRAME_S * way
        place = middle + 0.3 * rng.choice([-1.0, 1.0]) * side
        row, col = (x.ravel() for x in np.mgrid[-20:21, -20:21] + np.rint(middle)[:, None, None])
        u, v = (row - middle[0]) * way[0] + (col - middle[1]) * way[1], (row - middle[0]) * side[0] + (col - middle[1]) * side[1]
        share = ndtr((u + 0.5 * length) / width) - ndtr((u - 0.5 * length) / width)
        light = flux_e / length * share * np.exp(-0.5 * (v / width) ** 2) / (np.sqrt(2.0 * np.pi) * width)
        pixels = StreakPixels(
            row=row.astype(np.int32), col=col.astype(np.int32), psf_sigma_px=psf_px, frame_shape=(10_000, 10_000),
            value_e=(light + rng.normal(0.0, noise_e, row.size)).astype(np.float32),
            variance_e2=np.full(row.size, noise_e**2, dtype=np.float32),
        )  # fmt: skip
        ends = place + 0.5 * length * np.array([-1.0, 1.0])[:, None] * way
        found = Detection(row0=ends[0, 0], col0=ends[0, 1], row1=ends[1, 0], col1=ends[1, 1], snr=snr)
        fit = forced_fit(pixels, found, snr * np.sqrt(n))
        at = np.array([[fit.row0, fit.col0], [fit.row1, fit.col1]])
        member = trail(at if (at[1] - at[0]) @ way > 0.0 else at[::-1], k, fit.sigma_cross_px, fit.snr, tilt=False)
        fit = fit if (at[1] - at[0]) @ way > 0.0 else reversed_ends(fit)
        trails.append(replace(member, streak=replace(member.streak, fit=fit), pixels=pixels))
    return trails, flux_e
