"""The vetter on simulated detections of all classes, other seeds than those its table was made from."""

import math
import pickle
from dataclasses import replace

import numpy as np
import pytest

from ground.streaks import TrailedPsfFitter
from ground.vetting import LikelihoodVetter, likelihood
from ground.vetting.class_densities import BINS, FLAG_SHARES, RECURRING, class_densities
from ground.vetting.features import features_of
from ground.vetting.likelihood import LONGEST_PARTICLE_PX, noise_excess, sharpest_light_px, sharpness_of
from ground.vetting.readout import odds_of_readout
from ground.vetting.repeated import repeated
from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakFit
from sboc_e2e.icd.steps import Vetter
from tests.downlink import frame_of_psf
from tests.streaks.impostors import CLASSES, draw
from tests.streaks.trail_rendering import PSF_SIGMA_PX, expose, trail_at

PER_CLASS = 40


@pytest.fixture(scope="module")
def frame() -> DownlinkFrame:
    return frame_of_psf(PSF_SIGMA_PX)


@pytest.fixture(scope="module")
def fits() -> dict[str, list[StreakFit]]:
    fitter = TrailedPsfFitter()
    out = {}
    for k, name in enumerate(CLASSES):
        rng = np.random.default_rng([31, k])
        shots = [draw(name, rng) for _ in range(PER_CLASS)]
        out[name] = [fitter.fit(shot.pixels, shot.detection) for shot in shots]
    return out


def alone(fits: list[StreakFit], frame: DownlinkFrame) -> np.ndarray:
    """Probability of each fit as the only one of its frame."""
    vetter = LikelihoodVetter()
    return np.array([vetter.probability([fit], frame)[0] for fit in fits])


def test_matches_the_protocol_and_pickles() -> None:
    assert isinstance(LikelihoodVetter(), Vetter)
    assert pickle.loads(pickle.dumps(LikelihoodVetter())) == LikelihoodVetter()  # noqa: S301  its own bytes


def test_no_fits_no_probabilities(frame: DownlinkFrame) -> None:
    assert LikelihoodVetter().probability([], frame).shape == (0,)


def test_real_streaks_pass_and_particles_do_not(fits: dict[str, list[StreakFit]], frame: DownlinkFrame) -> None:
    """Of 40 each: no real streak below 2 %, no particle, group of hits or hot line above 50 %."""
    real = alone(fits["real"], frame)
    assert real.min() >= 0.02
    assert np.median(real) > 0.9
    for name in ("particle", "hit_group", "hot_line"):
        assert alone(fits[name], frame).max() < 0.5, name


def test_noise_maxima_are_doubted_by_their_faintness(fits: dict[str, list[StreakFit]], frame: DownlinkFrame) -> None:
    """They look like streaks in all but S/N: less probable than bright streaks, more than particles."""
    noise, real = alone(fits["noise"], frame), alone([fit for fit in fits["real"] if fit.snr > 12.0], frame)
    assert np.median(noise) < 0.75
    assert real.min() > np.median(noise)


def test_hits_beside_each_other_are_no_trail_though_as_wide_as_one(
    fits: dict[str, list[StreakFit]], frame: DownlinkFrame
) -> None:
    """Fitted as one trail some are as wide as the PSF; chi-square 30 sigma and more beyond any trail's tells them."""
    wide = [fit for fit in fits["hit_group"] if abs(math.log(fit.width_px / PSF_SIGMA_PX)) < 0.2]
    assert len(wide) >= 3
    assert alone(wide, frame).max() < 0.1


def test_flags_of_other_frames_and_stars_count(fits: dict[str, list[StreakFit]], frame: DownlinkFrame) -> None:
    bright = max(fits["real"], key=lambda fit: fit.length_px)
    plain = alone([bright], frame)[0]
    static = alone([replace(bright, flags=bright.flags | StreakFlag.STATIC)], frame)[0]
    spike = alone([replace(bright, flags=bright.flags | StreakFlag.SPIKE_LIKE)], frame)[0]
    assert static < 0.5 * plain
    assert spike < plain


