"""Facts about trails whose light varies, drawn by `tests.benchmarks.tumblers`, not by the simulator."""

from tests.benchmarks.tumblers import measure, whole


def test_tumblers_come_out_as_one_trail_and_whole() -> None:
    """Cosines and flashes that fall to a few per cent, S/N 20 to 90. Before, 73 of 108 came out in pieces or in part."""
    measured = measure(2, 2)
    lit = [found for trail, found in measured if trail.attainable() >= 0.9]
    assert sum(len(found) == 1 for _, found in measured) >= 17
    assert len(lit) >= 8
    assert sum(whole(found) for found in lit) >= len(lit) - 1


def test_trails_of_even_light_are_followed_no_farther_than_they_go() -> None:
    for trail, found in measure(2, 4, depth=0.0):
        assert whole(found), (trail, found)
