"""Two eyes on one frame: which trails both have, and how far their ends lie apart along the trail."""

import pytest

from tests.benchmarks.second_eye import agreement


def test_ends_lie_apart_along_the_trail_whichever_end_comes_first() -> None:
    mark = [10.0, 20.0, 10.0, 120.0]
    for other, away in (([12.0, 23.0, 9.0, 119.0], [3.0, 1.0]), ([9.0, 119.0, 12.0, 23.0], [1.0, 3.0])):
        seen, number, apart = agreement({"a": {"trails": [mark], "doubtful": []}}, {"a": {"trails": [other], "doubtful": []}})
        assert (seen, number) == (1, 1)
        assert apart == pytest.approx(away)


def test_a_trail_is_seen_by_both_where_the_other_mark_covers_half_of_it_on_its_line() -> None:
    first = {"a": {"trails": [[10.0, 20.0, 10.0, 120.0], [50.0, 0.0, 50.0, 80.0]], "doubtful": []}}
    half = {"a": {"trails": [[10.0, 60.0, 10.0, 120.0], [50.0, 0.0, 70.0, 80.0]], "doubtful": []}}
    seen, number, apart = agreement(first, half)
    assert (seen, number) == (1, 2), "the second one leaves the line"
    assert apart == pytest.approx([40.0, 0.0])
    assert agreement(half, {"a": {"trails": [], "doubtful": []}}) == (0, 2, [])