def test_a_storm_turns_the_odds_of_its_frame_only_towards_particles(
    fits: dict[str, list[StreakFit]], frame: DownlinkFrame
) -> None:
    """Among forty particle tracks a short bright streak is less sure than alone; probabilities stay in [0, 1]."""
    vetter = LikelihoodVetter()
    candidate = fits["real"][0]
    together = vetter.probability([candidate, *fits["particle"]], frame)
    assert together[0] <= vetter.probability([candidate], frame)[0] + 1e-12
    assert ((together >= 0.0) & (together <= 1.0)).all()


def test_the_table_is_complete_and_normalised() -> None:
    densities = class_densities()
    assert set(densities) == {*CLASSES, RECURRING}
    for density in densities.values():
        assert sum(w for w, _, _ in density.sharpness) == pytest.approx(1.0, abs=1e-3)
        for name, histogram in density.histograms.items():
            assert histogram.size == len(BINS[name]) + 1
            assert histogram.sum() == pytest.approx(1.0, abs=1e-4)
            assert histogram.min() > 0.0
        assert set(density.shares) == set(FLAG_SHARES)


def test_the_width_that_a_frame_reports_is_the_one_that_its_trails_should_have(frame: DownlinkFrame) -> None:
    """Trails of a telescope with six times the width are sure where the frame's stars tell that width, and doubted elsewhere."""
    rng = np.random.default_rng(12)
    wide_px = 6.0 * PSF_SIGMA_PX
    shots = [expose(rng, trail_at(rng, 60.0, sigma_px=wide_px), 30.0, half_px=25.0) for _ in range(6)]
    fitter = TrailedPsfFitter()
    fits = [fitter.fit(replace(shot.pixels, psf_sigma_px=wide_px), shot.detection) for shot in shots]
    told, untold = alone(fits, replace(frame, psf_sigma_px=wide_px)), alone(fits, frame)
    assert told.min() > 0.9
    assert untold.min() < 0.8
    assert np.median(untold) < np.median(told)


