"""The light of glints: trails against an integral of the light curve over time, in steps far shorter than the flash."""

from dataclasses import replace

import numpy as np
import pytest

from sboc_e2e.catalogue import StarCatalogue
from simulator.chain import Simulator
from simulator.options import SimulatorOptions, smoke_options
from simulator.platform.shutter import ShutterOptions
from simulator.radiation.options import RadiationOptions
from simulator.scene.encounters import PopulationOptions
from simulator.scene.light import LightOptions
from simulator.scene.objects import PixelPathObject
from simulator.scene.reflection import LightCurve
from simulator.scene.sky import SkyOptions
from simulator.scene.sources import LightCurveOptions, ObjectOptions, PixelPathOptions
from simulator.scene.stars import StarOptions

EXPOSURE_S = 0.2


def glinting(rate_px_s: float, phase_deg: float, width_s: float, period_s: float) -> SimulatorOptions:
    """One object on an empty field, a flash of a hundred times its mean brightness in each period."""
    base = smoke_options()
    curve = LightCurveOptions(period_s=period_s, amplitude=0.3, phase_deg=phase_deg, glint_factor=100.0, glint_width_s=width_s)
    thing = PixelPathOptions(v_mag=9.0, row_px=200.0, col_px=200.0, col_rate_px_s=rate_px_s, light_curve=curve)
    return replace(
        base,
        frames=1,
        shutter=ShutterOptions(exposure_s=EXPOSURE_S, line_time_us=0.0),
        objects=ObjectOptions(passing=(), pixel_path=(thing,)),
        population=PopulationOptions(classes=()),
        stars=StarOptions(enabled=False),
        sky=SkyOptions(zodiacal=0.0, unresolved=0.0),
        radiation=RadiationOptions(enabled=False),
        light=LightOptions(orbital_aberration=False),
    )


def by_time(simulator: Simulator) -> tuple[float, float]:
    """Electrons and the column of their centroid, from two million instants."""
    thing = simulator._cast.objects[0]
    assert isinstance(thing, PixelPathObject)
    time_s = (np.arange(2_000_000) + 0.5) * (EXPOSURE_S / 2_000_000)
    row, col, flux = thing.place(time_s)
    camera = simulator._camera
    light = flux * thing.light_curve.factor(time_s) * camera.illumination_at(row[::1000], col[::1000]).repeat(1000)
    return float(light.mean() * EXPOSURE_S * camera.zero_point_e_s), float((light * col).sum() / light.sum())


@pytest.mark.parametrize("rate_px_s", [3.0, 30.0, 1200.0])
@pytest.mark.parametrize("phase_deg", [-40.0, -65.0, -93.0])
@pytest.mark.parametrize(("width_s", "period_s"), [(0.01, 0.7), (1e-4, 0.7), (1e-3, 0.03)])
@pytest.mark.slow
def test_a_glint_keeps_its_light_and_its_place(rate_px_s, phase_deg, width_s, period_s):
    """Light on the image, in the truth and along the truth's path to 0.2 %, its centroid to 0.01 px."""
    simulator = Simulator(glinting(rate_px_s, phase_deg, width_s, period_s), seed=3, catalogue=StarCatalogue.embedded())
    wanted_e, wanted_col = by_time(simulator)
    image_e = simulator.mean_electrons(0).astype(np.float64)
    image_e -= np.median(image_e)
    assert image_e.sum() == pytest.approx(wanted_e, rel=2e-3)
    assert (image_e.sum(axis=0) @ np.arange(image_e.shape[1])) / image_e.sum() == pytest.approx(wanted_col, abs=0.01)
    streak = simulator.frame(0)[1].streaks[0]
    assert streak["flux_e"] == pytest.approx(wanted_e, rel=2e-3)
    nodes_s = (streak["path_t_tai_ns"] - streak["path_t_tai_ns"][0]) * 1e-9
    assert np.trapezoid(streak["path_flux_e_s"], nodes_s) == pytest.approx(wanted_e, rel=2e-3)


def test_means_of_a_light_curve_are_those_of_its_factor():
    """Closed form against a fine sum, over several flashes, parts of one, and none."""
    curve = LightCurve(period_s=0.5, amplitude=0.6, phase_rad=1.0, glint_factor=20.0, glint_width_s=0.2)
    for start_s, end_s in ((0.0, 3.3), (0.1, 0.12), (7.4, 7.9)):
        time_s = start_s + (np.arange(400_000) + 0.5) * (end_s - start_s) / 400_000
        mean = curve.mean_factor(np.array([start_s]), np.array([end_s]))[0]
        assert mean == pytest.approx(curve.factor(time_s).mean(), rel=1e-6)
