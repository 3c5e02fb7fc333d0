"""Injected biases of clock and pointing come back within their own intervals, from passes of real GPS and Galileo satellites."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from astropy import units as u
from astropy.coordinates import GCRS, ITRS, CartesianRepresentation, EarthLocation
from astropy.time import Time, TimeDelta
from scipy.interpolate import BarycentricInterpolator

pytest.importorskip("satkit", reason="satkit propagates orbits (extra `objects`)")

from ground.determination.precise import Ephemeris, orbit_of, read_sp3
from ground.orbit.reference import PreciseOrbit
from ground.products.epochs import utc_text
from ground.sensor_bias.correct import calibration_text, corrected, nearest, read_calibration, widened
from ground.sensor_bias.estimate import Track, estimate, identified, sessions_of
from ground.store.store import ObjectStore
from sboc_e2e.cli.main import run
from sboc_e2e.icd import tai
from sboc_e2e.icd.errors import UserError
from sboc_e2e.objects.places import place_of_site
from tests.conjunctions.reference import folder
from tests.determination.burnt_table import burnt_table
from tests.sensor_bias.test_places import message as oem

SITE = "38.2,-6.6,570"
LATE_S, EAST, NORTH = 0.020, 3.0, -1.5
ARCSEC = np.radians(1.0 / 3600.0)
LIGHT_KM_S = 299_792.458


def gcrs(itrs_km: np.ndarray, t_tai_ns: np.ndarray) -> np.ndarray:
    """Earth-fixed to GCRS axes by astropy."""
    when = Time("1958-01-01T00:00:00", scale="tai") + TimeDelta(t_tai_ns * 1e-9 * u.s)
    point = ITRS(CartesianRepresentation(*(itrs_km.T * u.km)), obstime=when)
    return point.transform_to(GCRS(obstime=when)).cartesian.xyz.to_value(u.km).T


@pytest.fixture(scope="module")
def sky() -> tuple[list[PreciseOrbit], list[tuple[np.ndarray, np.ndarray, np.ndarray]]]:
    """Orbits as the calibration has them, and true passes: epochs, directions, apparent motion (per s), from the file alone."""
    path = folder("sp3") / "gbm18432.sp3.Z"
    every = read_sp3(path.read_bytes(), path.name)
    names = ["G01", "G05", "G11", "G13", "G19", "G22", "G31", "E11", "E12", "E19"]
    orbits = [orbit_of(every[name]) for name in names]
    site = EarthLocation.from_geodetic(-6.6 * u.deg, 38.2 * u.deg, 570 * u.m)
    fixed = np.array([site.x.to_value(u.km), site.y.to_value(u.km), site.z.to_value(u.km)])
    passes = []
    for k, name in enumerate(names):
        one: Ephemeris = every[name]
        # ten directions in five minutes, at one epoch or another of the night; whether the Earth is in the way does not matter
        middle = 40 + 20 * k
        t = one.t_tai_ns[middle] + (np.arange(10) * 30e9).astype(np.int64)
        nodes = slice(middle - 6, middle + 8)
        place = gcrs(one.itrs_km[nodes], one.t_tai_ns[nodes])
        path_of = BarycentricInterpolator((one.t_tai_ns[nodes] - one.t_tai_ns[middle]) * 1e-9, place)

        def seen(shift_s: float, path_of=path_of, t=t, middle=middle, one=one) -> np.ndarray:
            seconds = (t - one.t_tai_ns[middle]) * 1e-9 + shift_s
            observer = gcrs(np.tile(fixed, (len(t), 1)), t + round(shift_s * 1e9))
            delay = np.zeros(len(t))
            for _ in range(4):
                line = path_of(seconds - delay) - observer
                delay = np.linalg.norm(line, axis=1) / LIGHT_KM_S
            return line / np.linalg.norm(line, axis=1, keepdims=True)

        passes.append((t, seen(0.0), seen(0.5) - seen(-0.5)))
    return orbits, passes


def observed(passes, rng: np.random.Generator, *, common_arcsec: float = 0.0) -> list[Track]:
    """Tags late, pointing off, noise of 1.0 by 0.6 arcsec along and across, and what a track shares."""
    tracks = []
    for t, direction, rate in passes:
        heading = rate / np.linalg.norm(rate, axis=1, keepdims=True)
        side = np.cross(direction, heading)
        east = np.cross([0.0, 0.0, 1.0], direction)
        east /= np.linalg.norm(east, axis=1, keepdims=True)
        north = np.cross(direction, east)
        noise = rng.standard_normal((len(t), 2)) * [1.0, 0.6] + common_arcsec * rng.standard_normal(2)
        # tagged t: seen LATE_S earlier
        shown = direction - LATE_S * rate
        shown = shown + ARCSEC * (EAST * east + NORTH * north + noise[:, :1] * heading + noise[:, 1:] * side)
        tracks.append(Track(t_tai_ns=t, direction=shown / np.linalg.norm(shown, axis=1, keepdims=True)))
    return tracks


def coverage(sky, n: int, common_arcsec: float) -> tuple[np.ndarray, np.ndarray]:
    """Shares (3,) of sessions whose 90 % intervals hold the truth, and pulls (n, 3)."""
    orbits, passes = sky
    place = place_of_site(SITE)
    truth = np.array([LATE_S, EAST, NORTH])
    inside, pulls = [], []
    for k in range(n):
        found = estimate(
            observed(passes, np.random.default_rng(k), common_arcsec=common_arcsec), place, orbits, shares_clock=False
        )
        away = np.array([found.time_s, found.east_arcsec, found.north_arcsec]) - truth
        inside.append(np.abs(away) < found.half_widths(0.9))
        pulls.append(away / np.sqrt(np.diag(found.covariance)))
    return np.mean(inside, axis=0), np.array(pulls)


@pytest.mark.slow
@pytest.mark.parametrize("common_arcsec", [0.0, 0.5])
def test_intervals_hold_the_truth_as_often_as_they_say(sky, common_arcsec: float) -> None:
    shares, pulls = coverage(sky, 240, common_arcsec)
    # 720 intervals together, three of a session from the same tracks: 86 to 94 %
    assert 0.86 <= shares.mean() <= 0.94
    assert np.abs(pulls.mean(axis=0)).max() < 0.35


def test_a_session_gives_back_what_was_injected(sky) -> None:
    orbits, passes = sky
    found = estimate(observed(passes, np.random.default_rng(3)), place_of_site(SITE), orbits, shares_clock=False)
    assert found.n_tracks == 10
    assert abs(found.time_s - LATE_S) < 4.0 * np.sqrt(found.covariance[0, 0]) < 0.02
    assert abs(found.east_arcsec - EAST) < 4.0 * np.sqrt(found.covariance[1, 1]) < 1.0
    assert abs(found.north_arcsec - NORTH) < 4.0 * np.sqrt(found.covariance[2, 2]) < 1.0
    assert found.noise_along_arcsec == pytest.approx(1.0, abs=0.25)
    assert found.noise_cross_arcsec == pytest.approx(0.6, abs=0.15)


def test_corrections_remove_the_bias(sky) -> None:
    orbits, passes = sky
    place = place_of_site(SITE)
    tracks = observed(passes, np.random.default_rng(4))
    text = calibration_text("t", [estimate(tracks, place, orbits, shares_clock=False)])
    (bias,) = read_calibration(text, "file")
    mended = [corrected(track, nearest([bias], int(track.t_tai_ns[0]))) for track in tracks]
    again = estimate(mended, place, orbits, shares_clock=False)
    assert abs(again.time_s) < 1e-4
    assert abs(again.east_arcsec) < 0.01
    assert abs(again.north_arcsec) < 0.01


def test_outliers_are_clipped_and_strangers_left_out(sky) -> None:
    orbits, passes = sky
    tracks = observed(passes, np.random.default_rng(5))
    spoiled = tracks[0].direction.copy()
    spoiled[4] += 30.0 * ARCSEC * np.array([0.0, 0.0, 1.0])
    tracks[0] = Track(t_tai_ns=tracks[0].t_tai_ns, direction=spoiled)
    stranger = Track(t_tai_ns=tracks[1].t_tai_ns, direction=np.roll(tracks[1].direction, 1, axis=1))
    found = estimate([*tracks, stranger], place_of_site(SITE), orbits, shares_clock=False)
    assert found.n_tracks == 10
    assert found.n_clipped == 1
    with pytest.raises(UserError, match="0 of 1 tracks belong to one precise orbit"):
        estimate([stranger], place_of_site(SITE), orbits, shares_clock=False)


def part_of(orbit: PreciseOrbit, first_h: float, last_h: float, name: str = "", off_km: float = 0.0) -> PreciseOrbit:
    """Some hours of an orbit, under another name, moved along one axis."""
    hours = (orbit.t_tai_ns - orbit.t_tai_ns[0]) / 3.6e12
    these = (hours >= first_h) & (hours <= last_h)
    moved = orbit.position_km[these] + [0.0, 0.0, off_km]
    return PreciseOrbit(
        name=name or orbit.name, t_tai_ns=orbit.t_tai_ns[these], position_km=moved, velocity_km_s=orbit.velocity_km_s[these]
    )


def test_an_object_that_several_files_hold_is_one(sky) -> None:
    """The track is at 3.3 h. At 20,000 km 5 arcsec are 0.5 km and 600 arcsec are 60 km."""
    orbits, passes = sky
    track = observed(passes, np.random.default_rng(5))[0]
    whole, here = orbits[0], place_of_site(SITE)(track.t_tai_ns)
    old, new = part_of(whole, 0.0, 20.0, off_km=3.0), part_of(whole, 2.0, 22.0)
    other_name = part_of(whole, 1.0, 24.0, "gps63", off_km=0.1)
    stranger = part_of(whole, 0.0, 24.0, "G99", off_km=3.0)
    assert identified(track, here, [old, new], 600.0) is new
    assert identified(track, here, [new, old, other_name, orbits[1]], 600.0) is new
    assert (
        identified(track, here, [whole, old, new, part_of(whole, 2.0, 9.0, off_km=0.01)], 600.0).t_tai_ns[-1] < new.t_tai_ns[-1]
    )
    assert identified(track, here, [new, stranger], 600.0) is None
    assert identified(track, here, [old, new, stranger], 600.0) is None
    # a table that ends before the track says nothing of it
    assert identified(track, here, [old, part_of(whole, 2.5, 3.0)], 600.0) is old
    assert identified(track, here, [orbits[1]], 600.0) is None


def test_orbits_of_overlapping_files_calibrate_as_those_of_one(sky) -> None:
    orbits, passes = sky
    tracks = observed(passes, np.random.default_rng(5))
    twice = [*orbits, *(part_of(orbit, 0.0, 30.0) for orbit in orbits)]
    one, both = (estimate(tracks, place_of_site(SITE), given, shares_clock=False) for given in (orbits, twice))
    assert (both.n_tracks, both.objects, both.time_s) == (10, one.objects, one.time_s)


def test_a_track_is_corrected_by_the_session_that_holds_it(sky) -> None:
    """Sessions of 0 to 10 h and 12 to 12.2 h: at 9 h and at 10.9 h the first, at 11.1 h the second."""
    orbits, passes = sky
    found = estimate(observed(passes, np.random.default_rng(3)), place_of_site(SITE), orbits, shares_clock=False)
    first, second = (
        replace(found, first_tai_ns=round(3.6e12 * a), last_tai_ns=round(3.6e12 * b)) for a, b in ((0.0, 10.0), (12.0, 12.2))
    )
    at_h = {-3.0: first, 9.0: first, 10.9: first, 11.1: second, 12.1: second, 40.0: second}
    for hour, session in at_h.items():
        assert nearest([first, second], round(3.6e12 * hour)) is session
    with pytest.raises(UserError, match="no session"):
        nearest([], 0)


def test_an_observer_whose_ephemeris_does_not_cover_the_tracks_is_named(
    sky, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The tracks are of 2018, the states of 2027."""
    message = tmp_path / "night.tdm"
    message.write_text(tdm(observed(sky[1][:4], np.random.default_rng(7))))
    eye = oem(tmp_path / "eye.oem", 60.0, "INTERPOLATION = HERMITE\nINTERPOLATION_DEGREE = 7")
    orbits = str(folder("sp3") / "gbm18432.sp3.Z")
    assert run(["calibrate", str(message), "--orbits", orbits, "--observer", str(eye), "--out", str(tmp_path / "c.json")]) == 2
    assert f"{message.name}: directions at epochs for which the observer's place is not given" in capsys.readouterr().err
    assert not (tmp_path / "c.json").exists()


