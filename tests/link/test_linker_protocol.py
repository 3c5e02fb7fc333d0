"""What a linker may say and what the chain makes of it: any linker's members are dated and measured the same way; what breaks the
Protocol is refused by name; `sboc check` tries a linker on synthetic frames."""

from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ground.guard import links_of
from ground.link import Member, MotionLinker, apply_links, measured_tracklet
from sboc_e2e.checks import examine
from sboc_e2e.exams.linker import FOCAL_PX, LinkerTrial, linker_trial
from sboc_e2e.icd.errors import PluginError
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakMeasurement, Tracklet
from sboc_e2e.registry import Registry

ARCSEC_PX = 3600.0 * np.degrees(1.0 / FOCAL_PX)


@pytest.fixture(scope="module")
def trial() -> LinkerTrial:
    return linker_trial(turn_rad_s=5e-3, exposure_s=1.0)


@pytest.fixture(scope="module")
def tracklets(trial: LinkerTrial) -> tuple[Tracklet, ...]:
    return MotionLinker().link(trial.headers, trial.streaks)


def units(ra_deg: np.ndarray, dec_deg: np.ndarray) -> np.ndarray:
    ra, dec = np.radians(ra_deg), np.radians(dec_deg)
    return np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], axis=-1)


def test_ends_have_the_attitude_of_the_epoch_that_dates_them(trial: LinkerTrial, tracklets: tuple[Tracklet, ...]) -> None:
    """A camera that turns by 0.3 deg/s: directions of ends are those of their pixels when the shutter opened and closed.

    The reference turns the direction at mid-exposure with scipy. Left where it was an end would be up to 35 arcsec off.
    """
    linked = [s for s in apply_links(trial.streaks, tracklets, trial.headers) if s.flags & StreakFlag.DIRECTION_RESOLVED]
    assert len(linked) > 150
    moved = []
    by_id = {s.streak_id: s for s in trial.streaks}
    for streak in linked:
        given, header = by_id[streak.streak_id], trial.headers[streak.frame]
        same = streak.fit.row0 == given.fit.row0
        ends = units(given.ra_deg, given.dec_deg)[[0, 2] if same else [2, 0]]
        middle_ns = (
            header.t_start_tai_ns + header.exposure_ns / 2 + header.line_time_ns * np.array([streak.fit.row0, streak.fit.row1])
        )
        for k, end in ((0, 0), (1, 2)):
            turned = Rotation.from_rotvec(given.turn_rad_s * (streak.t_tai_ns[end] - middle_ns[k]) * 1e-9).apply(ends[k])
            got = units(streak.ra_deg, streak.dec_deg)[end]
            assert np.degrees(np.linalg.norm(got - turned)) * 3600.0 < 1e-3
            moved.append(np.degrees(np.linalg.norm(got - ends[k])) * 3600.0)
    assert max(moved) > 20.0


def test_epochs_of_a_linker_do_not_date_anything(trial: LinkerTrial, tracklets: tuple[Tracklet, ...]) -> None:
    """A linker whose epochs are off by a third of an exposure, or missing, has its members dated by the shutter all the same."""
    want = apply_links(trial.streaks, tracklets, trial.headers)
    shifted = tuple(replace(t, t_tai_ns=t.t_tai_ns + 330_000_000) for t in tracklets)
    empty = tuple(replace(t, t_tai_ns=np.zeros(0, np.int64), ra_deg=np.zeros(0), dec_deg=np.zeros(0)) for t in tracklets)
    for links in (shifted, empty):
        for one, other in zip(want, apply_links(trial.streaks, links, trial.headers), strict=True):
            assert one.flags == other.flags
            np.testing.assert_array_equal(one.t_tai_ns, other.t_tai_ns)
            np.testing.assert_array_equal(one.ra_deg, other.ra_deg)