def test_a_trail_out_of_focus_is_less_doubted_where_nobody_calibrated(
    fits: dict[str, list[StreakFit]], frame: DownlinkFrame, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Near satellites are, by twice the optics and more. One that is as sharp as the optics keeps its probability."""
    bright = replace(max(fits["real"], key=lambda fit: fit.snr), width_err_px=0.01, chi2_nu=3.0)
    wide, narrow = replace(bright, width_px=2.2 * 0.85), replace(bright, width_px=0.8 * 0.85)
    vetter, known = LikelihoodVetter(model_error=0.2), replace(frame, psf_sigma_px=0.85)
    of_wide, of_narrow = (float(vetter.probability([fit], known)[0]) for fit in (wide, narrow))
    monkeypatch.setattr(likelihood, "WIDER_LN_PSF", 0.0)
    before, narrow_before = (float(vetter.probability([fit], known)[0]) for fit in (wide, narrow))
    assert of_wide / (1.0 - of_wide) > 2.0 * before / (1.0 - before)
    assert of_narrow == narrow_before


def test_where_stars_are_drawn_out_round_sources_still_tell_how_wide_a_trail_may_be(
    fits: dict[str, list[StreakFit]], frame: DownlinkFrame
) -> None:
    """A trail of 4 px and S/N 89 beside stars of 2.9 by 3.4 px was refused as a slope: 1.2 px was assumed for such frames."""
    bright = max(fits["real"], key=lambda fit: fit.snr)
    trail = replace(bright, width_px=4.0, width_err_px=0.1, snr=89.0, chi2_nu=1.0, row1=bright.row0 + 120.0)
    vetter, unknown = LikelihoodVetter(model_error=0.2), replace(frame, psf_sigma_px=None)
    assert vetter.probability([replace(trail, psf_sigma_px=2.9)], unknown)[0] > 0.5
    assert vetter.probability([replace(trail, psf_sigma_px=0.8)], unknown)[0] == 0.0
    assert vetter.probability([replace(trail, psf_sigma_px=math.nan)], unknown)[0] == 0.0


def test_noise_that_a_robust_scatter_does_not_see_is_told_by_faint_lines(
    fits: dict[str, list[StreakFit]], frame: DownlinkFrame, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Hot pixels leave tails: residuals of faint lines have a chi-square of 4, and a trail's is no evidence against it. Not on
    board, where the noise of the camera is known."""
    bright = replace(max(fits["real"], key=lambda fit: fit.snr), chi2_nu=6.0, snr=300.0, width_err_px=0.01)
    faint = [replace(fit, chi2_nu=4.0, snr=12.0, row1=fit.row0 + 40.0) for fit in fits["noise"][:6]]
    vetter, known = LikelihoodVetter(model_error=0.2), replace(frame, psf_sigma_px=0.85)
    assert noise_excess([bright, *faint]) == 4.0
    assert noise_excess([bright, *faint[:4]]) == 1.0
    assert noise_excess([bright, *(replace(fit, chi2_nu=0.7) for fit in faint)]) == 1.0
    same = replace(bright, chi2_nu=1.5, snr=150.0)
    quiet = [replace(fit, chi2_nu=1.0, snr=6.0) for fit in faint]
    assert vetter.probability([bright, *faint], known) == pytest.approx(vetter.probability([same, *quiet], known), rel=1e-6)
    on_board = LikelihoodVetter().probability([bright, *faint], known)
    monkeypatch.setattr(likelihood, "noise_excess", lambda _: 4.0)
    assert np.array_equal(LikelihoodVetter().probability([bright, *faint], known), on_board)


def test_where_nobody_knows_the_width_any_is_believed_but_not_in_blobs(frame: DownlinkFrame) -> None:
    """Without stars or a camera that tell the PSF: wide trails pass, sources no longer than four times their FWHM do not."""
    rng, fitter, unknown = np.random.default_rng(14), TrailedPsfFitter(), replace(frame, psf_sigma_px=None)
    wide_px = 3.0 * PSF_SIGMA_PX
    for length_px, believed in ((80.0, True), (15.0, False)):
        shots = [expose(rng, trail_at(rng, length_px, sigma_px=wide_px), 40.0, half_px=15.0) for _ in range(4)]
        fits = [fitter.fit(replace(shot.pixels, psf_sigma_px=wide_px), shot.detection) for shot in shots]
        vetter = LikelihoodVetter(model_error=0.2)
        probability = np.array([vetter.probability([fit], unknown)[0] for fit in fits])
        assert (probability.min() > 0.5) if believed else (probability.max() == 0.0)


def test_noise_maxima_are_as_rare_as_a_frame_of_anybodys_is_small(fits: dict[str, list[StreakFit]], frame: DownlinkFrame) -> None:
    """White noise has so many maxima a pixel: in a frame of 512 x 512 px they are 64 times as rare as in one of 4096 x 4096 px.

    By hand: where noise alone competes, the log odds of a lone line differ by ln 64. The line itself changes the rate of noise,
    three maxima in thirty full frames, by a third at most.
    """
    raw, small = LikelihoodVetter(model_error=0.2), replace(frame, header=replace(frame.header, rows=512, cols=512))
    faint = [features_of(fit, PSF_SIGMA_PX) for fit in fits["noise"]]
    gained = [float((raw.log_odds([f], area=1.0 / 64.0) - raw.log_odds([f]))[0]) for f in faint]
    assert max(gained) == pytest.approx(math.log(64.0), abs=math.log(4.0 / 3.0))
    real = min(fits["real"], key=lambda fit: abs(fit.snr - 7.5))
    assert raw.probability([real], small)[0] > raw.probability([real], frame)[0]
    calibrated = LikelihoodVetter()
    assert calibrated.probability([real], small)[0] == calibrated.probability([real], frame)[0], "its own camera"


def test_what_turbulence_does_to_a_bright_trail_is_no_evidence_against_it(
    fits: dict[str, list[StreakFit]], frame: DownlinkFrame
) -> None:
    """Light that lies beside the model adds (share x S/N)^2 to chi-square, whose statistical error takes no notice of it."""
    ragged = replace(max(fits["real"], key=lambda fit: fit.snr), snr=220.0, chi2_nu=3.2, n_pixels=1900)
    assert LikelihoodVetter(model_error=0.2).probability([ragged], frame)[0] > 0.9
    assert LikelihoodVetter().probability([ragged], frame)[0] < LikelihoodVetter(model_error=0.2).probability([ragged], frame)[0]


def test_a_trail_that_brightens_evenly_is_not_lumpy_and_a_chain_is(fits: dict[str, list[StreakFit]]) -> None:
    """A satellite that brightened from 23 to 709 ADU along a frame had a lumpiness of 0.75, as chains of stars have, and p 0.02.

    By hand: 32 bins of 1 to 30 have a scatter of 0.56 of their mean, and no second differences.
    """
    one = max(fits["real"], key=lambda fit: fit.snr)
    even = replace(one, snr=5000.0, light_curve_e_px=np.linspace(1.0, 30.0, 32, dtype=np.float32))
    assert features_of(even, one.psf_sigma_px).lumpiness == pytest.approx(0.56, abs=0.01)
    assert features_of(even, one.psf_sigma_px, may_vary=True).lumpiness < 0.01
    chain = replace(even, light_curve_e_px=np.tile([1.0, 1.0, 9.0, 1.0], 8).astype(np.float32))
    assert features_of(chain, one.psf_sigma_px, may_vary=True).lumpiness == features_of(chain, one.psf_sigma_px).lumpiness > 1.0


def test_a_trail_is_no_less_real_for_being_brighter_than_any_that_was_simulated(
    fits: dict[str, list[StreakFit]], frame: DownlinkFrame
) -> None:
    """Where stars tell the PSF too: debris ends at S/N 400, and satellites of S/N 700 were vetoed."""
    vetter, bright = LikelihoodVetter(model_error=0.2), max(fits["real"], key=lambda fit: fit.snr)
    probability = [vetter.probability([replace(bright, snr=snr)], frame)[0] for snr in (100.0, 700.0, 7000.0)]
    assert min(probability) > 0.9
    assert probability[2] > probability[0] - 0.01


def test_what_recurs_speaks_against_its_own_kind_and_not_against_a_long_bright_trail(
    fits: dict[str, list[StreakFit]], frame: DownlinkFrame
) -> None:
    """59 arcs of dust rings, 25 px long at S/N 20, raised one flat rate and vetoed a trail of 1,274 px (p 0.23)."""
    real = max(fits["real"], key=lambda fit: fit.snr)
    alike = replace(real, row0=10.0, col0=10.0, row1=25.0, col1=30.0, snr=20.0, width_px=3.0 * real.width_px)
    arc = replace(alike, flags=real.flags | StreakFlag.STATIC)
    trail = replace(real, row0=0.0, col0=0.0, row1=900.0, col1=900.0, snr=25.0, width_px=2.0 * real.width_px)
    vetter = LikelihoodVetter(model_error=0.2)
    among = vetter.probability([*[arc] * 59, trail], frame)
    assert among[:59].max() < 0.1
    assert among[59] > 0.5, "published"
    assert vetter.probability([*[arc] * 59, alike], frame)[59] < 0.5 * vetter.probability([alike], frame)[0]


def test_a_wide_trail_from_border_to_border_of_a_small_frame_is_published(
    fits: dict[str, list[StreakFit]], frame: DownlinkFrame
) -> None:
    """As DECam's of 100 x 100 px: 114 px long, sigma 5 px, S/N 1,100, texture of its own. A slope of the background is as wide,
    and leaves more than it explains."""
    small = replace(frame, psf_sigma_px=None, header=replace(frame.header, rows=100, cols=100))
    trail = replace(
        fits["real"][0], row0=-0.5, col0=5.0, row1=99.5, col1=60.0, width_px=5.0, snr=1100.0, chi2_nu=12.0, sagitta_px=0.0
    )
    slope = replace(trail, snr=147.0, chi2_nu=30.0)
    vetter = LikelihoodVetter(model_error=0.2)
    assert vetter.probability([trail], small)[0] > 0.5
    assert vetter.probability([slope], small)[0] < 0.1


def test_a_trail_found_twice_is_published_once(fits: dict[str, list[StreakFit]]) -> None:
    """The fainter of two fits on the same line, and a piece of it; another one beside it stays."""
    bright = max((fit for fit in fits["real"] if fit.length_px > 40.0), key=lambda fit: fit.snr)
    again = replace(bright, snr=0.8 * bright.snr, row0=bright.row0 + 0.4, row1=bright.row1 - 0.4)
    piece = replace(again, snr=0.5 * bright.snr, row1=0.5 * (bright.row0 + bright.row1), col1=0.5 * (bright.col0 + bright.col1))
    beside = replace(again, row0=bright.row0 + 30.0, row1=bright.row1 + 30.0, col0=bright.col0 - 30.0, col1=bright.col1 - 30.0)
    assert repeated([piece, bright, again, beside], np.ones(4)).tolist() == [True, False, True, False]
    assert not repeated([piece, bright, again, beside], np.array([0.9, 0.0, 0.0, 0.9])).any(), "by a fit that is not believed"


def outside_fit(
    fit: StreakFit, ends: tuple[float, float, float, float], *, width_px: float, snr: float, chi2_nu: float
) -> StreakFit:
    """A fit of a frame that nobody calibrated, from border to border."""
    return replace(
        fit,
        row0=ends[0],
        col0=ends[1],
        row1=ends[2],
        col1=ends[3],
        width_px=width_px,
        snr=snr,
        chi2_nu=chi2_nu,
        flags=StreakFlag.EDGE0 | StreakFlag.EDGE1 | StreakFlag.DEFOCUSED,
    )


def with_light(fit: StreakFit, light: np.ndarray) -> StreakFit:
    """The fit with another light curve (k,)."""
    return replace(fit, light_curve_e_px=light.astype(np.float32), light_curve_err_e_px=np.full(len(light), 0.1, np.float32))


def train_of_satellites(fit: StreakFit) -> list[StreakFit]:
    """Ten parallel trails, 640 px long at S/N 150, sigma 0.4 px, with 200 bins of light."""
    one = outside_fit(fit, (0.0, 0.0, 300.0, 565.0), width_px=0.4, snr=150.0, chi2_nu=1.5)
    one = with_light(replace(one, sagitta_px=0.0, flags=StreakFlag.COSMIC_LIKE | StreakFlag.CROSSES_STAR), np.ones(200))
    return [replace(one, row0=50.0 * k, row1=300.0 + 50.0 * k) for k in range(10)]


def test_long_lines_that_are_lit_all_along_tell_how_sharp_the_optics_are(fits: dict[str, list[StreakFit]]) -> None:
    """Stars of a crowded picture had three pixels, satellites of a train 0.4. Particles and rows tell nothing."""
    train = train_of_satellites(fits["real"][0])
    assert sharpest_light_px(train, [True] * len(train)) == pytest.approx(0.4)
    for n_dark, tells in ((9, True), (30, False)):
        gaps = [with_light(trail, np.arange(200) >= n_dark) for trail in train]
        assert math.isfinite(sharpest_light_px(gaps, [True] * len(gaps))) == tells
    part = 0.99 * LONGEST_PARTICLE_PX / train[0].length_px
    for others in (
        [replace(trail, row1=trail.row0 + 300.0 * part, col1=565.0 * part) for trail in train],
        [replace(trail, row1=trail.row0) for trail in train],
        [replace(trail, snr=40.0) for trail in train],
    ):
        assert math.isinf(sharpest_light_px(others, [True] * len(others)))


def test_a_band_of_cloud_does_not_tell_how_sharp_the_optics_are(fits: dict[str, list[StreakFit]]) -> None:
    """Satellites of S/N 109 to 209 and 0.7 to 0.9 px beside bands of 4 to 5 px, all refused, had p below 0.04 for that alone.
    Tracks of particles beside a trail are as narrow, and the trail tells."""
    trail = replace(train_of_satellites(fits["real"][0])[0], width_px=0.8, row1=120.0, col1=140.0)
    band = replace(train_of_satellites(fits["real"][0])[1], width_px=4.2, snr=64.0)
    assert np.isnan(sharpness_of([trail, band], None, sharpest_light_px([trail, band], [True, False]))).all()
    narrow = 0.5 * math.log((0.8**2 + 1.0 / 12.0) / (4.2**2 + 1.0 / 12.0))
    sharpest = sharpest_light_px([trail, band], [True, True])
    assert sharpness_of([trail, band], None, sharpest) == pytest.approx([narrow, 0.0])


def test_bands_of_an_aurora_do_not_tell_beside_a_line_as_wide_as_stars(fits: dict[str, list[StreakFit]]) -> None:
    """Two bands of 10 and 12 px, likely trails by all but their width, told the optics beside a satellite of 1.0 px and S/N 730.
    Where all lines are wide they tell: satellites out of focus were 6 to 14 px wide."""
    train = train_of_satellites(fits["real"][0])
    trail, *bands = [replace(each, width_px=width) for each, width in zip(train, (1.0, 9.7, 12.4), strict=False)]
    assert sharpest_light_px([*bands, trail], [True] * 3) == 1.0
    assert sharpest_light_px(bands, [True] * 2) == pytest.approx(0.5 * (9.7 + 12.4))


def test_a_train_of_satellites_does_not_recur_and_short_sharp_tracks_do(
    fits: dict[str, list[StreakFit]], frame: DownlinkFrame
) -> None:
    """Ten trails of one picture, an eighth as wide as its stars: nine were not sent, and the tenth had p 0.04."""
    vetter, train = LikelihoodVetter(model_error=0.2), train_of_satellites(fits["real"][0])
    wide = replace(frame, psf_sigma_px=3.0)
    train = [replace(trail, psf_sigma_px=3.0) for trail in train]
    assert vetter.probability(train, wide).min() > 0.9
    tracks = [with_light(replace(trail, row1=trail.row0 + 60.0, col1=113.0), np.ones(40)) for trail in train]
    assert vetter.probability(tracks, wide).max() < 0.5


def test_trails_that_drift_across_columns_are_not_refused_for_their_direction(
    fits: dict[str, list[StreakFit]], frame: DownlinkFrame
) -> None:
    """Four satellites 0.1 to 0.4 deg from the columns, S/N 460 to 530 and 807 px long, had p 0.03 to 0.04."""
    vetter = LikelihoodVetter(model_error=0.2)
    one = outside_fit(fits["real"][0], (-0.5, 59.5, 806.5, 55.5), width_px=0.5, snr=480.0, chi2_nu=3.4)
    one = with_light(replace(one, sagitta_px=0.0, flags=StreakFlag.EDGE0 | StreakFlag.EDGE1), np.ones(200))
    drifting = [replace(one, col0=one.col0 + 60.0 * k, col1=one.col1 + 60.0 * k) for k in range(3)]
    assert vetter.probability(drifting, frame).min() > 0.9
    still = [replace(each, col1=each.col0 + 0.1) for each in drifting]
    assert vetter.probability(still, frame).max() < 0.05


def test_a_meteor_across_rows_and_columns_is_no_hot_line(fits: dict[str, list[StreakFit]], frame: DownlinkFrame) -> None:
    """Meteors of S/N 24 to 44 and 37 to 56 px in a plane of maxima, 0.4 to 0.8 px wide where nobody knows it, and uneven, had p
    0.04 to 0.24. A hot line is as narrow and as uneven, and follows a row or column."""
    vetter, unknown = LikelihoodVetter(model_error=0.2), replace(frame, psf_sigma_px=None)
    one = outside_fit(fits["real"][0], (548.0, 562.0, 594.0, 583.0), width_px=0.5, snr=30.0, chi2_nu=1.9)
    one = with_light(replace(one, n_pixels=600, sagitta_px=0.0, flags=StreakFlag(0)), np.array([0.5, 1.3, 1.5, 1.1, 0.9, 0.3]))
    many = [replace(one, row0=one.row0 + 40.0 * k, row1=one.row1 + 40.0 * k) for k in range(8)]
    assert vetter.probability(many, unknown).min() > 0.5
    assert vetter.probability([replace(each, col1=each.col0 + 0.3) for each in many], unknown).max() < 0.1


def test_lines_that_no_optics_made_are_meteors_of_a_sharpened_picture_or_tracks_by_their_lengths(
    fits: dict[str, list[StreakFit]], frame: DownlinkFrame
) -> None:
    """Six meteors of two pictures that were made smaller, 0.05 to 0.3 px wide, 28 to 84 px long, had p of zero. A detector has
    many short tracks where it has a long one, and columns are as narrow."""
    vetter, unknown = LikelihoodVetter(model_error=0.2), replace(frame, psf_sigma_px=None)
    one = outside_fit(fits["real"][0], (142.0, 215.0, 180.0, 275.0), width_px=0.2, snr=90.0, chi2_nu=2.6)
    one = with_light(replace(one, n_pixels=600, sagitta_px=0.0, flags=StreakFlag(0)), np.ones(12))
    other = replace(one, row0=40.0, row1=90.0)
    assert vetter.probability([one, other], unknown).min() > 0.5
    lengths = np.geomspace(15.0, 45.0, 40)
    tracks = [replace(one, row1=one.row0 + 0.5 * length, col1=one.col0 + 0.87 * length) for length in lengths]
    assert vetter.probability([one, *tracks], unknown).max() < 0.5
    assert vetter.probability([replace(one, row1=one.row0 + 0.3), other], unknown)[0] == 0.0, "a column"
    assert vetter.probability([replace(one, snr=15.0), other], unknown)[0] == 0.0


def test_a_full_trail_that_aims_at_its_own_light_is_no_spike(fits: dict[str, list[StreakFit]], frame: DownlinkFrame) -> None:
    """On board its full pixels are listed as full stars. In frames from outside stars that outshine a line speak against it."""
    bright = replace(max(fits["real"], key=lambda fit: fit.snr), flags=StreakFlag.SATURATED)
    spike = replace(bright, flags=bright.flags | StreakFlag.SPIKE_LIKE)
    outside, orbit = LikelihoodVetter(model_error=0.2), LikelihoodVetter()
    assert outside.probability([spike], frame)[0] == outside.probability([bright], frame)[0]
    assert orbit.probability([spike], frame)[0] < orbit.probability([bright], frame)[0]


def test_what_stays_on_a_column_is_of_the_readout(fits: dict[str, list[StreakFit]], frame: DownlinkFrame) -> None:
    """Only without calibration, whole columns and parts of them, and not what leaves its column by more than the fit's error."""
    rows = frame.header.rows
    vetter, calibrated = LikelihoodVetter(model_error=0.2), LikelihoodVetter()
    column = outside_fit(fits["real"][0], (-0.5, 40.0, rows - 0.5, 40.4), width_px=1.5, snr=190.0, chi2_nu=1.0)
    assert vetter.probability([column], frame)[0] < 0.05
    assert vetter.probability([replace(column, row1=0.1 * rows)], frame)[0] < 0.3
    assert calibrated.probability([column], frame)[0] > 0.0
    free, drifts = (vetter.probability([replace(column, col1=col)], frame)[0] for col in (900.0, 44.0))
    assert free > 0.9
    assert drifts > 0.75


def test_a_wide_trail_that_drifts_across_rows_is_no_line_of_the_readout(fits: dict[str, list[StreakFit]]) -> None:
    """Frame 0064 of a field of the galactic bulge: 506 px long, 12.2 +- 0.28 px across the rows, sigma 5.5 px where stars have
    2.3, chi square 9.5 of the stars that it crosses. It was refused for staying within 2.5 of its widths over most of the
    frame."""
    trail = replace(
        outside_fit(fits["real"][0], (321.0, -0.6, 333.2, 504.8), width_px=5.47, snr=267.0, chi2_nu=9.5),
        flags=StreakFlag.EDGE0 | StreakFlag.DEFOCUSED,
        psf_sigma_px=2.26,
        covariance_px2=np.diag([0.04, 1.0, 0.04, 1.0]),
        n_pixels=20_000,
    )
    assert odds_of_readout([trail])[0] < 1e-3
