"""Lines of frames from outside against their own neighbourhood, and the weights that were fitted across cameras."""

import math
from dataclasses import replace

import numpy as np
import pytest

from ground.streaks import TrailedPsfFitter
from ground.vetting import any_camera
from ground.vetting.any_camera import UNMODELLED_SNR, USUAL, as_unmodelled, contrasts_of, others_near, probability_in_any_camera
from ground.vetting.contrast import TILE_PX, Contrast, Tiles
from ground.vetting.galaxies import of_galaxy
from ground.vetting.look_alikes import TOO_SHARP
from ground.vetting.particles import SHORTEST_PX, THICKNESS_PX, odds_of_particles
from ground.vetting.repeated import doubled
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakFit
from tests.benchmarks.any_camera_weights import TERMS, Judged, Lines, fitted, judged, out_of_camera
from tests.streaks.impostors import draw
from tests.streaks.lit_lines import EVEN, METEOR, SHAPE, fit_of_a_trail, lit, placed
from tests.streaks.lit_lines import judged as judged_in_frame

SIDE_PX = 200
ENDS = (40.0, 30.0, 120.0, 170.0)
"""First and last row and column of the line of these tests."""
AMONG_STARS = np.array([[0.75, -0.1, -0.05, 0.45, -2.3, 3.3, 0.2]])
"""Numbers of the picture about a trail in a night sky (`surroundings.NAMES`)."""


@pytest.fixture(scope="module")
def line() -> StreakFit:
    """A fit along `ENDS`, 1.2 px wide at S/N 60."""
    shot = draw("real", np.random.default_rng(5))
    found = TrailedPsfFitter().fit(shot.pixels, shot.detection)
    return replace(
        found, row0=ENDS[0], col0=ENDS[1], row1=ENDS[2], col1=ENDS[3], width_px=1.2, snr=60.0, sagitta_px=0.0, chi2_nu=1.0
    )


def sky(seed: int) -> np.ndarray:
    """White noise of one count."""
    return np.random.default_rng(seed).normal(100.0, 1.0, (SIDE_PX, SIDE_PX)).astype(np.float32)


def trail(shares: np.ndarray, peak: float) -> np.ndarray:
    """Light of stars of 1.2 px at shares of the way along `ENDS`, as high as a trail of this peak where they lie densely."""
    row, col = np.mgrid[:SIDE_PX, :SIDE_PX]
    out = np.zeros((SIDE_PX, SIDE_PX), np.float32)
    for share in shares:
        r, c = ENDS[0] + share * (ENDS[2] - ENDS[0]), ENDS[1] + share * (ENDS[3] - ENDS[1])
        out += np.exp(-0.5 * ((row - r) ** 2 + (col - c) ** 2) / 1.2**2).astype(np.float32)
    return peak * out / out.max()


def tiles(pixels: np.ndarray, mask: np.ndarray | None = None) -> Tiles:
    """The tiles of an image along the line."""
    unknown = np.zeros(pixels.shape, np.uint8) if mask is None else mask
    return Tiles.of(pixels, unknown, [(ENDS[0], ENDS[1], ENDS[2], ENDS[3])])


def test_a_trail_wins_in_all_its_pieces_and_a_row_of_stars_or_noise_in_some(line: StreakFit) -> None:
    even = Contrast.of(line, tiles(sky(1) + trail(np.linspace(0.0, 1.0, 400), 8.0)))
    assert even is not None
    assert even.pieces >= 20
    assert even.wins > 0.95
    assert even.peak > 0.6
    row = Contrast.of(line, tiles(sky(1) + trail(np.array([0.1, 0.4, 0.7, 0.95]), 40.0)))
    assert row is not None
    assert row.wins < 0.6
    noise = Contrast.of(line, tiles(sky(1)))
    assert noise is not None
    assert noise.wins < 0.4
    assert noise.peak < 0.0


def test_the_edge_of_a_bright_area_does_not_win(line: StreakFit) -> None:
    row, col = np.mgrid[:SIDE_PX, :SIDE_PX]
    above = (row - ENDS[0]) * (ENDS[3] - ENDS[1]) > (col - ENDS[1]) * (ENDS[2] - ENDS[0])
    edge = Contrast.of(line, tiles(sky(2) + 50.0 * above.astype(np.float32)))
    assert edge is not None
    assert edge.wins == 0.0


def test_masked_pixels_and_places_outside_say_nothing(line: StreakFit) -> None:
    lit = sky(3) + trail(np.linspace(0.0, 1.0, 400), 8.0)
    assert Contrast.of(line, tiles(lit, np.ones(lit.shape, np.uint8))) is None
    half = np.zeros(lit.shape, np.uint8)
    half[:, 100:] = 1
    part, whole = Contrast.of(line, tiles(lit, half)), Contrast.of(line, tiles(lit))
    assert part is not None
    assert whole is not None
    assert part.pieces < 0.6 * whole.pieces
    assert Contrast.of(replace(line, row0=-90.0, row1=-10.0), tiles(lit)) is None