def test_a_tracklet_is_measured_on_its_members(trial: LinkerTrial, tracklets: tuple[Tracklet, ...]) -> None:
    """Directions are those of the members' ends, rates are right within their errors, chi-square is that of a good model."""
    linked = {s.streak_id: s for s in apply_links(trial.streaks, tracklets, trial.headers)}
    jacobian = np.tile(ARCSEC_PX * np.eye(2), (3, 1, 1))
    chi2, rates = [], []
    for tracklet in tracklets:
        final = [linked[i] for i in tracklet.streak_ids.tolist()]
        members = [_member(s, jacobian) for s in final]
        made = measured_tracklet(replace(tracklet, ra_deg=np.zeros(0), rate_deg_s=99.0, chi2_nu=99.0), members)
        assert (np.diff(made.t_tai_ns) > 0).all()
        for row, (streak_id, point) in enumerate(zip(made.row_streak_ids, made.row_points, strict=True)):
            streak = linked[int(streak_id)]
            assert made.t_tai_ns[row] == streak.t_tai_ns[point]
            assert made.ra_deg[row] == streak.ra_deg[point]
        seen = units(made.ra_deg, made.dec_deg)
        t_s = (made.t_tai_ns - made.t_ref_tai_ns) * 1e-9
        straight = np.linalg.norm(np.polynomial.polynomial.polyfit(t_s, seen, 1)[1])
        rates.append((made.rate_deg_s - np.degrees(straight)) / made.rate_err_deg_s)
        chi2.append(made.chi2_nu)
        assert 1e-6 < made.rate_err_deg_s < 1e-3
    assert 0.8 < np.median(chi2) < 1.25
    assert np.abs(rates).max() < 5.0


def _member(streak: StreakMeasurement, jacobian: np.ndarray) -> Member:
    return Member(single=streak, final=streak, jacobian_arcsec=jacobian, pointing_arcsec=0.0, shared_arcsec=np.zeros((2, 3)))


def test_a_point_among_trails_has_no_direction(trial: LinkerTrial, tracklets: tuple[Tracklet, ...]) -> None:
    """A star on the first trail, fitted as a point 8 arcsec off with an error of 0.1, changes no direction of the others."""
    tracklet = max(tracklets, key=lambda t: len(t.frames))
    linked = {s.streak_id: s for s in apply_links(trial.streaks, tracklets, trial.headers)}
    members = [_member(linked[i], np.tile(ARCSEC_PX * np.eye(2), (3, 1, 1))) for i in tracklet.streak_ids.tolist()]
    first = members[0].final
    tiny = replace(
        first.fit, row1=first.fit.row0, col1=first.fit.col0, covariance_px2=1e-4 * np.eye(4), flags=StreakFlag.POINT_LIKE
    )
    star = replace(first, fit=tiny, dec_deg=first.dec_deg + 8.0 / 3600.0, flags=first.flags | StreakFlag.POINT_LIKE)
    made = measured_tracklet(tracklet, [_member(star, members[0].jacobian_arcsec), *members[1:]])
    without = measured_tracklet(tracklet, members[1:])
    np.testing.assert_array_equal(made.ra_deg, without.ra_deg)
    np.testing.assert_array_equal(made.row_streak_ids, without.row_streak_ids)
    assert made.rate_deg_s == without.rate_deg_s


