"""Stars under regions of interest come from the frames before; movers, noise and pieces of trails do not."""

from dataclasses import replace

import numpy as np
import pytest

from ground.ingest import decode_downlink
from ground.ingest.codecs import PlanesDecoder
from onboard.stars.memory import EarlierStars, brought_forward, remembered_stars, usable_stars, with_frame
from sboc_e2e.icd.flags import StarFlag, StreakFlag
from sboc_e2e.icd.signals import Detection, RoiGroup, StarList, Strip
from tests.onboard.small_run import STREAK, frame, sky, start_run

TRAIL = Detection(row0=100.0, col0=60.0, row1=100.0, col1=140.0, snr=15.0)
PSF = 0.85
FIELD = np.random.default_rng(4).uniform(5.0, 250.0, (40, 2))
FIELD = FIELD[np.abs(FIELD[:, 0] - 100.0) > 20.0]


def star_list(extra: list[tuple[float, float, float]], shift: tuple[float, float] = (0.0, 0.0)) -> StarList:
    """A field of bright stars, and further ones (row, col, flux), all moved by a shift; S/N is a hundredth of the flux."""
    field = np.column_stack((FIELD, np.linspace(9000.0, 4000.0, len(FIELD))))
    rows = np.vstack((field, np.array(extra).reshape(-1, 3)))
    rows = rows[np.argsort(-rows[:, 2], kind="stable")]
    return StarList(
        row=rows[:, 0] + shift[0],
        col=rows[:, 1] + shift[1],
        flux_e=rows[:, 2].astype(np.float32),
        snr=(rows[:, 2] / 100.0).astype(np.float32),
        flags=np.zeros(len(rows), dtype=np.uint8),
    )


def group(detection: Detection) -> RoiGroup:
    """A strip of 13 rows around row 100, cols 50 to 149."""
    strip = Strip(axis=1, major0=50, minor0_fp=94 << 16, slope_fp=0, level_adu=0, values_adu=np.zeros((100, 13), dtype=np.int32))
    return RoiGroup(roi_id=0, detection=detection, strips=(strip,), n_strips=1)


def sent(frames: list[StarList], detection: Detection = TRAIL, earlier_detections: tuple[Detection, ...] = ()) -> StarList:
    """What is remembered in the last of some frames."""
    memory: tuple[EarlierStars, ...] = ()
    for stars in frames[:-1]:
        memory = with_frame(brought_forward(memory, stars), usable_stars(stars, earlier_detections, PSF))
    return remembered_stars(brought_forward(memory, frames[-1]), [group(detection)], psf_sigma_px=PSF, most=250)


def test_place_and_flux_are_means_brought_to_the_present_pixels() -> None:
    """Two frames with fluxes 900 and 1100 and shifts of the pointing give one star of 1000 e- at its present place."""
    frames = [
        star_list([(101.0, 90.0, 900.0)]),
        star_list([(101.0, 90.0, 1100.0)], (3.0, -2.0)),
        star_list([], (4.5, -1.0)),
    ]
    stars = sent(frames)
    assert len(stars) == 1
    assert (stars.row[0], stars.col[0]) == (pytest.approx(105.5, abs=0.01), pytest.approx(89.0, abs=0.01))
    assert stars.flux_e[0] == pytest.approx(1000.0, rel=1e-6)
    assert stars.snr[0] == pytest.approx(10.0 * np.sqrt(2.0), rel=1e-6)
    assert stars.flags[0] == StarFlag.REMEMBERED


def test_only_stars_near_the_strips_are_sent() -> None:
    """The strip's rows 94 to 106 and three PSF sigmas more."""
    near, far = (108.9, 90.0, 800.0), (109.5, 120.0, 800.0)
    stars = sent([star_list([near, far])] * 3)
    assert stars.row.tolist() == pytest.approx([108.9])


def test_a_mover_and_a_particle_are_not_remembered() -> None:
    """A source that moves by 4 px from frame to frame, and one seen once."""
    frames = [star_list([(100.0, 80.0 + 4.0 * k, 900.0)] + ([(103.0, 70.0, 700.0)] if k == 0 else [])) for k in range(4)]
    assert len(sent(frames)) == 0


@pytest.mark.parametrize(("length_px", "flags"), [(0.0, StreakFlag.POINT_LIKE), (4.0, StreakFlag(0))])
def test_what_a_short_detection_found_is_not_its_own_star(length_px: float, flags: StreakFlag) -> None:
    """A slow mover stays within a pixel of its place; another star of the same ROI is sent."""
    frames = [star_list([(100.0, 80.0 + 0.2 * k, 900.0), (103.0, 120.0, 700.0)]) for k in range(4)]
    found = Detection(row0=100.0, col0=81.0, row1=100.0, col1=81.0 + length_px, snr=9.0, flags=flags)
    assert sent(frames, found).col.tolist() == pytest.approx([120.0], abs=0.05)


def test_entries_under_a_trail_of_their_own_frame_do_not_count() -> None:
    """Their flux holds light of that trail."""
    frames = [star_list([(101.0, 90.0, 900.0)])] * 3
    assert len(sent(frames)) == 1
    assert len(sent(frames, earlier_detections=(TRAIL,))) == 0


def test_nothing_is_remembered_when_the_fields_do_not_match() -> None:
    """A field turned by a right angle cannot be registered."""
    stars = star_list([(101.0, 90.0, 900.0)])
    turned = replace(stars, row=stars.col + 100.0, col=300.0 - stars.row)
    assert brought_forward(with_frame((), stars), turned) == ()


def test_chain_sends_the_stars_under_its_roi_apart_from_the_measured_ones() -> None:
    """The same sky three times: the third frame brings down stars under a streak, none of them in the measured list."""
    run = start_run(detections=())
    run.feed(frame(0, pixels=sky(1)))
    run.feed(frame(1, pixels=sky(1) + np.uint16(1)))
    on_trail = start_run(detections=(STREAK,))
    on_trail.state = run.state
    result = on_trail.feed(frame(2, pixels=sky(1) + np.uint16(2)))
    frames, report = decode_downlink(result.packets, [PlanesDecoder()])
    assert report.n_decode_failures == 0
    got = frames[0]
    assert len(got.remembered) > 0
    assert ((got.remembered.flags & StarFlag.REMEMBERED) != 0).all()
    assert ((got.stars.flags & StarFlag.REMEMBERED) == 0).all()
    assert len(got.stars) + len(got.remembered) == result.housekeeping.n_stars_sent
    for row, col, flux in zip(got.remembered.row, got.remembered.col, got.remembered.flux_e, strict=True):
        nearest = np.argmin(np.hypot(result.stars.row - row, result.stars.col - col))
        assert np.hypot(result.stars.row[nearest] - row, result.stars.col[nearest] - col) < 0.1
        assert flux == pytest.approx(result.stars.flux_e[nearest], rel=0.05)