def test_sessions_are_cut_at_gaps(sky) -> None:
    _, passes = sky
    tracks = observed(passes, np.random.default_rng(6))
    later = [Track(t_tai_ns=t.t_tai_ns + tai.NS_PER_DAY, direction=t.direction) for t in tracks]
    # passes are 100 minutes apart, over 15 hours; the next night begins nine hours on
    assert [len(s) for s in sessions_of([*later, *tracks], 3 * 3600.0)] == [10, 10]


def tdm(tracks: list[Track]) -> str:
    lines = ["CCSDS_TDM_VERS = 2.0", "CREATION_DATE = 2026-01-01T00:00:00", "ORIGINATOR = TEST"]
    for k, track in enumerate(tracks):
        lines += [
            "META_START", f"TRACK_ID = {k}", "TIME_SYSTEM = UTC", "PARTICIPANT_1 = S", f"PARTICIPANT_2 = O{k}",
            "MODE = SEQUENTIAL", "PATH = 2,1", "ANGLE_TYPE = RADEC", "REFERENCE_FRAME = EME2000",
            "TIMETAG_REF = RECEIVE", "META_STOP", "DATA_START",
        ]  # fmt: skip
        # the frame bias of EME2000 is 0.02 arcsec: below what is tested
        ra = np.degrees(np.arctan2(track.direction[:, 1], track.direction[:, 0])) % 360.0
        dec = np.degrees(np.arcsin(track.direction[:, 2]))
        for epoch, a, d in zip(utc_text(track.t_tai_ns, 6), ra, dec, strict=True):
            lines += [f"ANGLE_1 = {epoch} {a - 360.0 * (a >= 360.0):.8f}", f"ANGLE_2 = {epoch} {d:.8f}"]
        lines.append("DATA_STOP")
    return "\n".join(lines) + "\n"