def test_tiles_hold_the_pixels_around_lines_alone() -> None:
    pixels = np.arange(300 * 300, dtype=np.float32).reshape(300, 300)
    kept = Tiles.of(pixels, np.zeros(pixels.shape, np.uint8), [(10.0, 10.0, 20.0, 20.0)], 2.0)
    assert kept.at(np.array([12.3]), np.array([15.6]))[0] == 2.0 * pixels[12, 16]
    assert np.isnan(kept.at(np.array([290.0, -50.0]), np.array([290.0, 5.0]))).all()
    assert len(kept.adu) == 1
    assert kept.adu.shape[1:] == (TILE_PX, TILE_PX)


def chance(fit: StreakFit, given: float, sharpness: float, around: Tiles, tracks: float = math.inf) -> float:
    """Probability of a line that a vetter gives one."""
    own = np.array([given])
    contrasts = contrasts_of([fit], own, around)
    return float(probability_in_any_camera([fit], own, [sharpness], contrasts, np.array([tracks]), np.zeros(1), AMONG_STARS)[0])


def test_contrast_lifts_what_a_vetter_doubts_and_lowers_what_has_none(line: StreakFit) -> None:
    lit = tiles(sky(4) + trail(np.linspace(0.0, 1.0, 400), 8.0))
    assert chance(line, 0.2, 0.0, lit) > 0.9
    assert chance(line, 0.2, -0.7, lit) < 0.5, "sharper than the optics"
    assert chance(line, 0.2, -0.7, lit, tracks=0.1) > 0.8, "in a frame without tracks of particles"
    assert chance(line, 0.6, 0.0, tiles(sky(4))) < 0.1
    for snr in (60.0, UNMODELLED_SNR, 600.0):
        assert chance(replace(line, snr=snr), 0.0, 0.0, lit) == 0.0, "what was refused stays so"


def test_a_line_tells_less_where_many_others_are_found(line: StreakFit) -> None:
    """Long lines of a frame count, whatever they are. Up to 20 say nothing: simulated skies have as many."""
    contrasts = contrasts_of([line], np.ones(1), tiles(sky(4) + trail(np.linspace(0.0, 1.0, 400), 8.0)))

    def odds(others: float) -> float:
        given = np.array([0.05]), [0.0], contrasts, np.array([math.inf]), np.array([others]), AMONG_STARS
        p = float(probability_in_any_camera([line], *given)[0])
        return p / (1.0 - p)

    assert odds(0.0) == odds(20.0)
    assert odds(20.0) / odds(40.0) == pytest.approx(odds(40.0) / odds(80.0), rel=1e-6)
    assert odds(20.0) / odds(40.0) == pytest.approx(2.0**-any_camera.PER_LN_OTHERS, rel=1e-6)


def test_lines_of_a_tree_say_little_of_the_sky_and_short_ones_nothing(line: StreakFit) -> None:
    """Three frames of a film had 40 to 60 lines in a tree, and trails far from it."""
    in_tree = replace(line, row0=900.0, row1=940.0, col0=100.0, col1=130.0)
    beside = replace(in_tree, col0=140.0, col1=170.0)
    in_sky = replace(line, row0=100.0, row1=140.0, col0=1000.0, col1=1030.0)
    short = replace(in_tree, row1=924.0, col1=118.0)
    near, far = others_near([beside, in_sky, *[in_tree] * 50, *[short] * 50], (1000, 1200))[:2]
    assert far == pytest.approx(0.2 * 51, rel=0.02), "a fifth counts anywhere"
    assert near > 300.0
    assert others_near([], (1000, 1200)).shape == (0,)
    assert others_near([in_tree], (1000, 1200)).tolist() == [0.0]


def test_a_frame_with_long_sharp_lines_and_no_short_ones_has_no_tracks_of_particles(line: StreakFit) -> None:
    """Six meteors of a picture were a third as wide as its stars, 80 to 320 px long, and five had p of 0.01 to 0.10 for it.
    A Hubble chip has 96 sharp lines; lengths of tracks from all sides are drawn here."""
    meteors = [replace(line, row1=line.row0, col1=line.col0 + length) for length in (320.0, 128.0, 125.0, 114.0, 89.0, 80.0)]
    assert odds_of_particles(meteors, [True] * 6).max() < 0.1
    share = (np.arange(90) + 0.5) / 90
    lengths = np.sqrt((THICKNESS_PX**2 + SHORTEST_PX**2) / share - THICKNESS_PX**2)
    tracks = [replace(line, row1=line.row0, col1=line.col0 + length) for length in lengths]
    odds = odds_of_particles([*tracks, meteors[1]], [True] * 91)
    assert odds[-1] > 2.0, "128 px long among them"
    assert np.median(odds) > 10.0
    assert np.isinf(odds_of_particles(meteors, [False] * 6)).all(), "as wide as the optics"
    assert np.isinf(odds_of_particles([replace(meteors[0], snr=7.0)], [True])).all(), "noise is as sharp"


