"""What a score does with numbers that are not there: resumed stages, true objects without an orbit, NaN."""

import numpy as np
import pytest
from astropy.table import Table

from sboc_e2e.report.words import figure_words
from sboc_e2e.score.figures import exact, proportion
from sboc_e2e.score.orbit import orbit
from sboc_e2e.score.timing import timing
from sboc_e2e.truth import empty


def test_resumed_stage_is_divided_by_the_frames_it_timed() -> None:
    figures = timing({"stages": {"onboard": {"cpu_s": 2.0, "wall_s": 3.0, "timed_frames": 4}}}, 100, 4.0)
    assert figures["onboard_cpu_s_per_frame"]["value"] == pytest.approx(0.5)
    assert figures["onboard_cpu_s_per_frame"]["n"] == 4
    assert figures["realtime_factor_onboard"]["value"] == pytest.approx(0.5)


def test_stage_that_had_nothing_left_to_do_has_no_time_per_frame() -> None:
    figures = timing({"stages": {"onboard": {"cpu_s": 0.1, "wall_s": 0.1, "timed_frames": 0}}}, 100, 4.0)
    assert figures["onboard_cpu_s_per_frame"]["value"] is None


def test_number_that_is_not_finite_is_absent_with_a_reason() -> None:
    assert figure_words(exact(float("nan"), 3)) == ("-", "not a finite number")


def test_none_of_many_is_printed_as_a_person_would() -> None:
    """Not as 0 [1.73e-18, 0.025]: the interval of none begins, and that of all ends, where a share does."""
    for n in range(1, 400):
        assert proportion(0, n)["low"] == 0.0
        assert proportion(n, n)["high"] == 1.0
    words, _ = figure_words(proportion(0, 105))
    assert words.startswith("0  [0, 0.02")
    assert figure_words({"value": 1e-20, "n": 3, "low": -2e-21, "high": 0.5})[0] == "0  [0, 0.5000]"


def test_null_figure_of_an_older_score_can_be_printed() -> None:
    assert figure_words({"value": None, "n": 3, "low": None, "high": None})[0] == "-"


def test_true_object_without_elements_is_not_scored_as_an_orbit() -> None:
    streaks, objects = empty("streaks", 1), empty("objects", 1)
    streaks["range_km"] = 500.0
    objects["a_km"], objects["i_deg"] = np.nan, np.nan
    found = Table({"tracklet_id": [0], "range_km": [510.0], "a_km": [7000.0], "i_deg": [98.0], "t_ref_tai_ns": [0]})
    figures = orbit(found, {0: 0}, Table(streaks), Table(objects))
    assert all(f["value"] is None and f["reason"] for f in figures.values())
