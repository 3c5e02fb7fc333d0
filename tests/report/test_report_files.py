"""The report is one file that loads nothing, names its misses, and stays small."""

import re
from pathlib import Path

import pytest

from sboc_e2e.report.write import write_report
from sboc_e2e.score import evaluate


def test_page_is_self_contained(reported_run: Path) -> None:
    page = (reported_run / "report.html").read_text()
    assert not re.findall(r"""(?:src|href)\s*=\s*["']https?:""", page)
    assert "@import" not in page
    assert (reported_run / "report.html").stat().st_size < 25e6
    assert not list(reported_run.glob("*.part"))


def test_texts_from_the_run_are_escaped(reported_run: Path) -> None:
    page = (reported_run / "report.html").read_text()
    assert "&lt;/script&gt;" in page
    assert page.count("</script>") == 2


def test_summary_is_short_and_has_the_headlines(reported_run: Path) -> None:
    summary = (reported_run / "report.md").read_text()
    assert len(summary.splitlines()) < 50
    assert "completeness, S/N >= 8" in summary
    assert "12 truth streaks, 11 measured, 1 false" in summary


def test_downlink_is_told_in_bits_for_each_thing_that_is_sent(reported_run: Path) -> None:
    """Beside the plot of kinds of packets; this run sent nothing."""
    page = (reported_run / "report.html").read_text()
    assert "Downlink by kind of packet; bits: 0 a frame, - a star, - a streak" in page


def test_same_run_same_page(reported_run: Path) -> None:
    before = (reported_run / "report.html").read_bytes()
    write_report(reported_run)
    assert (reported_run / "report.html").read_bytes() == before


def test_evaluation_handed_over_gives_the_same_page(reported_run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The score stage hands its evaluation to the report, which then does not make another one."""
    before = (reported_run / "report.html").read_bytes()
    evaluation = evaluate(reported_run)
    monkeypatch.setattr("sboc_e2e.report.write.evaluate", None)
    write_report(reported_run, evaluation)
    assert (reported_run / "report.html").read_bytes() == before
