"""Mean light of tracklets against simulated light curves: what tumbles, what is steady, what the arc is too short for."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest

from ground.orbit.size import diameter_m, magnitude_draws
from ground.photometry.magnitude import mean_magnitude
from ground.photometry.tracklet_light import (
    PERIODS_S,
    SCALES,
    SHARED_ERROR_MAG,
    Samples,
    TrackletLight,
    mean_light,
    with_mean_light,
)
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import StreakFit, StreakMeasurement, Tracklet

FRAME_S, EXPOSURE_S = 0.25, 0.2
MAG = 12.0
POGSON = 2.5 / np.log(10.0)


@dataclass(frozen=True, kw_only=True)
class Curve:
    """1 + amplitude sin(2 pi t / period + phase), with a second harmonic of a share of it: the mean is 1."""

    amplitude: float = 0.0
    period_s: float = 2.0
    phase: float = 0.0
    second: float = 0.0

    def mean(self, start_s: float, stop_s: float) -> float:
        """Mean between two times by the closed form of the integral."""
        out = 1.0
        for order, share in ((1, 1.0), (2, self.second)):
            w = 2.0 * np.pi * order / self.period_s
            edge = [-np.cos(w * t + order * self.phase) / w for t in (start_s, stop_s)]
            out += self.amplitude * share * (edge[1] - edge[0]) / (stop_s - start_s)
        return out


def samples(curve: Curve, n: int, sigma: float, rng: np.random.Generator) -> Samples:
    """Magnitudes of n exposures of an object of mean `MAG`; sigma : noise of the light, relative to its mean."""
    t = FRAME_S * np.arange(n)
    light = np.array([curve.mean(at - 0.5 * EXPOSURE_S, at + 0.5 * EXPOSURE_S) for at in t]) + rng.normal(0.0, sigma, n)
    light = np.maximum(light, 0.02) * 10.0 ** (-0.4 * rng.normal(0.0, SHARED_ERROR_MAG))
    mag, error = MAG - 2.5 * np.log10(light), POGSON * sigma / light
    return Samples.of_magnitudes(t_s=t, duration_s=np.full(n, EXPOSURE_S), mag=mag, mag_err=error, snr=np.full(n, np.nan))


def tumbler(rng: np.random.Generator, second: float = 0.0) -> Curve:
    """Log-normal periods around 2 s, amplitudes of 0.1 to 0.7."""
    return Curve(
        amplitude=rng.uniform(0.1, 0.7),
        period_s=rng.lognormal(np.log(2.0), 1.0),
        phase=rng.uniform(0.0, 2.0 * np.pi),
        second=second,
    )


def pull(z: np.ndarray) -> float:
    """Width of pulls by their median square."""
    return float(np.sqrt(np.median(z**2) / 0.4549))


def test_the_mean_of_a_tumbler_has_the_error_of_its_light_curve() -> None:
    """Twenty-four exposures of 1 % of light that varies by a factor of three: their noise says 0.002 mag, 10 sigma off."""
    rng = np.random.default_rng(3)
    curve = Curve(amplitude=0.5, period_s=1.7, phase=0.4)
    light, given = [], samples(curve, 24, 0.01, rng)
    each = given.reference_mag - 2.5 * np.log10(given.light)
    mag, mag_err = mean_magnitude(each, POGSON * given.light_err / given.light)
    assert abs(mag - MAG) > 10.0 * mag_err
    for _ in range(20):
        light.append(mean_light(samples(replace(curve, phase=rng.uniform(0.0, 6.28)), 24, 0.01, rng), 0.5))
    z = np.array([(one.mag - MAG) / one.mag_err for one in light])
    assert np.sqrt(np.mean(z**2)) < 1.5
    assert max(one.mag_err for one in light) < 0.03
    # the scatter of a sinusoid is its amplitude over the root of two, and constant light does not fit
    assert all(abs(one.scatter_mag - POGSON * 0.5 / np.sqrt(2.0)) < 0.03 for one in light)
    assert min(one.chi2_nu for one in light) > 100.0


@pytest.mark.parametrize(("share", "second"), [(0.3, 0.0), (0.3, 0.4), (0.6, 0.0)])
@pytest.mark.slow
def test_pulls_with_tumblers_in(share: float, second: float) -> None:
    """800 tracklets of 4 to 24 members: the pull scatters by 0.03, the coverage of 90 % by 0.011."""
    rng = np.random.default_rng(17)
    z, inside = [], []
    for _ in range(800):
        curve = tumbler(rng, second) if rng.random() < share else Curve()
        one = mean_light(samples(curve, int(rng.integers(4, 25)), float(rng.choice([0.01, 0.03, 0.1])), rng), 1.0)
        z.append((one.mag - MAG) / one.mag_err)
        inside.append(one.mag_low <= MAG <= one.mag_high)
    assert 0.85 < pull(np.array(z)) < 1.1
    assert 0.86 < np.mean(inside) < 0.97


def found_above(half_point_snr: float, curve: Curve, snr: float, rng: np.random.Generator) -> Samples | None:
    """Those of 12 exposures of a mean S/N whose light with its noise passes a soft threshold; None for fewer than three."""
    all_of_them = samples(curve, 12, 1.0 / snr, rng)
    seen = all_of_them.light / all_of_them.light_err
    found = seen > half_point_snr + rng.normal(0.0, 0.6, len(seen))
    if found.sum() < 3:
        return None
    values = {k: getattr(all_of_them, k)[found] for k in ("t_s", "duration_s", "light", "light_err")}
    return Samples(**values, snr=seen[found], reference_mag=all_of_them.reference_mag)


@pytest.mark.parametrize("tumbling", [0.0, 0.3])
@pytest.mark.slow
def test_faint_exposures_are_found_because_they_are_bright(tumbling: float) -> None:
    """Objects of S/N 5.5 to 8 an exposure, of which those above 7.2 come down: as they stand these are 0.1 mag too bright."""
    rng = np.random.default_rng(23)
    z, before = [], []
    while len(z) < 300:
        curve = tumbler(rng) if rng.random() < tumbling else Curve()
        found = found_above(7.2, curve, float(rng.uniform(5.5, 8.0)), rng)
        if found is not None:
            one, plain = mean_light(found, 0.5, 7.2), mean_light(replace(found, snr=np.full(len(found.snr), np.nan)), 0.5)
            z.append((one.mag - MAG) / one.mag_err)
            before.append(plain.mag - MAG)
    assert np.median(before) < -0.07
    # 1.7 sigma (steady) and 1.9 (tumblers in) without; of a tumbler the phases in which it was not found stay unknown
    assert abs(np.median(z)) < (0.6 if tumbling else 0.35)
    # 2.7 and 3.1 without
    assert 0.85 < pull(np.array(z)) < (1.5 if tumbling else 1.15)


def test_one_and_two_members_keep_what_they_cannot_see_in_the_interval() -> None:
    """Nine tenths of all objects, tumbling ones among them, lie within the 90 % interval of one or two exposures."""
    rng = np.random.default_rng(5)
    for n in (1, 2):
        light = [mean_light(samples(tumbler(rng) if k % 10 < 3 else Curve(), n, 0.02, rng), 1.0) for k in range(600)]
        assert 0.84 < np.mean([one.mag_low <= MAG <= one.mag_high for one in light]) < 0.96
        assert all(np.isnan(one.chi2_nu) for one in light) == (n == 1)


def test_light_along_one_trail_tells_that_an_object_tumbles() -> None:
    """A fast tumbler in one frame: the bins of its trail show the scatter that a single magnitude hides."""
    bins, rng = 40, np.random.default_rng(1)
    curve = Curve(amplitude=0.6, period_s=0.08)
    edges = np.linspace(0.0, EXPOSURE_S, bins + 1)
    density = 100.0 * np.array([curve.mean(a, b) for a, b in pairwise(edges)]) + rng.normal(0.0, 5.0, bins)
    resolved = StreakFlag.DIRECTION_RESOLVED
    seen = MAG - 2.5 * np.log10(curve.mean(0.0, EXPOSURE_S))  # two and a half turns: not the mean of the curve
    varying = replace(member(density, 5.0, resolved | StreakFlag.VARIABLE), mag=seen)
    plain = member(np.zeros(0), 0.0, resolved)
    found, blind = (with_mean_light(tracklet(), [one]) for one in (varying, plain))
    assert abs(found.mag_scatter - POGSON * 0.6 / np.sqrt(2.0)) < 0.12
    assert blind.mag_scatter < 0.2
    assert abs(found.mag - MAG) < 3.0 * found.mag_err


def test_a_tracklet_without_any_magnitude_has_none() -> None:
    none = with_mean_light(tracklet(), [replace(member(np.zeros(0), 0.0, StreakFlag(0)), mag=float("nan"), mag_err=float("nan"))])
    assert np.isnan([none.mag, none.mag_err, none.mag_low, none.mag_high, none.mag_scatter, none.mag_chi2_nu]).all()


def test_sizes_take_both_sides_of_the_magnitude() -> None:
    """5 % and 95 % points of the diameter at known range and albedo are those of the magnitude: d ~ 10^(-0.2 V)."""
    one = replace(tracklet(), mag=12.0, mag_err=0.02, mag_low=11.9, mag_high=12.8)
    normal = np.random.default_rng(2).standard_normal(200_000)
    size = diameter_m(magnitude_draws(one, normal), 100.0, 0.13, 0.1)
    middle = float(diameter_m(12.0, 100.0, 0.13, 0.1))
    assert np.percentile(size, 5.0) == pytest.approx(middle * 10.0 ** (-0.2 * 0.8), rel=0.01)
    assert np.percentile(size, 95.0) == pytest.approx(middle * 10.0 ** (0.2 * 0.1), rel=0.01)
    plain = magnitude_draws(replace(one, mag_low=np.nan, mag_high=np.nan), normal)
    assert float(np.std(plain)) == pytest.approx(0.02, rel=0.01)


def test_points_that_noise_made_negative_count_in_the_mean_of_their_tracklet() -> None:
    """Seven members of S/N 1.2 each, placed by their track: with those below 0 left out, they are 1.3 sigma too bright."""
    rng, z, without = np.random.default_rng(31), [], []
    plain = replace(member(np.zeros(0), 0.0, StreakFlag.POINT_LIKE), frame=0)
    for _ in range(300):
        flux = 120.0 + rng.normal(0.0, 100.0, 7)
        members = [
            replace(
                plain, frame=k, t_tai_ns=plain.t_tai_ns + 250_000_000 * k,
                fit=replace(plain.fit, flux_e=f, flux_err_e=100.0, snr=max(f / 100.0, 0.0), track_frames=32.0),
                mag=MAG - 2.5 * np.log10(f / 120.0) if f > 0.0 else np.nan, mag_err=POGSON * 100.0 / f if f > 0.0 else np.nan,
            )
            for k, f in enumerate(flux)
        ]  # fmt: skip
        one, other = (with_mean_light(tracklet(), chosen) for chosen in (members, [m for m in members if m.fit.flux_e > 0.0]))
        z.append((one.mag - MAG) / one.mag_err)
        without.append((other.mag - MAG) / other.mag_err)
    assert abs(np.median(z)) < 0.25
    assert pull(np.array(z)) < 1.15
    assert np.median(without) < -0.4


@pytest.mark.slow
def test_seven_faint_points_have_the_error_of_objects_of_which_a_third_tumble() -> None:
    """S/N 1.2 to 4.5 each: pulls of steady objects alone are too narrow, those of all are not. They scatter by 4 %."""
    rng, z = np.random.default_rng(32), {0.0: list[float](), 1.0 / 3.0: list[float]()}
    t_s = FRAME_S * np.arange(7)
    for share, pulls in z.items():
        for _ in range(500):
            curve = Curve()
            if rng.random() < share:
                # a cosine and a sine, each of one of the scales
                amplitude = float(rng.choice(SCALES)) * float(np.linalg.norm(rng.standard_normal(2)))
                period_s = float(np.exp(rng.uniform(*np.log(PERIODS_S))))
                curve = Curve(
                    amplitude=amplitude, period_s=period_s, phase=float(rng.uniform(0.0, 2.0 * np.pi)), second=1.0 / 3.0
                )
            noise = 1.0 / float(rng.uniform(1.2, 4.5))
            light = [curve.mean(at, at + EXPOSURE_S) for at in t_s] + rng.normal(0.0, noise, 7)
            known = {"duration_s": np.full(7, EXPOSURE_S), "light_err": np.full(7, noise), "snr": np.full(7, np.nan)}
            one = mean_light(Samples(t_s=t_s, light=light, reference_mag=MAG, **known), 0.01)
            pulls.append((one.mag - MAG) / one.mag_err)
    assert 0.78 < pull(np.array(z[0.0])) < 0.96
    assert 0.9 < pull(np.array(z[1.0 / 3.0])) < 1.1


def test_the_record_is_made_of_plain_numbers() -> None:
    light = mean_light(samples(Curve(), 5, 0.02, np.random.default_rng(0)), 1.0)
    assert isinstance(light, TrackletLight)
    assert all(type(value) is float for value in vars(light).values())


def member(density: np.ndarray, sigma: float, flags: StreakFlag) -> StreakMeasurement:
    """A streak of 0.2 s with a light curve."""
    fit = StreakFit(
        row0=0.0, col0=0.0, row1=0.0, col1=400.0, covariance_px2=np.eye(4), end_interval_px=np.zeros((2, 2)), sigma_cross_px=0.1,
        flux_e=4e4, flux_err_e=400.0, snr=100.0, sagitta_px=0.0, sagitta_err_px=0.1, gradient=0.0, width_px=0.9, width_err_px=0.1,
        chi2_nu=1.0, n_pixels=1000, flags=flags, light_curve_e_px=density.astype(np.float32),
        light_curve_err_e_px=np.full(len(density), sigma, dtype=np.float32),
    )  # fmt: skip
    return StreakMeasurement(
        frame=0, streak_id=0, roi_id=0, fit=fit, row_mid=0.0, col_mid=200.0, ra_deg=np.zeros(3), dec_deg=np.zeros(3),
        t_tai_ns=np.array([0, 100_000_000, 200_000_000]), sigma_along_arcsec=1.0, sigma_cross_arcsec=1.0, mag=MAG, mag_err=0.01,
        probability=1.0, tracklet_id=0, flags=flags,
    )  # fmt: skip


def tracklet() -> Tracklet:
    """A tracklet of one streak without directions."""
    return Tracklet(
        tracklet_id=0, streak_ids=np.zeros(1, np.int64), frames=np.zeros(1, np.int64), t_tai_ns=np.zeros(0, np.int64),
        ra_deg=np.zeros(0), dec_deg=np.zeros(0), sigma_along_arcsec=np.zeros(0), sigma_cross_arcsec=np.zeros(0), t_ref_tai_ns=0,
        ra_ref_deg=0.0, dec_ref_deg=0.0, rate_deg_s=1.0, rate_err_deg_s=0.1, position_angle_deg=0.0, mag=np.nan, mag_err=np.nan,
        chi2_nu=1.0, probability=1.0, direction_resolved=True, flags=StreakFlag(0),
    )  # fmt: skip


def test_three_times_whose_frequencies_meet_by_rounding_have_a_mean() -> None:
    """Half a turn per gap exceeds one turn per arc by the last bit here; the frequency between them had a share of zero."""
    t = np.array([0.006, 0.2, 0.87])
    near = t - t.mean()
    assert 0.5 / np.median(np.diff(near)) > 1.0 / np.ptp(near)
    three = Samples.of_magnitudes(
        t_s=t, duration_s=np.full(3, EXPOSURE_S), mag=np.array([12.0, 12.1, 11.9]), mag_err=np.full(3, 0.05), snr=np.full(3, 20.0)
    )
    assert mean_light(three, 0.5).mag == pytest.approx(12.0, abs=0.1)
