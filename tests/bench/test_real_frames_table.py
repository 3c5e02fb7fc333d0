"""Sums of real frames against published intervals, and the half that is kept."""

import pytest

from tests.benchmarks.real_frames_table import Row, Trail, rate_text, share_text, sums_text


def row(file: str, *, camera: str = "raw", trails: tuple[Trail, ...] = (), false: int = 0) -> Row:
    return Row(
        file=file, frame=file, camera=camera, rows=100, cols=100, trails=trails, measured=1, false=false, false_sure=0, sure=0,
        cpu_s=1.0, wall_s=1.0, exit_code=0,
    )  # fmt: skip


def trail(published: float, *, inside: bool = True) -> Trail:
    return Trail(
        found=1.0, published=published, end_px=(0.5, 3.0), inside=(True, inside), snr=20.0, probability=0.9, extra=0,
    )  # fmt: skip


@pytest.mark.parametrize(("k", "n", "words"), [(5, 5, "48 to 100 %"), (0, 10, "0 to 31 %"), (8, 10, "44 to 97 %")])
def test_shares_have_clopper_and_pearson_s_interval(k: int, n: int, words: str) -> None:
    """Values of the published tables (Clopper & Pearson 1934), two-sided at 95 %."""
    assert words in share_text(k, n)


def test_rates_have_the_exact_poisson_interval() -> None:
    """Garwood (1936): none counted is at most 3.69, ten are 4.80 to 18.39."""
    assert rate_text(0, 1) == "0 in 1: 0.000 a frame (0.000 to 3.689)"
    assert rate_text(10, 1) == "10 in 1: 10.000 a frame (4.795 to 18.390)"
    assert rate_text(0, 0) == "no case"


def test_what_is_asked_is_answered_for_all_and_for_the_kept_half() -> None:
    """SHA-256 of "f.fits" ends in c, that of "b.fits" in d (coreutils' sha256sum)."""
    rows = [
        row("f.fits", trails=(trail(1.0),)),
        row("b.fits", trails=(trail(0.4),)),
        row("b.fits", false=1),
        row("f.fits", camera="GMOS, calibrated"),
    ]
    lines = sums_text(rows).splitlines()
    assert "1 of 2 (1 to 99 %) | no | 0 of 1 (0 to 98 %) | no" in lines[2]
    assert "2 of 2" in lines[3]
    assert "1 in 1: 1.000 a frame" in lines[4]
    assert lines[4].count("| no |") == 2
    assert "0 in 1" in lines[5]
    assert "| yes | no case | no case |" in lines[5]
    assert "0 of 4 | yes | 0 of 2 | yes" in lines[7]