def test_rows_that_share_their_errors_say_less_of_the_rate(trial: LinkerTrial, tracklets: tuple[Tracklet, ...]) -> None:
    """Ends on one fitted line have the errors of its two numbers: the error of the rate is that of the line, not of 2 n ends."""
    tracklet = max(tracklets, key=lambda t: len(t.frames))
    linked = {s.streak_id: s for s in apply_links(trial.streaks, tracklets, trial.headers)}
    final = [linked[i] for i in tracklet.streak_ids.tolist()]
    zero_ns = int(final[len(final) // 2].t_tai_ns[1])
    sigma_place, sigma_rate = 1.5, 0.4
    members, jacobian = [], np.tile(ARCSEC_PX * np.eye(2), (3, 1, 1))
    for s in final:
        t_s = (s.t_tai_ns[[0, 2]] - zero_ns) * 1e-9
        shared = np.column_stack([np.full(2, sigma_place), sigma_rate * t_s, np.zeros(2)])
        along = np.array([s.fit.row1 - s.fit.row0, s.fit.col1 - s.fit.col0]) / s.fit.length_px
        across = np.array([-along[1], along[0]])
        block = [
            np.outer(along, along) * (shared[k] @ shared[k]) / ARCSEC_PX**2 + 0.02 * np.outer(across, across) for k in (0, 1)
        ]
        covariance = np.zeros((4, 4))
        covariance[:2, :2], covariance[2:, 2:] = block
        fitted = replace(s, fit=replace(s.fit, covariance_px2=covariance), flags=s.flags | StreakFlag.REFIT)
        members.append(replace(_member(fitted, jacobian), shared_arcsec=shared, group=0))
    made = measured_tracklet(tracklet, members)
    # a change of the rate is free within its prior, which adds a little
    assert 0.99 * sigma_rate < made.rate_err_deg_s * 3600.0 < 1.15 * sigma_rate
    alone = measured_tracklet(tracklet, [replace(m, group=-1) for m in members])
    assert alone.rate_err_deg_s < 0.7 * made.rate_err_deg_s


def test_an_end_moved_along_a_slanting_trail_errs_across_the_motion(trial: LinkerTrial, tracklets: tuple[Tracklet, ...]) -> None:
    """The camera turning puts equal errors on both axes.

    A joint fit that moves ends along a trail at 40 degrees to the motion, to where the motion was, leaves 1 / cos(40 deg) of
    them, all across: against draws.
    """
    tracklet = max(tracklets, key=lambda t: len(t.frames))
    linked = {s.streak_id: s for s in apply_links(trial.streaks, tracklets, trial.headers)}
    slant, sigma_rate, members = np.radians(40.0), 0.7, []
    for s in (linked[i] for i in tracklet.streak_ids.tolist()):
        unit = units(s.ra_deg, s.dec_deg)
        east = np.array([-unit[1, 1], unit[1, 0], 0.0]) / np.hypot(unit[1, 0], unit[1, 1])
        moved = unit[2] - unit[0]
        angle = np.arctan2(moved @ np.cross(unit[1], east), moved @ east) + slant
        along = np.array([s.fit.row1 - s.fit.row0, s.fit.col1 - s.fit.col0]) / s.fit.length_px
        turned = angle - np.arctan2(along[1], along[0])
        jacobian = ARCSEC_PX * np.array([[np.cos(turned), -np.sin(turned)], [np.sin(turned), np.cos(turned)]])
        fit = replace(s.fit, covariance_px2=1e-8 * np.eye(4))
        refit = replace(s, fit=fit, flags=s.flags | StreakFlag.REFIT)
        members.append(replace(_member(refit, np.tile(jacobian, (3, 1, 1))), sigma_rate_arcsec_s=sigma_rate))
    made = measured_tracklet(tracklet, members)
    errors = np.random.default_rng(1).normal(size=(200_000, 2))
    left = errors - np.outer(errors[:, 0] / np.cos(slant), [np.cos(slant), np.sin(slant)])
    half_s = 0.5e-9 * np.array([np.ptp(linked[int(k)].t_tai_ns[[0, 2]]) for k in made.row_streak_ids])
    np.testing.assert_allclose(made.sigma_cross_arcsec, sigma_rate * half_s * np.std(left[:, 1]), rtol=0.02)
    np.testing.assert_allclose(np.abs(made.turning_arcsec), made.sigma_cross_arcsec, rtol=0.02)
    assert made.sigma_along_arcsec.max() < 0.01 * made.sigma_cross_arcsec.min()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"probability": 1.5}, "probability: expected 0 to 1, got 1.5"),
        ({"probability": np.nan}, "probability: expected 0 to 1, got nan"),
        ({"pieces": np.array([12_345_678])}, "pieces: streak 12345678 is none of its members"),
        ({"frames": None, "streak_ids": None}, "expected one or more members"),
    ],
)
def test_what_breaks_the_protocol_is_refused_by_name(
    trial: LinkerTrial, tracklets: tuple[Tracklet, ...], change: dict, message: str
) -> None:
    change = {name: np.zeros(0, dtype=np.int64) if value is None else value for name, value in change.items()}
    counts = Counter(s.frame for s in trial.streaks)
    with pytest.raises(PluginError, match=rf"linker .*MotionLinker, tracklet 0: {message}"):
        links_of(MotionLinker(), (replace(tracklets[0], **change),), counts)


def test_direction_of_one_frame_needs_a_motion(trial: LinkerTrial, tracklets: tuple[Tracklet, ...]) -> None:
    """Members of one frame do not tell which way the object went; the linker must, or say that it does not know."""
    counts = Counter(s.frame for s in trial.streaks)
    one = replace(tracklets[0], frames=tracklets[0].frames[:1], streak_ids=tracklets[0].streak_ids[:1])
    assert links_of(MotionLinker(), (one,), counts) == (one,)
    with pytest.raises(PluginError, match="direction_resolved: members of one frame"):
        links_of(MotionLinker(), (replace(one, ra_deg=np.full(len(one.ra_deg), np.nan)),), counts)


@dataclass(frozen=True, kw_only=True)
class AllInOne:
    """Every streak in one tracklet."""

    share: float = field(default=1.0, metadata={"doc": "of the streaks"})

    def link(self, headers, streaks):
        """One tracklet."""
        found = MotionLinker().link(headers, streaks)
        if not found:
            return ()
        used = list(streaks)
        return (
            replace(
                found[0],
                streak_ids=np.array([s.streak_id for s in used], dtype=np.int64),
                frames=np.array([s.frame for s in used], dtype=np.int64),
                pieces=np.zeros(0, dtype=np.int64),
            ),
        )