def test_of_two_published_fits_that_share_half_their_length_the_longer_stays(line: StreakFit) -> None:
    """A fireball, 1,730 px long: the second fit began 158 px later and ended 11 px farther on, beyond the first one's reach."""
    part = replace(line, row0=80.0, col0=100.0, row1=128.0, col1=184.0, snr=2.0 * line.snr)
    follows = replace(line, row0=112.0, col0=156.0, row1=168.0, col1=254.0)
    assert doubled([part, line, follows], np.ones(3), [1.0, 1.0, 1.0]).tolist() == [True, False, False]
    assert not doubled([part, line], np.array([1.0, 0.4]), [1.0, 1.0]).any(), "the longer one is not published"


def test_of_two_published_fits_the_one_stays_that_stands_out_over_the_greater_length(line: StreakFit) -> None:
    """A fireball: the longest of seven fits on it bent away, and 0.78 of its pieces won. It was the one that stayed."""
    away = replace(line, row1=line.row1 + 8.0, col1=line.col1 + 20.0, sagitta_px=9.0)
    assert doubled([away, line], np.ones(2), [0.78, 1.0]).tolist() == [True, False]
    assert doubled([away, line], np.ones(2), [1.0, 1.0]).tolist() == [False, True]


def test_a_fit_that_ran_on_over_nothing_gives_way_to_the_trail_it_ran_on_from(line: StreakFit) -> None:
    """A meteor of S/N 54, 57 px long, among many stars; the fit over 719 px that holds it had S/N 17 and stayed."""
    far = replace(line, row0=0.0, row1=0.0, col0=0.0, col1=719.0, snr=17.0)
    meteor = replace(line, row0=0.0, row1=0.0, col0=150.0, col1=207.0, snr=54.0)
    assert doubled([far, meteor], np.ones(2), [0.6, 0.8]).tolist() == [True, False]
    with_tail = replace(far, snr=24.0)  # a tail of 5 % of its brightness all along
    assert doubled([with_tail, meteor], np.ones(2), [0.6, 0.8]).tolist() == [False, True]


def test_the_weights_are_those_of_the_table_of_lines() -> None:
    lines = Lines.of()
    weights = fitted(lines, np.ones(len(lines.real), dtype=bool))
    stated = (*any_camera.PER_TERM, any_camera.CONSTANT)
    for name, given, value in zip((*TERMS, "CONSTANT"), stated, weights, strict=True):
        assert given == pytest.approx(value, abs=0.05 if abs(value) > 5.0 else 0.006), name


def test_cameras_judged_by_the_others_publish_as_the_page_says() -> None:
    lines = Lines.of()
    found = judged(lines, out_of_camera(lines), simulated=False)
    assert found == Judged(trails=518, published=439, false=26, sure=409, sure_false=12)


def test_a_long_bright_line_that_stands_out_all_along_is_not_refused_for_its_width_and_texture(line: StreakFit) -> None:
    """A satellite of S/N 892 across a stack had 0.005 and then 0.33: its texture was that of lines that recur."""
    bright = replace(line, snr=900.0)
    column = replace(bright, row0=10.0, row1=190.0, col0=50.0, col1=50.0)
    clear, broken = Contrast(pieces=64, wins=0.78, peak=0.72), Contrast(pieces=64, wins=0.5, peak=0.72)
    fits = [bright, bright, bright, replace(bright, snr=60.0), column]
    raised = as_unmodelled(fits, np.full(5, 0.005), [clear, broken, None, clear, clear])
    assert raised.tolist() == [0.1, 0.005, 0.005, 0.005, 0.005]
    assert as_unmodelled([bright], np.array([0.9]), [clear]).tolist() == [0.9]
    nothing = np.full(1, np.inf)
    assert probability_in_any_camera([bright], raised[:1], [0.0], [clear], nothing, np.zeros(1), AMONG_STARS)[0] > 0.7


