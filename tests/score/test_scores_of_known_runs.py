"""Known detections with known errors give the known scores; perfect scores 1, empty 0, shouting is punished."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from astropy.table import Table, vstack

from sboc_e2e.icd.downlink import Housekeeping
from sboc_e2e.icd.flags import FrameFlag, StreakFlag
from sboc_e2e.score.photometry import mean_magnitudes
from sboc_e2e.score.score_run import score_evaluation
from tests.score.conftest import PIXEL_ARCSEC, Synthetic

Factory = Callable[..., Synthetic]


def test_a_perfect_detector_scores_one(synthetic: Factory) -> None:
    run = synthetic(10)
    score = score_evaluation(run.evaluation(run.perfect_streaks(), run.rois()))
    for half in ("onboard", "ground"):
        assert score["detection"][half]["completeness_snr8"]["value"] == 1.0
        assert score["detection"][half]["false_per_frame"]["value"] == 0.0
    assert score["linking"]["completeness"]["value"] == 1.0
    assert score["linking"]["purity"]["value"] == 1.0
    assert score["linking"]["fragments_per_object"]["value"] == 1.0
    assert score["linking"]["direction_correct"]["value"] == 1.0
    assert score["astrometry"]["cross_crlb_ratio"]["value"] == pytest.approx(0.0, abs=1e-6)
    assert score["astrometry"]["cross_rms_arcsec"]["value"] == pytest.approx(0.0, abs=1e-3)
    assert score["compression"]["captured_flux_fraction"]["value"] > 0.99


def test_an_empty_detector_scores_zero(synthetic: Factory) -> None:
    run = synthetic(10)
    score = score_evaluation(run.evaluation(run.perfect_streaks()[:0]))
    assert score["detection"]["ground"]["completeness_snr8"]["value"] == 0.0
    assert score["detection"]["ground"]["false_per_frame"]["value"] == 0.0
    assert score["linking"]["n_objects"]["value"] == 0
    assert score["linking"]["completeness"]["value"] is None
    assert score["linking"]["completeness"]["reason"]


def test_shouting_everywhere_is_punished(synthetic: Factory) -> None:
    run = synthetic(5)
    loud = run.perfect_streaks()
    shouts = []
    for k in range(20):
        extra = loud.copy()
        extra["row0"] = (loud["row0"] + 11.0 * (k + 1)) % 250
        extra["row1"] = (extra["row0"] + 40.0 + k) % 250
        extra["tracklet_id"] = -1
        shouts.append(extra)
    score = score_evaluation(run.evaluation(vstack([loud, *shouts])))
    assert score["detection"]["ground"]["completeness_snr8"]["value"] == 1.0
    assert score["detection"]["ground"]["false_per_frame"]["value"] == pytest.approx(60.0)


def test_streaks_lost_to_the_budget_are_those_missed_where_detections_were_held_back(synthetic: Factory) -> None:
    """Ten frames of three streaks, one missed in each: lost where the budget cut, at most as many as were held back."""
    run = synthetic(10)
    held_back = {0: (2, FrameFlag.BUDGET_CUT), 1: (1, FrameFlag.STORM), 2: (0, FrameFlag.BUDGET_CUT), 3: (5, FrameFlag(0))}
    frames = []
    for frame in run.rois():
        dropped, flags = held_back.get(frame.header.frame, (0, FrameFlag(0)))
        record = Housekeeping(
            flags=flags, n_stars_found=9, n_stars_sent=9, n_detections=2 + dropped, n_rois_sent=2, n_rois_dropped=dropped,
            bytes_dropped=0, threshold_sigma=0.0, background_adu=2.0, sigma_adu=2.4, n_masked=0,
        )  # fmt: skip
        frames.append(replace(frame, rois=frame.rois[:2], housekeeping=record))
    score = score_evaluation(run.evaluation(run.perfect_streaks(), frames))
    assert score["detection"]["onboard"]["lost_to_budget"]["value"] == pytest.approx(2 / 30)
    bare = score_evaluation(run.evaluation(run.perfect_streaks(), run.rois()))
    assert bare["detection"]["onboard"]["lost_to_budget"]["value"] is None


def test_duplicates_are_false(synthetic: Factory) -> None:
    run = synthetic(5)
    streaks = run.perfect_streaks()
    score = score_evaluation(run.evaluation(vstack([streaks, streaks])))
    assert score["detection"]["ground"]["false_per_frame"]["value"] == pytest.approx(3.0)


def test_vetoed_streaks_are_neither_found_nor_false(synthetic: Factory) -> None:
    run = synthetic(5)
    streaks = run.perfect_streaks()
    streaks["flags"] = int(StreakFlag.VETOED)
    score = score_evaluation(run.evaluation(streaks))
    assert score["detection"]["ground"]["completeness_snr8"]["value"] == 0.0
    assert score["detection"]["ground"]["false_per_frame"]["value"] == 0.0
    assert score["linking"]["veto_loss"]["value"] == 1.0


def test_known_errors_give_known_ratios_and_pulls(synthetic: Factory) -> None:
    """Cross-track errors of exactly 0.1 px rms with a quoted 0.1 px: pull 1; the same in arcseconds on the sky."""
    run = synthetic(120)
    streaks = run.perfect_streaks()
    rng = np.random.default_rng(3)
    offset = rng.normal(0.0, 0.1, len(streaks))
    chord = np.array([12.0, 80.0]) / np.hypot(12.0, 80.0)
    across = np.array([-chord[1], chord[0]])
    for end in ("0", "1"):
        streaks[f"row{end}"] = streaks[f"row{end}"] + offset * across[0]
        streaks[f"col{end}"] = streaks[f"col{end}"] + offset * across[1]
    streaks["dec_mid_deg"] = streaks["dec_mid_deg"] + offset * across[0] * PIXEL_ARCSEC / 3600.0
    streaks["ra_mid_deg"] = streaks["ra_mid_deg"] - offset * across[1] * PIXEL_ARCSEC / 3600.0
    e = run.evaluation(streaks)
    score = score_evaluation(e)["astrometry"]
    bound_px = next(iter(e.bounds.values())).cross_px
    expected = np.sqrt(np.mean(offset**2))
    assert score["cross_crlb_ratio"]["value"] == pytest.approx(expected / bound_px, rel=1e-3)
    assert score["cross_pull_std"]["value"] == pytest.approx(1.0, abs=0.12)
    assert score["cross_rms_arcsec"]["value"] == pytest.approx(expected * PIXEL_ARCSEC, rel=1e-2)
    assert score["along_rms_arcsec"]["value"] == pytest.approx(0.0, abs=0.01)


def test_a_path_that_jitters_is_compared_as_a_whole(synthetic: Factory) -> None:
    """A trail bent by jitter of 0.05 px, measured by the line through its middle, is measured without error; its arc likewise."""
    run = synthetic(3)
    t = run.tables["streaks"]
    node = np.linspace(0, 1, t["path_row"].shape[1])
    chord = np.array([12.0, 80.0]) / np.hypot(12.0, 80.0)
    t["path_row"] = t["path_row"] + chord[1] * (0.05 * np.sin(6 * np.pi * node) + 4.0 * node * (1.0 - node))
    t["path_col"] = t["path_col"] - chord[0] * (0.05 * np.sin(6 * np.pi * node) + 4.0 * node * (1.0 - node))
    streaks = run.perfect_streaks()
    # the contract: positive towards (+dcol, -drow) of the chord
    streaks["sagitta_px"] = 1.0
    cross_px = score_evaluation(run.evaluation(streaks))["astrometry"]["cross_rms_px"]["value"]
    assert cross_px == pytest.approx(0.0, abs=0.003)


@pytest.mark.parametrize(("on_the_trail", "found"), [(True, 1.0), (False, 0.0)])
def test_a_bent_trail_is_matched_by_its_middle_not_that_of_its_chord(
    synthetic: Factory, on_the_trail: bool, found: float
) -> None:
    """The chord of a trail of sagitta 8 px passes more than 3 px (the limit of S/N 60) beside its middle."""
    run = synthetic(4, snr=60.0)
    t = run.tables["streaks"]
    node = np.linspace(0, 1, t["path_row"].shape[1])
    t["path_row"] = t["path_row"] + 32.0 * node * (1.0 - node)
    streaks = run.perfect_streaks()
    if not on_the_trail:
        streaks["row_mid"] = streaks["row_mid"] - 8.0
    assert score_evaluation(run.evaluation(streaks))["detection"]["ground"]["completeness_snr8"]["value"] == found


def test_magnitudes(synthetic: Factory) -> None:
    run = synthetic(150)
    streaks = run.perfect_streaks()
    streaks["mag"] = streaks["mag"] + 0.02 + np.random.default_rng(5).normal(0.0, 0.05, len(streaks))
    score = score_evaluation(run.evaluation(streaks))["photometry"]
    assert score["bias_mag"]["value"] == pytest.approx(0.02, abs=0.01)
    assert score["rms_mag"]["value"] == pytest.approx(np.hypot(0.02, 0.05), rel=0.1)


def test_a_flash_at_mid_trail_is_not_the_brightness_of_the_trail(synthetic: Factory) -> None:
    run = synthetic(20)
    evaluation = run.evaluation(run.perfect_streaks())
    truth = evaluation.truth[0]
    light = np.ones(33)
    light[16] = 3.0
    flashing = replace(truth, path=replace(truth.path, flux_e_s=light))
    mag = mean_magnitudes(evaluation.truth_tables["streaks"], [flashing])[truth.index]
    # 34 / 32 of the steady light in all, three times as much in the middle
    assert mag == pytest.approx(11.0 - 2.5 * np.log10(34.0 / 32.0 / 3.0))


def test_swapped_direction_and_mixed_tracklets_are_seen(synthetic: Factory) -> None:
    run = synthetic(9)
    streaks = run.perfect_streaks()
    wrong = streaks.copy()
    for a, b in (("row0", "row1"), ("col0", "col1")):
        wrong[a], wrong[b] = streaks[b], streaks[a]
    assert score_evaluation(run.evaluation(wrong))["linking"]["direction_correct"]["value"] == 0.0
    mixed = run.perfect_streaks()
    mixed["tracklet_id"] = 0
    linking = score_evaluation(run.evaluation(mixed))["linking"]
    assert linking["completeness"]["value"] == pytest.approx(1 / 3)


@pytest.mark.parametrize(
    ("flags", "unflagged"), [(StreakFlag(0), 3.0), (StreakFlag.COSMIC_LIKE, 0.0), (StreakFlag.SPIKE_LIKE, 0.0)]
)
def test_rois_beside_the_trail_are_false_and_miss_it(synthetic: Factory, flags: StreakFlag, unflagged: float) -> None:
    run = synthetic(6)
    frames = run.rois(shift_px=25.0, flags=flags)
    score = score_evaluation(run.evaluation(run.perfect_streaks(), frames))["detection"]["onboard"]
    assert score["completeness_snr8"]["value"] == 0.0
    assert score["false_per_frame"]["value"] == pytest.approx(3.0)
    assert score["false_unflagged_per_frame"]["value"] == pytest.approx(unflagged)


def test_faint_truth_counts_neither_way(synthetic: Factory) -> None:
    run = synthetic(4, snr=2.0)
    found = score_evaluation(run.evaluation(run.perfect_streaks()))["detection"]["ground"]
    missed = score_evaluation(run.evaluation(run.perfect_streaks()[:0]))["detection"]["ground"]
    for score in (found, missed):
        assert score["n_truth"]["value"] == 0
        assert score["false_per_frame"]["value"] == 0.0


def test_every_figure_has_n_and_interval_or_reason(synthetic: Factory) -> None:
    run = synthetic(5)

    def walk(node: object, path: str) -> int:
        seen = 0
        if isinstance(node, dict) and "value" in node and "n" in node:
            if node["value"] is None:
                assert node["reason"], path
            else:
                assert node["low"] <= node["value"] + 1e-9, path
                assert node["value"] <= node["high"] + 1e-9, path
            return 1
        if isinstance(node, dict):
            seen = sum(walk(v, f"{path}.{k}") for k, v in node.items())
        if isinstance(node, list):
            seen = sum(walk(v, path) for v in node)
        return seen

    assert walk(score_evaluation(run.evaluation(Table(run.perfect_streaks()))), "score") > 60