@pytest.mark.slow
def test_the_command_calibrates_from_messages(sky, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, passes = sky
    message = tmp_path / "night.tdm"
    message.write_text(tdm(observed(passes[:4], np.random.default_rng(7))))
    orbits = folder("sp3") / "gbm18432.sp3.Z"
    out = tmp_path / "calibration.json"
    arguments = ["calibrate", str(message), "--orbits", str(orbits), "--out", str(out)]
    assert run([*arguments, "--site", SITE]) == 0
    (bias,) = read_calibration(out.read_text(), "file")
    assert bias.n_tracks == 4
    assert abs(bias.time_s - LATE_S) < 5.0 * np.sqrt(bias.covariance[0, 0])
    capsys.readouterr()
    assert run(arguments) == 2
    assert "give either --observer" in capsys.readouterr().err
    assert run([*arguments, "--site", "a,b"]) == 2
    assert "--site: expected LATITUDE,LONGITUDE,HEIGHT" in capsys.readouterr().err


def test_objects_that_left_their_orbit_do_not_calibrate_and_are_named(
    sky, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, passes = sky
    message = tmp_path / "night.tdm"
    message.write_text(tdm(observed(passes[:4], np.random.default_rng(7))))
    out = tmp_path / "calibration.json"
    arguments = ["calibrate", str(message), "--site", SITE, "--out", str(out), "--orbits"]
    assert run([*arguments, str(burnt_table("G13", tmp_path / "day.sp3"))]) == 0
    (bias,) = read_calibration(out.read_text(), "file")
    assert set(bias.objects) == {"G01", "G05", "G11"}
    assert abs(bias.time_s - LATE_S) < 5.0 * np.sqrt(bias.covariance[0, 0])
    assert "left out: G13: no free orbit fits the places" in capsys.readouterr().out


def true_offsets(rows: np.ndarray, t_tai_ns: np.ndarray, truth: tuple[np.ndarray, np.ndarray, np.ndarray]) -> np.ndarray:
    """Mean offset (3,) of a stored tracklet from where its object was at the stored epochs: along, east, north, arcsec.

    truth : epochs, directions and apparent motion from the ephemeris file alone.
    """
    t, direction, rate = truth
    away = rows[:, :3] - (direction + ((t_tai_ns - t) * 1e-9)[:, None] * rate)
    east = np.cross([0.0, 0.0, 1.0], direction)
    east /= np.linalg.norm(east, axis=1, keepdims=True)
    heading = rate / np.linalg.norm(rate, axis=1, keepdims=True)
    axes = np.stack([heading, east, np.cross(direction, east)], axis=1)
    return np.asarray(np.einsum("nij,nj->ni", axes, away).mean(axis=0) / ARCSEC)


@pytest.mark.slow
def test_the_store_takes_tracklets_with_a_calibration_of_other_objects(
    sky, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Five passes give the calibration, five others go into the store with it; the truth is the ephemeris file and astropy."""
    orbits, passes = sky
    known = estimate(observed(passes[::2], np.random.default_rng(8)), place_of_site(SITE), orbits, shares_clock=False)
    file, message = tmp_path / "calibration.json", tmp_path / "later.tdm"
    file.write_text(calibration_text("t", [known]))
    message.write_text(tdm(observed(passes[1::2], np.random.default_rng(9))))
    offsets = {}
    for name, more in (("as it is", []), ("corrected", ["--calibration", str(file)])):
        store = str(tmp_path / f"{name}.db")
        assert run(["objects", "observe", str(message), "--site", SITE, "--store", store, *more]) == 0
        found = ObjectStore(store)
        tracklets = found.tracklets(0, 2**62).values()
        found.close()
        assert len(tracklets) == 5
        by_epoch = {int(truth[0][0]): truth for truth in passes}
        nearest_truth = [by_epoch[min(by_epoch, key=lambda t, s=s: abs(t - int(s.t_tai_ns[0])))] for s in tracklets]
        offsets[name] = np.array([true_offsets(s.rows, s.t_tai_ns, t) for s, t in zip(tracklets, nearest_truth, strict=True)])
        # the site's place is that of the stored epochs
        for s in tracklets:
            np.testing.assert_allclose(s.rows[:, 6:], place_of_site(SITE)(s.t_tai_ns), atol=1e-9)
    # 20 ms of 15 to 40 arcsec/s are added to what the motion's direction has of the pointing
    before, after = (np.abs(offsets[name].mean(axis=0)) for name in ("as it is", "corrected"))
    assert before[1] > 2.0
    assert before[2] > 1.0
    # the calibration's own error and that of five means of ten
    assert (after < 4.0 * (np.sqrt(np.diag(known.covariance)) * [30.0, 1.0, 1.0] + 0.15)).all()
    assert (after < 0.5).all()
    capsys.readouterr()
    assert run(["objects", "observe", str(message), "--site", SITE, "--calibration", str(message)]) == 2
    assert "no sensor calibration" in capsys.readouterr().err


def mean_pulls(passes, known, tracks: list[Track], *, adds: bool) -> list[np.ndarray]:
    """Whitened error (2,) of the mean direction of each track after correction, by the errors as they are or with the bias's."""
    out = []
    for truth, track in zip(passes, tracks, strict=True):
        heading = truth[2] / np.linalg.norm(truth[2], axis=1, keepdims=True)
        east = np.cross([0.0, 0.0, 1.0], truth[1])
        east /= np.linalg.norm(east, axis=1, keepdims=True)
        north = np.cross(truth[1], east)
        angle = np.arctan2((heading * east).sum(axis=1), (heading * north).sum(axis=1))
        errors = np.column_stack([np.tile([1.0, 0.6], (len(angle), 1)), angle])
        if adds:
            errors = widened(errors, track, known)
        mended = corrected(track, known)
        away = mended.direction - (truth[1] + ((mended.t_tai_ns - truth[0]) * 1e-9)[:, None] * truth[2])
        offset = np.stack([(away * north).sum(axis=1), (away * east).sum(axis=1)], axis=1) / ARCSEC
        cos, sin = np.cos(errors[:, 2]), np.sin(errors[:, 2])
        turn = np.stack([np.stack([cos, sin], axis=1), np.stack([-sin, cos], axis=1)], axis=1)
        weight = np.einsum("nki,nk,nkj->nij", turn, errors[:, :2] ** -2.0, turn)
        covariance = np.linalg.inv(weight.sum(axis=0))
        mean = covariance @ np.einsum("nij,nj->i", weight, offset)
        out.append(np.linalg.solve(np.linalg.cholesky(covariance), mean))
    return out


@pytest.mark.slow
def test_errors_after_a_correction_hold_the_truth(sky) -> None:
    """Ten passes of a night give the calibration; it is taken off ten of another night. The mean directions of these are held."""
    orbits, passes = sky
    place, pulls, before = place_of_site(SITE), [], []
    for k in range(25):
        rng = np.random.default_rng([k, 7])
        known = estimate(observed(passes, rng), place, orbits, shares_clock=False)
        later = observed(passes, rng)
        pulls.append(mean_pulls(passes, known, later, adds=True))
        before.append(mean_pulls(passes, known, later, adds=False))
    # 500 numbers; those of a night share its calibration
    assert 0.9 <= float(np.sqrt(np.mean(np.square(pulls)))) <= 1.1
    assert float(np.sqrt(np.mean(np.square(before)))) > float(np.sqrt(np.mean(np.square(pulls))))


def test_errors_of_one_direction_get_the_pointing_alone(sky) -> None:
    """No motion shows in one direction: the error of time is left out, that of the pointing is added whole."""
    orbits, passes = sky
    known = estimate(observed(passes, np.random.default_rng(8)), place_of_site(SITE), orbits, shares_clock=False)
    track = Track(t_tai_ns=passes[0][0][:1], direction=passes[0][1][:1])
    quiet = replace(
        known,
        covariance=np.diag([1.0, 0.3**2, 0.4**2]),
        degrees=np.full(3, 1e9),
        common_along_arcsec=0.0,
        common_cross_arcsec=0.0,
    )
    north, east, angle = widened(np.array([[1.0, 1.0, 0.7]]), track, quiet)[0]
    assert (north, east) == pytest.approx((np.hypot(1.0, 0.4), np.hypot(1.0, 0.3)))
    assert np.sin(angle) == pytest.approx(0.0, abs=1e-9)


def test_a_broken_calibration_is_refused() -> None:
    with pytest.raises(UserError, match="x: no sensor calibration"):
        read_calibration("{}", "x")
    with pytest.raises(UserError, match='format "other"'):
        read_calibration('{"format": "other"}', "x")