def test_glow_and_width_of_a_fireball_do_not_speak_against_it(line: StreakFit) -> None:
    """Two of S/N 1,291 and 5,970 had 0.02 and 0.03 for the unrest and the structure about them: their own glow. What speaks for a
    line still does. Full pixels widen it."""
    glow = np.array([[2.5, -0.6, -0.97, 0.6, -2.1, 2.1, 0.3]])
    fireball = replace(line, snr=1291.0)
    nothing = np.full(1, np.inf)

    def given(fit: StreakFit, contrast: Contrast, picture: np.ndarray, sharpness: float = 0.0) -> float:
        return float(probability_in_any_camera([fit], np.full(1, 0.7), [sharpness], [contrast], nothing, np.zeros(1), picture)[0])

    clear = Contrast(pieces=11, wins=1.0, peak=0.83)
    silent = given(fireball, clear, np.array([USUAL]))
    assert given(fireball, clear, glow) == silent > 2.0 * given(replace(fireball, snr=400.0), clear, glow)
    for other in (replace(clear, wins=0.9), replace(clear, peak=0.7)):
        assert given(fireball, other, glow) < given(fireball, other, np.array([USUAL]))
    assert given(fireball, clear, AMONG_STARS) == given(replace(fireball, snr=400.0), clear, AMONG_STARS) > silent
    assert given(fireball, clear, glow, 1.4) == silent > given(fireball, replace(clear, wins=0.9), np.array([USUAL]), 1.4)
    assert given(fireball, clear, glow, -0.5) < silent


@pytest.mark.parametrize("width_px", [2.0, 5.0])
def test_what_is_no_light_by_its_surroundings_does_not_tell_the_optics(width_px: float) -> None:
    """The ridge of a hill, 5 px wide, made eleven meteors of 0.3 to 0.4 px too sharp, each by 13 in the log odds."""
    found = fit_of_a_trail()
    meteor = placed(found, (60.0, 100.0, 90.0, 160.0), 0.45, 300.0)
    ridge = placed(found, (220.0, 60.0, 190.0, 640.0), width_px, 300.0)
    row, col = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    beside_a_trail = lit(meteor, EVEN, 60.0) + lit(ridge, EVEN, 20.0) - 100.0
    above_a_hill = lit(meteor, EVEN, 60.0) + 20.0 * (row > 220.0 - 30.0 * (col - 60.0) / 580.0)
    for given in (0.9, 0.14):
        assert judged_in_frame((0.45, given), [meteor, ridge], beside_a_trail)[0] < 0.1
        assert judged_in_frame((0.45, given), [meteor, ridge], above_a_hill)[0] > 0.9


def test_a_column_far_sharper_than_the_stars_is_no_light_of_sharper_optics() -> None:
    """Two columns of a raw frame, 0.05 px wide beside stars of 2.9 px, had p of 0.64 and 0.98: particles are not as long."""
    found = fit_of_a_trail()
    column = placed(found, (5.0, 400.0, 295.0, 402.0), 0.3, 300.0)
    assert judged_in_frame((0.08,), [column], lit(column, EVEN, 60.0), 2.9)[0] < 0.01
    # stars that the air or the mount widens are a few times as wide as light that crosses their pixels in an instant
    meteor = placed(found, (5.0, 400.0, 295.0, 502.0), 1.2, 300.0)
    assert judged_in_frame((0.9,), [meteor], lit(meteor, EVEN, 60.0), 2.9)[0] > 0.5


def test_tracks_far_sharper_than_the_stars_are_not_published_however_well_they_stand_out() -> None:
    """In skies with particles tracks of 75 to 100 px had p up to 0.85: 25 false lines in 80 frames, two since."""
    found = fit_of_a_trail()
    track = placed(found, (60.0, 100.0, 90.0, 195.0), 0.05, 1300.0)
    picture = lit(track, EVEN, 60.0)
    assert judged_in_frame((0.42,), [track], picture, 0.88)[0] <= TOO_SHARP
    assert judged_in_frame((0.42,), [track], picture, 0.5)[0] > TOO_SHARP


def test_a_wide_short_line_among_sharp_stars_may_be_a_galaxy() -> None:
    """NGC 4656, 215 px long and six times as wide as the stars, had p 0.75. Trails out of focus were 180 to 390 widths long."""
    galaxy = placed(fit_of_a_trail(), (100.0, 100.0, 130.0, 300.0), 6.0, 320.0)
    light = lit(galaxy, METEOR, 30.0)
    assert judged_in_frame((0.5,), [galaxy], light, 1.0)[0] < 0.1
    assert judged_in_frame((0.5,), [galaxy], light)[0] > 0.5, "nothing tells that the stars are sharper"
    assert of_galaxy(galaxy, math.log(6.0)) > 0.0
    cut = replace(galaxy, flags=galaxy.flags | StreakFlag.EDGE0)
    others = replace(galaxy, snr=600.0), replace(galaxy, col1=400.0), replace(galaxy, width_px=3.0), cut
    assert [of_galaxy(fit, math.log(fit.width_px)) for fit in others] == [0.0, 0.0, 0.0, 0.0]
