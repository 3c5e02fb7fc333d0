"""The table beside the tracking message: rows are the message's, errors those of the tracklet, and it says what it lacks."""

from dataclasses import replace

import numpy as np
import pytest

from ground.options import ProductOptions
from ground.products.kvn_comments import LONGEST_LINE
from ground.products.tdm import tdm_text
from ground.products.tdm_angles import east_north_errors, tdm_angles_table
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakMeasurement, Tracklet
from tests.link.sky_scene import Camera, streak
from tests.products.test_message_fields import headers, tracklet

ENDS = np.array([[10.0, 10.0], [20.0, 40.0]])
OPEN, CLOSE = 0, 2


def measured(number: int) -> tuple[Tracklet, list[StreakMeasurement]]:
    """A tracklet of three rows: both ends of a streak, and one of the next."""
    members = [
        replace(
            streak(Camera(), k, 100_000 * k, ENDS, 0.3, 0.1, StreakFlag.DIRECTION_RESOLVED),
            tracklet_id=number,
            mag=11.0,
            t_tai_ns=headers()[k].t_start_tai_ns + np.array([0, 100_000_000, 200_000_000]),
        )
        for k in range(2)
    ]
    t_ns = np.array([members[0].t_tai_ns[0], members[0].t_tai_ns[2], members[1].t_tai_ns[0]])
    made = replace(
        tracklet(number),
        streak_ids=np.array([0, 100_000]),
        frames=np.array([0, 1]),
        t_tai_ns=t_ns,
        row_streak_ids=np.array([0, 0, 100_000]),
        row_points=np.array([OPEN, CLOSE, OPEN]),
        sigma_along_arcsec=np.array([1.0, 1.5, 2.0]),
        sigma_cross_arcsec=np.array([0.5, 0.4, 0.3]),
        correlation=np.array([0.0, 0.2, -0.3]),
        motion_angle_deg=np.array([0.0, 60.0, 290.0]),
        shared_arcsec=np.array([[0.9, 0.1, 0.0], [0.9, 0.2, 0.0], [0.9, 0.3, 0.0]]),
        shared_group=np.array([0, 0, 0]),
        pointing_arcsec=np.full(3, 0.01),
    )
    return made, members


def test_rows_are_those_of_the_message() -> None:
    """Epochs and angles of every row stand in the message as they are in the table; each row names its streak and its end."""
    made, members = measured(17)
    text = tdm_text([made], [members], headers(), ProductOptions(), oem_name="observer.oem")
    table = tdm_angles_table([made], [members], headers(), ProductOptions(), oem_name="observer.oem")
    angles = [line.split(" = ")[1].split() for line in text.splitlines() if line.startswith("ANGLE_1")]
    assert [epoch for epoch, _ in angles] == list(table["epoch_utc"])
    np.testing.assert_allclose([float(angle) for _, angle in angles], table["ra_deg"], rtol=0.0, atol=1e-10)
    assert list(table["epoch_tai_ns"]) == made.t_tai_ns.tolist()
    assert list(table["end"]) == ["end 0", "end 1", "end 0"]
    assert list(table["epoch_of"]) == ["shutter open", "shutter close", "shutter open"]
    assert list(table["frame"]) == [0, 0, 1]
    assert table.meta["timetag_ref"] == "RECEIVE"
    assert table.meta["observer"] == "observer.oem"
    assert "shared[i] @ shared[j]" in table.meta["covariance"]
    assert "TRACK_ID = " + table["track_id"][0] in text


def test_what_members_of_one_line_share_across_is_stated() -> None:
    """Its columns, a product of which is the covariance across; zero where the tracklet does not say."""
    made, members = measured(17)
    table = tdm_angles_table([made], [members], headers(), ProductOptions(), oem_name="observer.oem")
    assert not np.any([table[f"shared_cross_{k}_arcsec"] for k in (1, 2, 3)])
    line = np.array([[0.2, 0.0, 0.0], [0.2, 0.1, 0.0], [0.2, 0.1, 0.05]])
    stated = replace(made, shared_cross_arcsec=line)
    table = tdm_angles_table([stated], [members], headers(), ProductOptions(), oem_name="observer.oem")
    np.testing.assert_allclose(np.column_stack([table[f"shared_cross_{k}_arcsec"] for k in (1, 2, 3)]), line)
    assert "shared_cross[i] @" in table.meta["covariance"]


