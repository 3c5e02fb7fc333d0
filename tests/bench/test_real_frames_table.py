"""Sums of real frames against published intervals, and the half that is kept."""

import pytest

from tests.benchmarks.real_frames import covered
from tests.benchmarks.real_frames_table import Row, Trail, rate_text, share_text, sums_text


def row(file: str, *, camera: str = "raw", trails: tuple[Trail, ...] = (), false: int = 0) -> Row:
    return Row(
        file=file, frame=file, camera=camera, rows=100, cols=100, trails=trails, measured=1, false=false, false_sure=0, sure=0,
        cpu_s=1.0, wall_s=1.0, exit_code=0,
    )  # fmt: skip


def trail(published: float, *, inside: bool = True) -> Trail:
    return Trail(
        found=1.0, published=published, end_px=(0.5, 3.0), interval_px=(1.0, 400.0 if inside else 1.0), snr=20.0, probability=0.9,
        extra=0,
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
    assert "whatever is quoted: 1 of 2 (1 to 99 %)." in lines[9]
    assert "of more than 6 px, as of trails that fade: 1, within it 1 of 1 (2 to 100 %)" in lines[9]


def streak(row0: float, col0: float, row1: float, col1: float, sagitta_px: float = 0.0) -> dict[str, float]:
    return {"row0": row0, "col0": col0, "row1": row1, "col1": col1, "sagitta_px": sagitta_px, "width_px": 1.0}


def test_a_streak_covers_a_trail_where_it_lies_on_it() -> None:
    """The trail runs from column 100 to 300 of row 50; a streak may be 6 px beside it."""
    trail = (100.0, 50.0, 300.0, 50.0)
    assert covered(streak(50.0, 100.0, 50.0, 300.0), trail) == 1.0
    assert covered(streak(52.0, 300.0, 49.0, 200.0), trail) == pytest.approx(0.5), "from either end"
    assert covered(streak(45.0, 100.0, 55.0, 400.0), trail) == 1.0, "5 px beside it, and beyond its end"
    assert covered(streak(45.0, 0.0, 45.0, 1300.0), trail) == 1.0
    assert covered(streak(40.0, 100.0, 60.0, 300.0), trail) == 0.0, "10 px beside it at its ends"
    assert covered(streak(58.0, 100.0, 58.0, 300.0), trail) == 0.0
    assert covered(streak(50.0, 310.0, 50.0, 400.0), trail) == 0.0, "beyond it"
    assert covered(streak(42.0, 100.0, 42.0, 300.0, sagitta_px=8.0), trail) == 0.0, "an arc away from its ends"
    assert covered(streak(50.0, 60.0, 50.0, 340.0, sagitta_px=9.0), trail) == 1.0, "the eye marked the chord"
    gentle = 50.0 + 4.0 * 12.0 * 0.25 * 0.75
    assert covered(streak(50.0, 0.0, 50.0, 400.0, sagitta_px=12.0), (100.0, gentle, 300.0, gentle)) == 1.0, "its arc"
    strong = 50.0 + 4.0 * 30.0 * 0.25 * 0.75
    assert covered(streak(50.0, 0.0, 50.0, 400.0, sagitta_px=30.0), (100.0, strong, 300.0, strong)) == 0.0, "8 px beside it"
