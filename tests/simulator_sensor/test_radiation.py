"""Particles: numbers, directions, straggling, charge in pixels, edges, determinism, and where the environment is."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from simulator.radiation import ParticleField, RadiationOptions
from simulator.radiation.belts import GeodeticPosition, trapped
from simulator.radiation.energy_loss import SILICON, most_probable_loss_kev, stopping_power_mev_cm2_g
from simulator.radiation.straggling import draw_loss_kev, landau_table
from simulator.radiation.tracks import deposit
from simulator.sensor import Sensor, SensorOptions
from simulator.sensor.options import ConverterOptions

THROUGH = (np.zeros(1), np.ones(1))
"""Depths of a track from the face of the electrodes to the far one."""
LARGE = {"rows": 4096, "cols": 4096, "pitch_um": 9.0, "seed": 3}


def counts(environment, frames=40, **changes):
    field = ParticleField(RadiationOptions(environment=environment, **changes), **LARGE)
    return np.array([len(field.hits(k, 0.2, None).tracks) for k in range(frames)])


@pytest.mark.parametrize(("environment", "expected"), [("quiet", 3.3), ("polar", 9.8)])
def test_numbers_are_poisson_about_rate_times_area_times_time(environment, expected):
    n = counts(environment, frames=400)
    # 1.2 /cm2/s (polar: three times) x 13.59 cm2 x 0.2 s; a few longest tracks reach in from outside.
    assert n.mean() == pytest.approx(expected, abs=4.0 * math.sqrt(expected / 400))
    assert n.var() == pytest.approx(expected, rel=0.3)


def test_the_peak_of_the_anomaly_fills_a_frame_with_thousands():
    n = counts("saa", frames=3)
    # 3,750 /cm2/s omnidirectional, half of it through a plane, x 13.59 cm2 x 0.2 s = 5,097, and a shield near 50 MeV.
    assert 4700 < n.mean() < 5600
    assert counts("saa", frames=1, shield_mm=60.0)[0] < 0.6 * n.mean()


def test_every_frame_has_new_hits_and_the_same_seed_the_same():
    field = ParticleField(RadiationOptions(environment="polar"), **LARGE)
    first, again, other = field.hits(0, 0.2, None), field.hits(0, 0.2, None), field.hits(1, 0.2, None)
    assert first.charge_e.tobytes() == again.charge_e.tobytes()
    assert first.tracks.tobytes() != other.tracks.tobytes()


def test_switched_off_there_are_no_hits():
    hits = ParticleField(RadiationOptions(enabled=False, environment="saa"), **LARGE).hits(0, 0.2, None)
    assert hits.row.size == 0
    assert len(hits.tracks) == 0


def test_directions_through_a_plane_are_cosine_weighted():
    field = ParticleField(RadiationOptions(environment="saa", straggling=False, electron_factor=0.0), **LARGE)
    tracks = field.hits(0, 0.4, None).tracks
    sideways_um = np.hypot(tracks["row1"] - tracks["row0"], tracks["col1"] - tracks["col0"]).astype(float) * 9.0
    cosine = 10.0 / np.hypot(10.0, sideways_um)
    # An isotropic flux crosses a plane with density 2 cos(theta) d cos(theta): cos^2 is uniform.
    assert stats.kstest(cosine[cosine > 0.05] ** 2, stats.uniform(0.0025, 0.9975).cdf).pvalue > 1e-3
    azimuth = np.arctan2(tracks["row1"] - tracks["row0"], tracks["col1"] - tracks["col0"]).astype(float)
    assert stats.kstest(azimuth, stats.uniform(-math.pi, 2.0 * math.pi).cdf).pvalue > 1e-3


def test_straggling_is_landau_where_binding_does_not_matter():
    n = 60_000
    rng = np.random.default_rng(8)
    energy, path = np.full(n, 3000.0), np.full(n, 1000.0)
    unbound = replace(SILICON, shells_kev=())
    loss = draw_loss_kev(rng, energy, path, np.ones(n), unbound, landau_table())
    mode = float(most_probable_loss_kev(3000.0, 1000.0, unbound))
    xi = 1e3 * 0.5 * 0.307075 * unbound.z_over_a * 2.329 * 0.1 / (1.0 - (1.0 + 3000.0 / 938.27209) ** -2)
    below = mode + 20.0 * xi  # the far tail is cut to keep the mean
    reference = stats.landau(loc=mode + 0.22278298 * xi, scale=xi)
    sample = loss[loss < below]
    p = stats.kstest(sample, lambda x: reference.cdf(x) / reference.cdf(below)).pvalue
    assert p > 1e-3


@pytest.mark.parametrize(
    ("energy_mev_u", "charge", "path_um"),
    [(3000.0, 1, 300.0), (534.0, 1, 10.0), (60.0, 1, 40.0), (60.0, 1, 400.0), (800.0, 8, 20.0), (500.0, 26, 10.0)],
)
def test_the_mean_loss_is_bethes_whatever_the_regime(energy_mev_u, charge, path_um):
    n = 400_000
    unbound = replace(SILICON, shells_kev=())
    full = np.ones(n)
    loss = draw_loss_kev(np.random.default_rng(4), energy_mev_u * full, path_um * full, charge * full, unbound, landau_table())
    bethe = 0.1 * float(stopping_power_mev_cm2_g(energy_mev_u, unbound, charge)) * 2.329 * path_um
    assert loss.mean() == pytest.approx(bethe, rel=0.02)


def test_thin_layers_are_wider_than_landau_and_never_negative():
    n = 40_000
    losses = [
        draw_loss_kev(np.random.default_rng(2), np.full(n, 534.0), np.full(n, 10.0), np.ones(n), m, landau_table())
        for m in (SILICON, replace(SILICON, shells_kev=()))
    ]
    spread = [np.subtract(*np.percentile(x, [84, 16])) for x in losses]
    assert spread[0] > 1.2 * spread[1]
    assert losses[0].min() > 0.0
    # Pure Landau of a 534 MeV proton in 10 um: median 824 e-, 68 % between 715 and 1137 e-.
    assert np.percentile(losses[1], [16, 50, 84]) / 3.65e-3 == pytest.approx([715.0, 824.0, 1137.0], rel=0.01)


def test_without_straggling_the_charge_is_bethe_times_path():
    field = ParticleField(RadiationOptions(environment="quiet", straggling=False, shield_mm=0.0), **LARGE)
    tracks = np.concatenate([field.hits(k, 20.0, None).tracks for k in range(4)])
    inside = (tracks["row0"] > 50) & (tracks["row0"] < 4000) & (tracks["col0"] > 50) & (tracks["col0"] < 4000)
    t = tracks[inside]
    path_um = np.hypot(10.0, 9.0 * np.hypot(t["row1"] - t["row0"], t["col1"] - t["col0"]))
    per_um = np.median(t["charge_e"] / path_um)
    # Fast protons and helium near minimum ionisation: 107 e-/um for a minimum-ionising particle and up to 25 % more.
    assert 105.0 < per_um < 140.0
    minimum = float(stopping_power_mev_cm2_g(2500.0, SILICON)) * 2.329 * 0.1 / 3.65e-3
    assert minimum == pytest.approx(107.0, rel=0.01)


def test_charge_is_split_by_path_length_without_diffusion():
    # From (10.25, 10.0) to (10.25, 14.0): half a pixel, three whole ones, half a pixel.
    ends = (np.array([10.25]), np.array([10.0]), np.array([10.25]), np.array([14.0]))
    row, col, charge, inside = deposit(*ends, *THROUGH, np.array([800.0]), 0.0, 32, 32, 100)
    assert np.all(row == 10)
    assert dict(zip(col.tolist(), charge.tolist(), strict=True)) == pytest.approx(
        {10: 100.0, 11: 200.0, 12: 200.0, 13: 200.0, 14: 100.0}
    )
    assert inside[0] == pytest.approx(800.0)


@pytest.mark.parametrize("spread_px", [0.0, 0.3])
def test_tracks_are_clipped_at_every_edge(spread_px):
    ends = np.array([[-4.0, 5.0, 3.0, 5.0], [5.0, -4.0, 5.0, 3.0], [28.0, 5.0, 35.0, 5.0], [5.0, 28.0, 5.0, 35.0]])
    row, col, charge, inside = deposit(*ends.T.copy(), np.zeros(4), np.ones(4), np.full(4, 700.0), spread_px, 32, 32, 20000)
    assert row.min() >= 0
    assert col.min() >= 0
    assert row.max() <= 31
    assert col.max() <= 31
    # 3.5 of 7 px lie inside (pixel 0 begins at -0.5, pixel 31 ends at 31.5).
    assert inside == pytest.approx(np.full(4, 350.0), abs=1.0 if spread_px == 0.0 else 30.0)
    far = (row > 8) & (row < 26) | (col > 8) & (col < 26)
    assert charge[far].sum() == pytest.approx(0.0, abs=1e-6)


def test_diffusion_spreads_charge_and_keeps_it():
    moments = []
    for start in np.linspace(16.0, 17.0, 50, endpoint=False):
        ends = (np.array([start]), np.array([16.2]), np.array([start]), np.array([18.2]))
        row, _, charge, inside = deposit(*ends, *THROUGH, np.array([1000.0]), 0.5, 32, 32, 5000)
        assert inside[0] == pytest.approx(1000.0, rel=2e-3)
        moments.append(float((charge * (row - start) ** 2).sum() / charge.sum()))
    # Charge made evenly in depth: the mean over depth of the spread's variance is half of 0.5^2; the pixel adds 1/12.
    assert np.mean(moments) == pytest.approx(0.5 * 0.25 + 1.0 / 12.0, rel=0.02)


def test_the_position_along_the_orbit_decides():
    field = ParticleField(RadiationOptions(environment="orbit"), **LARGE)
    assert field.fluxes((-28.0, -52.0, 700.0)).proton_cm2_s > 1400.0
    quiet = field.fluxes((0.0, 100.0, 700.0))
    assert (quiet.proton_cm2_s, quiet.electron_cm2_s) == (0.0, 0.0)
    assert quiet.cosmic_cm2_s == pytest.approx(1.2, rel=0.05)
    polar = field.fluxes((80.0, -70.0, 700.0))
    assert polar.cosmic_cm2_s == pytest.approx(3.6, rel=0.02)
    assert quiet.cosmic_cm2_s < field.fluxes((-28.0, -52.0, 700.0)).cosmic_cm2_s < polar.cosmic_cm2_s


def test_the_belts_are_closed_in_longitude_and_drift_west():
    peak = trapped("proton", GeodeticPosition(-30.0, -48.0, 780.0)).above(50.0)
    west = trapped("proton", GeodeticPosition(-30.0, -51.0, 780.0), 2025.0, 0.3).above(50.0)
    assert west == pytest.approx(peak, rel=1e-9)
    seam = [trapped("proton", GeodeticPosition(-20.0, lon, 1400.0)).above(10.0) for lon in (179.99, -179.99)]
    assert seam[0] == pytest.approx(seam[1], rel=1e-2, abs=0.1)


def test_on_the_ground_there_is_one_muon_per_minute_and_cm2():
    field = ParticleField(RadiationOptions(environment="orbit"), **LARGE)
    there = field.fluxes(None)
    assert (there.cosmic_cm2_s * 60.0, there.proton_cm2_s, there.electron_cm2_s) == (1.0, 0.0, 0.0)
    # beta gamma = rigidity / proton mass = 38, that of muons of 4 GeV.
    assert there.cutoff_gv / 0.93827 == pytest.approx(math.sqrt((1.0 + 4.0 / 0.10566) ** 2 - 1.0), rel=0.02)


def test_charge_of_hits_arrives_in_the_frame_where_the_truth_says():
    field = ParticleField(RadiationOptions(environment="saa"), rows=256, cols=256, pitch_um=9.0, seed=3)
    hits = field.hits(5, 0.5, None)
    linear = SensorOptions(converter=ConverterOptions(nonlinearity=0.0, dual_gain=False, bits=16, full_well_e=1e7))
    dark = np.zeros((256, 256), dtype=np.float32)
    sensor = Sensor(linear, rows=256, cols=256, seed=1)
    excess_e = 1.2 * (sensor.digitise(dark, 5, 0.5, hits).astype(float) - sensor.digitise(dark, 5, 0.5))
    assert excess_e.sum() == pytest.approx(float(hits.charge_e.sum()), rel=1e-3)
    assert float(hits.charge_e.sum()) == pytest.approx(float(hits.tracks["charge_e"].sum()), rel=1e-4)
    brightest = hits.tracks[np.argmax(hits.tracks["charge_e"])]
    row, col = (round(0.5 * float(brightest[f"{axis}0"] + brightest[f"{axis}1"])) for axis in ("row", "col"))
    assert excess_e[max(row - 2, 0) : row + 3, max(col - 2, 0) : col + 3].max() > 200.0