def test_the_interval_of_a_change_point_is_narrower_than_its_sigma() -> None:
    """Exponential tails hold 76 % within a standard deviation; where no interval is stated, it is that of a normal error."""
    made, members = measured(17)
    table = tdm_angles_table([made], [members], headers(), ProductOptions(), oem_name="observer.oem")
    assert list(table["half68_along_arcsec"]) == [1.0, 1.5, 2.0]
    stated = replace(made, half68_along_arcsec=np.array([0.8, 1.5, 1.4]))
    table = tdm_angles_table([stated], [members], headers(), ProductOptions(), oem_name="observer.oem")
    assert list(table["half68_along_arcsec"]) == [0.8, 1.5, 1.4]


def test_errors_east_and_north_are_those_along_and_across_turned() -> None:
    """Against 400,000 draws of errors along and across the motion; along north and across east at position angle 0."""
    rng = np.random.default_rng(3)
    for along, cross, correlation, angle in ((1.0, 0.5, 0.0, 0.0), (1.5, 0.4, 0.2, 60.0), (2.0, 0.3, -0.3, 290.0)):
        covariance = np.array([[along**2, correlation * along * cross], [correlation * along * cross, cross**2]])
        drawn = rng.multivariate_normal([0.0, 0.0], covariance, 400_000)
        a = np.radians(angle)
        b = np.radians(angle + 90.0)
        east = drawn[:, 0] * np.sin(a) + drawn[:, 1] * np.sin(b)
        north = drawn[:, 0] * np.cos(a) + drawn[:, 1] * np.cos(b)
        got = [float(v[0]) for v in east_north_errors(*(np.array([v]) for v in (along, cross, correlation, angle)))]
        want = [east.std(), north.std(), np.corrcoef(east, north)[0, 1]]
        np.testing.assert_allclose(got, want, atol=0.006)


def test_message_and_table_say_what_they_lack() -> None:
    """No tracklet, one frame, no sky positions, no dated end, no observer: in words, and no line is too long for a reader."""
    made, members = measured(17)
    options = ProductOptions()
    assert "No segment: no tracklet in 1 frame, in which nothing" in tdm_text([], [], headers()[:1], options, oem_name=None)
    unseen = replace(made, flags=made.flags | StreakFlag.NO_SKY)
    undated = replace(
        made, tracklet_id=18, t_tai_ns=made.t_tai_ns[:0], ra_deg=made.ra_deg[:0], dec_deg=made.dec_deg[:0],
    )  # fmt: skip
    text = tdm_text([unseen, undated], [members, members], headers(), options, oem_name=None)
    assert "Left out, attitude unknown, so that they have no sky positions: SBOC-T000017" in text
    assert "Left out, no end was dated by the shutter" in text
    assert "META_START" not in text
    assert len(tdm_angles_table([unseen, undated], [members, members], headers(), options, oem_name=None)) == 0
    partly = [headers()[0], replace(headers()[1], observer=None), headers()[2]]
    text = tdm_text([made], [members], partly, options, oem_name="observer.oem")
    assert "observer state unknown in frames 1: aberration of the observer's geocentric velocity NOT removed there" in text
    assert "EPHEMERIS_NAME" not in text
    assert "No ephemeris of the observer covers all of these frames" in text
    table = tdm_angles_table([made], [members], partly, options, oem_name=None)
    assert list(table["observer_known"]) == [True, True, False]
    assert "no observer state" in table.meta["observer"]
    assert max(map(len, text.splitlines())) <= LONGEST_LINE


@pytest.mark.parametrize("resolved", [True, False])
def test_a_trail_cut_by_the_edge_has_a_magnitude_once_it_is_dated(resolved: bool) -> None:
    """Before that nobody knows when its middle was passed, and no epoch is made up for it."""
    made, members = measured(17)
    flags = StreakFlag.EDGE1 | (StreakFlag.DIRECTION_RESOLVED if resolved else StreakFlag(0))
    members = [members[0], replace(members[1], flags=flags)]
    text = tdm_text([made], [members], headers(), ProductOptions(), oem_name=None)
    assert text.count("MAG =") == (2 if resolved else 1)
