"""Short detections on the line of sharp points are pieces of a track; others are not, however many points are near."""

import math

import numpy as np
import pytest

from onboard.detect.line_integral import track_pieces
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.signals import Detection

SHARP = StreakFlag.COSMIC_LIKE | StreakFlag.POINT_LIKE


def point(row: float, col: float, snr: float = 150.0) -> Detection:
    return Detection(row0=row, col0=col, row1=row, col1=col, snr=snr, flags=SHARP)


def short(row: float, col: float, length_px: float, angle: float, snr: float = 15.0) -> Detection:
    half = 0.5 * length_px * np.array([math.sin(angle), math.cos(angle)])
    return Detection(row0=row - half[0], col0=col - half[1], row1=row + half[0], col1=col + half[1], snr=snr)


def is_piece(found: Detection, hits: list[Detection]) -> bool:
    (after,) = track_pieces.flagged([found], hits)
    return bool(after.flags & StreakFlag.COSMIC_LIKE)


@pytest.mark.parametrize("angle", [0.0, 0.7, 2.5])
@pytest.mark.parametrize("length_px", [0.0, 4.0, 18.0])
def test_a_piece_on_a_chain_of_points_is_flagged(angle: float, length_px: float) -> None:
    """Points 5 px apart on one line, on one side of the piece or on both, off it by up to half a pixel."""
    rng = np.random.default_rng(1)
    for sides in ((1,), (-1, 1)):
        along = [side * (0.5 * length_px + 5.0 * k) for side in sides for k in (1, 2, 3)]
        hits = [
            point(100 + a * math.sin(angle) + rng.uniform(-0.35, 0.35), 100 + a * math.cos(angle) + rng.uniform(-0.35, 0.35))
            for a in along
        ]
        assert is_piece(short(100, 100, length_px, angle), hits)
        assert is_piece(short(100, 100, length_px, angle + math.pi), hits)


def test_trails_of_light_near_tracks_are_left_as_they_are() -> None:
    chain = [point(100.0, 100.0 + 5.0 * k) for k in range(1, 5)]
    assert not is_piece(short(100, 100, 18, 0.6), chain), "its own line is another one"
    assert not is_piece(short(104, 100, 0, 0.0), chain), "beside the line"
    assert not is_piece(short(100, 100, 18, 0.0, snr=80.0), chain), "nearly as bright as the points"
    assert not is_piece(short(100, 100, 60, 0.0), chain), "long enough to tell by itself"
    assert not is_piece(short(100, 50, 4, 0.0), chain), "too far away"
    assert not is_piece(short(100, 100, 4, 0.0), [point(100, 105), point(109, 100)]), "two points, not on one line"
    assert not is_piece(short(100, 100, 4, 0.0), [])


def test_unrelated_points_hardly_ever_make_a_piece() -> None:
    """A thousand points in 2048 x 2048 px, as many as a hundred tracks leave, but scattered: 0.5 % of short trails or fewer."""
    rng = np.random.default_rng(2)
    hits = [point(*rng.uniform(0, 2048, 2)) for _ in range(1000)]
    trails = [short(*rng.uniform(100, 1948, 2), rng.uniform(0, 30), rng.uniform(0, math.pi)) for _ in range(3000)]
    after = track_pieces.flagged(trails, hits)
    assert sum(bool(d.flags & StreakFlag.COSMIC_LIKE) for d in after) <= 15


def test_ends_of_tracks_count_as_points() -> None:
    track = Detection(row0=100.0, col0=110.0, row1=100.0, col1=115.0, snr=200.0, flags=StreakFlag.COSMIC_LIKE)
    piece, same = track_pieces.flagged([short(100, 100, 4, 0.0), track], [])
    assert piece.flags & StreakFlag.COSMIC_LIKE
    assert same == track


def test_points_on_a_trail_are_no_hits_of_their_own() -> None:
    trail = short(100, 100, 60, 0.0, snr=50.0)
    assert track_pieces.beside_trails([point(102, 100), point(110, 100)], [trail]) == [point(110, 100)]
