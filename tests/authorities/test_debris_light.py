"""Light of debris against closed forms: mirror-like spheres, scattered albedos, colours, facets; each with its switch."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from sboc_e2e.icd.errors import UserError
from simulator.optics.instrument import InstrumentOptions
from simulator.platform.earth import AU_KM
from simulator.scene import alternatives
from simulator.scene.debris import SizeClass
from simulator.scene.encounters import PopulationOptions, draw_candidates
from simulator.scene.reflection import SUN_V_MAG, LightCurve, lambert_flux
from simulator.scene.satellites import read_satellites, size_by_name, with_sizes
from simulator.scene.sources import light_curves
from simulator.scene.surface import SurfaceOptions, draw_surfaces
from tests.simulator_scene.test_physics import default_window

GREY = SurfaceOptions(
    albedo_scatter=0.0, specular_share=0.0, reddening_mag=0.0, colour_scatter_mag=0.0, facet_share=0.0, glint_share=0.0
)


def flux(phase_deg, specular):
    angle = np.radians(phase_deg)
    sun = AU_KM * np.array([np.cos(angle), np.sin(angle), 0.0])
    return float(lambert_flux(1.0, 0.1, np.zeros((1, 3)), np.array([[1000.0, 0.0, 0.0]]), sun, specular=specular)[0])


@pytest.mark.parametrize("phase_deg", [0.0, 60.0, 120.0])
def test_a_mirror_like_sphere_shines_alike_in_all_directions(phase_deg):
    # a (d/2)^2 / 4 R^2 of the Sun's flux (e.g. Williams & McCue 1966).
    expected = 10.0 ** (-0.4 * SUN_V_MAG) * 0.1 * 0.25 / 4.0 / 1e6**2
    assert flux(phase_deg, 1.0) == pytest.approx(expected, rel=1e-4)
    assert flux(phase_deg, 0.4) == pytest.approx(0.6 * flux(phase_deg, 0.0) + 0.4 * expected, rel=1e-4)


def test_both_kinds_of_sphere_return_the_same_light_in_all():
    phase = np.radians(np.arange(0.5, 180.0))
    weight = np.sin(phase)
    totals = [sum(w * flux(np.degrees(p), s) for p, w in zip(phase, weight, strict=True)) for s in (0.0, 1.0)]
    assert totals[0] == pytest.approx(totals[1], rel=1e-3)


def test_albedos_scatter_log_normally_about_their_median_and_each_part_has_a_switch():
    camera = InstrumentOptions().colour_factor
    drawn = draw_surfaces(np.random.default_rng(1), 20_000, 0.1, SurfaceOptions(), camera)
    assert np.median(drawn.albedo) == pytest.approx(0.1, rel=0.02)
    assert np.std(np.log(drawn.albedo)) == pytest.approx(0.5, rel=0.02)
    assert drawn.specular.mean() == pytest.approx(0.25, rel=0.02)
    assert drawn.colour.mean() > 1.03  # redder than the Sun, a camera of 420 to 850 nm gets more for the same V
    for switch, name in (("albedo_scatter", "albedo"), ("specular_share", "specular"), ("reddening_mag", "colour")):
        off = replace(GREY, **{k: 0.3 for k in SurfaceOptions.__dataclass_fields__ if k.startswith(("albedo", "spec", "redd"))})
        off = replace(off, **{switch: 0.0})
        values = getattr(draw_surfaces(np.random.default_rng(1), 100, 0.1, off, camera), name)
        assert np.ptp(values) < 1e-12, switch
        others = {"albedo", "specular", "colour"} - {name}
        assert all(np.any(getattr(draw_surfaces(np.random.default_rng(1), 9, 0.1, off, camera), o) != 1.0) for o in others)


def test_a_facetted_body_has_two_maxima_in_a_turn_and_its_mean_is_exact():
    curve = LightCurve(period_s=2.0, amplitude=0.5, facets=0.8, facet_phase_rad=0.7, glint_factor=5.0, glint_width_s=0.01)
    smooth = replace(curve, glint_factor=0.0)
    times = np.linspace(0.0, 2.0, 20_001)
    light = smooth.factor(times)
    rising = np.diff(light) > 0.0
    assert np.count_nonzero(rising[:-1] & ~rising[1:]) == 2
    edges = np.array([0.1, 0.35, 1.2])
    for start, end in pairwise(edges):
        fine = curve.factor(np.linspace(start, end, 200_001)).mean()
        assert curve.mean_factor(np.array([start]), np.array([end]))[0] == pytest.approx(fine, rel=1e-4)


def test_shares_of_tumbling_facetted_and_flashing_pieces_are_those_of_the_options():
    options = PopulationOptions(tumbling_share=0.5)
    curves = light_curves(np.random.default_rng(4), 20_000, options)
    tumbling = [c for c in curves if c.amplitude > 0.0]
    assert len(tumbling) / 20_000 == pytest.approx(0.5, abs=0.03)
    assert np.mean([c.facets > 0.0 for c in tumbling]) == pytest.approx(0.5, abs=0.04)
    assert np.mean([c.glint_factor > 0.0 for c in tumbling]) == pytest.approx(0.2, abs=0.03)
    assert np.median([c.glint_factor for c in tumbling if c.glint_factor > 0.0]) == pytest.approx(5.0, rel=0.1)
    plain = light_curves(np.random.default_rng(3), 500, replace(options, surface=GREY))
    assert all(c.facets == 0.0 and c.glint_factor == 0.0 for c in plain)


def test_what_is_drawn_is_as_bright_as_its_surface():
    one = SizeClass(from_mm=10.0, to_mm=100.0)
    grey, coloured = (
        draw_candidates(PopulationOptions(surface=s, candidates=20_000), one, default_window(), np.random.default_rng(2))
        for s in (GREY, SurfaceOptions())
    )
    assert np.ptp(grey.surfaces.albedo) == 0.0
    assert np.array_equal(grey.size_m, coloured.size_m)  # surfaces have random numbers of their own
    seen = coloured.natural[coloured.snr > 8.0].sum() / grey.natural[grey.snr > 8.0].sum()
    assert 0.7 < seen < 1.6


@pytest.mark.parametrize(("from_mm", "to_mm"), [(1.0, 3.0), (100.0, 3000.0)])
def test_models_leave_an_interval_that_holds_the_albedo_of_0_175(from_mm, to_mm):
    one, options = SizeClass(from_mm=from_mm, to_mm=to_mm), PopulationOptions()
    nominal = alternatives.seen_per_day(options, one, default_window(), 0)
    brighter = alternatives.seen_per_day(replace(options, albedo=0.175), one, default_window(), 0)
    assert nominal.low < 0.8
    assert nominal.high > 1.2
    assert nominal.per_day < brighter.per_day < nominal.high * nominal.per_day


def test_satellites_take_their_sizes_from_a_file(tmp_path):
    lines = read_satellites("scenarios/data/made_up.3le")
    number = int(lines[0].record.satnum)
    path = tmp_path / "sizes.csv"
    path.write_text(f"ObjectID,HBR\n{number},1.5\n{number + 1000},\n")
    sized = with_sizes(lines, path)
    assert sized[0].size_m == 3.0
    assert sized[1].size_m is None
    path.write_text("a,b\n1,2\n")
    with pytest.raises(UserError, match="columns ObjectID and HBR"):
        with_sizes(lines, path)
    path.write_text("ObjectID,HBR\n1,wide\n")
    with pytest.raises(UserError, match="line 2: not a number"):
        with_sizes(lines, path)
    with pytest.raises(UserError, match="no such file"):
        with_sizes(lines, tmp_path / "none.csv")


@pytest.mark.parametrize(
    ("name", "size_m"),
    [("COSMOS 2251 DEB", 0.14), ("IRIDIUM 33 DEB", 0.14), ("SL-16 R/B", 4.0), ("STARLINK-1007", 2.2), ("DEBUT (OSCAR 30)", None)],
)
def test_names_tell_sizes(name, size_m):
    assert size_by_name(name) == size_m


def test_real_radii_can_be_read(shared_data):
    satellites = read_satellites(shared_data / "tle" / "catalogue_2022-01.3le.gz")
    sized = with_sizes(satellites, shared_data / "orbits" / "hbr_mass_2026-06-01.csv.gz")
    known = np.array([s.size_m for s in sized if s.size_m])
    assert len(known) > 8000
    assert 0.05 < np.median(known) < 1.0