@dataclass(frozen=True, kw_only=True)
class Twice:
    """Every tracklet twice."""

    reach: int = field(default=4, metadata={"doc": "frames"})

    def link(self, headers, streaks):
        """The same tracklets again under other ids."""
        found = MotionLinker().link(headers, streaks)
        return (*found, *(replace(t, tracklet_id=t.tracklet_id + 1000) for t in found))


@dataclass(frozen=True, kw_only=True)
class Blind:
    """A linker that does not know that cameras turn."""

    reach: int = field(default=4, metadata={"doc": "frames"})

    def link(self, headers, streaks):
        """Links as if the camera stood still."""
        return MotionLinker().link(headers, [replace(s, turn_rad_s=np.zeros(3)) for s in streaks])


@pytest.mark.parametrize(
    ("kind", "failed"),
    [
        (MotionLinker, ()),
        (AllInOne, ("links most of 12 objects before a camera at rest",)),
        (Twice, ("keeps its Protocol before a camera at rest", "keeps its Protocol before a camera that turns by 0.3 deg/s")),
        (Blind, ("links most of 12 objects before a camera that turns by 0.3 deg/s",)),
    ],
)
def test_the_exam_tells_linkers_apart(kind: type, failed: tuple[str, ...]) -> None:
    """Figures are reported where a linker passes; a fault is found by the question that is about it."""
    seam, verdicts = examine(f"{kind.__module__}:{kind.__qualname__}", Registry(), "ground.linker")
    assert seam.name == "ground.linker"
    found = {v.question for v in verdicts if not v.passed}
    assert set(failed) <= found
    if not failed:
        assert not found
        assert any("completeness 12/12, purity" in v.detail for v in verdicts)


def test_errors_of_a_joint_fit_are_not_widened_again(trial: LinkerTrial, tracklets: tuple[Tracklet, ...]) -> None:
    """Its covariance holds the tails of its draws: the error stated along the motion is its own (1.5 times it before)."""
    tracklet = max(tracklets, key=lambda t: len(t.frames))
    linked = {s.streak_id: s for s in apply_links(trial.streaks, tracklets, trial.headers)}
    jacobian = np.tile(ARCSEC_PX * np.eye(2), (3, 1, 1))
    stated = []
    for change_point in (StreakFlag(0), StreakFlag.ENDS_NOT_GAUSSIAN):
        fitted = [
            replace(s, fit=replace(s.fit, flags=s.fit.flags | change_point), flags=s.flags | StreakFlag.REFIT)
            for s in (linked[i] for i in tracklet.streak_ids.tolist())
        ]
        stated.append(measured_tracklet(tracklet, [_member(s, jacobian) for s in fitted]).sigma_along_arcsec)
    np.testing.assert_allclose(stated[1], stated[0], rtol=1e-12)


def test_the_68_percent_interval_of_a_joint_fit_is_stated(trial: LinkerTrial, tracklets: tuple[Tracklet, ...]) -> None:
    """Two thirds of the standard deviation, as of a change point; a single fit states its sigma."""
    tracklet = max(tracklets, key=lambda t: len(t.frames))
    linked = {s.streak_id: s for s in apply_links(trial.streaks, tracklets, trial.headers)}
    jacobian = np.tile(ARCSEC_PX * np.eye(2), (3, 1, 1))
    for flag, share in ((StreakFlag.REFIT, 2.0 / 3.0), (StreakFlag(0), 1.0)):
        fitted = []
        for s in (linked[i] for i in tracklet.streak_ids.tolist()):
            along = np.array([s.fit.row1 - s.fit.row0, s.fit.col1 - s.fit.col0]) / s.fit.length_px
            sigma = np.sqrt([along @ s.fit.covariance_px2[k : k + 2, k : k + 2] @ along for k in (0, 2)])
            interval = 2.0 / 3.0 * sigma[:, None] * np.array([-1.2, 0.8])
            fitted.append(replace(s, fit=replace(s.fit, end_interval_px=interval), flags=s.flags | flag))
        made = measured_tracklet(tracklet, [replace(_member(s, jacobian), pointing_arcsec=0.0) for s in fitted])
        np.testing.assert_allclose(made.half68_along_arcsec, share * made.sigma_along_arcsec, rtol=0.01)
