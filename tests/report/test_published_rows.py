"""What the pages say of published files: good, bad and not measured, each in its words; a run ends with the bad ones."""

from pathlib import Path

from sboc_e2e.report.closing import closing_text
from sboc_e2e.report.published_files import AIMS, PublishedRow, published_rows
from sboc_e2e.score.figures import absent, figure


def products(**angles: dict) -> dict:
    return {"products": {"angles": angles}}


def row(score: dict, figure_name: str) -> PublishedRow:
    return published_rows(score)[[aim.figure for aim in AIMS].index(figure_name)]


def test_a_figure_is_held_against_its_aim() -> None:
    same = products(differs_from_streaks=figure(0.0, 300, 0.0, 0.0))
    assert row(same, "angles.differs_from_streaks").verdict == "holds"
    differing = products(differs_from_streaks=figure(0.74, 342, 0.6, 0.9))
    assert row(differing, "angles.differs_from_streaks").verdict == "missed"
    assert row(differing, "angles.differs_from_streaks").aim == "0"
    for value, low, high, verdict in (
        (1.05, 0.9, 1.2, "holds"),
        (1.2, 1.05, 1.3, "not sure"),
        (1.3, 1.2, 1.4, "missed"),
        (0.5, 0.4, 0.8, "missed"),
    ):
        assert row(products(along_pull_std=figure(value, 99, low, high)), "angles.along_pull_std").verdict == verdict


def test_angles_are_held_against_those_of_the_table() -> None:
    table = figure(9.12, 298, 2.5, 16.2)
    worse = products(along_rms_arcsec=figure(17.05, 298, 9.88, 24.1), streaks_along_rms_arcsec=table)
    assert row(worse, "angles.along_rms_arcsec").verdict == "missed"
    assert row(worse, "angles.along_rms_arcsec").aim == "at most 9.120, that of streaks.ecsv"
    same = products(along_rms_arcsec=figure(9.1200001, 298, 2.5, 16.2), streaks_along_rms_arcsec=table)
    assert row(same, "angles.along_rms_arcsec").verdict == "holds"


def test_what_was_not_measured_says_why() -> None:
    score = products(differs_from_streaks=absent("no tracklet was published"))
    found = row(score, "angles.differs_from_streaks")
    assert (found.value, found.note, found.verdict) == ("-", "no tracklet was published", "-")
    older = row({}, "observer.implied_minus_quoted_rms_m_s")
    assert "an earlier version" in older.note


def test_pages_show_published_files(reported_run: Path) -> None:
    page, summary = (reported_run / "report.html").read_text(), (reported_run / "report.md").read_text()
    for text in (page, summary):
        assert "OEM velocities implied minus quoted" in text
        assert "no tracking data message was published" in text
    assert "on board, x real time on one core, this run" in summary


def test_a_run_ends_with_its_figures_and_with_what_is_bad() -> None:
    score = products(differs_from_streaks=figure(0.74, 342, 0.6, 0.9))
    score["astrometry"] = {"along_rms_arcsec": figure(27.7, 173, 2.7, 45.1)}
    text = closing_text(score, {})
    assert "along-track (arcsec rms)" in text
    assert "Published files miss what they should be (see docs/products.md):" in text.splitlines()
    assert "27.70  [2.700, 45.10]  (n = 173)" in text
    last = text.splitlines()[-1]
    assert last.endswith("0.7400  [0.6000, 0.9000], should be 0")
    assert "Published files miss" not in closing_text({}, {})
