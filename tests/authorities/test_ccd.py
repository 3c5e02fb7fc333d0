"""A CCD: all rows at once, and frame-transfer smear against charge that is moved row by row."""

from dataclasses import replace

import numpy as np
import pytest

from sboc_e2e.catalogue import StarCatalogue
from simulator.chain import Simulator
from simulator.options import smoke_options
from simulator.platform.shutter import ShutterOptions
from simulator.scene.encounters import PopulationOptions
from simulator.scene.sources import ObjectOptions, PixelPathOptions
from simulator.sensor.options import CcdOptions, SensorOptions
from simulator.sensor.smear import add_smear


def moved_charge(rate_e_s: np.ndarray, transfer_s: float, exposure_s: float) -> np.ndarray:
    """Packets that fall in from the top while the frame before is moved out, are exposed, and are moved out themselves."""
    rows = len(rate_e_s)
    charge = np.zeros_like(rate_e_s)
    for _ in range(rows):  # the frame before leaves: every packet moves down by a row, an empty one comes in at the top
        charge[:-1] = charge[1:]
        charge[-1] = 0.0
        charge += rate_e_s * transfer_s
    charge -= rate_e_s * transfer_s  # the last step ends in the exposure
    charge += rate_e_s * exposure_s
    store = np.zeros_like(rate_e_s)
    for step in range(rows):
        store[step] = charge[0]  # row 0 of the image leaves first
        charge[:-1] = charge[1:]
        charge[-1] = 0.0
        charge += rate_e_s * transfer_s
    return store


def test_smear_is_that_of_charge_moved_row_by_row():
    rng = np.random.default_rng(5)
    rate_e_s = rng.exponential(50.0, (60, 7))
    rate_e_s[20, 3] = 1e6
    transfer_s, exposure_s = 2e-5, 0.1
    # Row r is exposed to its own light during the exposure only, less the steps in which it is elsewhere.
    wanted = moved_charge(rate_e_s, transfer_s, exposure_s)
    image_e = (rate_e_s * exposure_s).astype(np.float32)
    add_smear(image_e, transfer_s, exposure_s)
    assert image_e == pytest.approx(wanted, rel=1e-5, abs=transfer_s * rate_e_s.max() * 1e-5)


def small(**changes):
    thing = PixelPathOptions(v_mag=6.0, row_px=100.0, col_px=200.0, row_rate_px_s=800.0)
    base = smoke_options()
    options = {"population": PopulationOptions(classes=()), "objects": ObjectOptions(passing=(), pixel_path=(thing,))}
    return replace(base, **(options | changes))


def test_a_ccd_exposes_all_rows_at_once():
    """A mover down the rows leaves the trail of a global shutter, whatever the time to read a row of the store."""
    catalogue = StarCatalogue.embedded()
    shutter = ShutterOptions(line_time_us=400.0)
    ccd = Simulator(small(shutter=shutter, sensor=SensorOptions(type="ccd")), seed=2, catalogue=catalogue)
    still = Simulator(small(shutter=replace(shutter, line_time_us=0.0)), seed=2, catalogue=catalogue)
    frame, truth = ccd.frame(0)
    assert frame.header.line_time_ns == 0
    (trail,), (wanted,) = truth.streaks, still.frame(0)[1].streaks
    assert trail["length_px"] == pytest.approx(160.0, abs=0.01)
    assert trail["flux_e"] == pytest.approx(wanted["flux_e"], rel=1e-6)


@pytest.mark.slow
def test_a_mechanical_shutter_leaves_no_smear():
    catalogue = StarCatalogue.embedded()
    transfer_us = 20.0
    open_shutter, closed = (
        Simulator(small(sensor=SensorOptions(type="ccd", ccd=CcdOptions(row_transfer_us=t))), seed=2, catalogue=catalogue)
        for t in (transfer_us, 0.0)
    )
    smeared, plain = open_shutter.mean_electrons(0).astype(float), closed.mean_electrons(0).astype(float)
    share = transfer_us * 1e-6 / 0.2
    assert smeared - plain == pytest.approx(share * (plain.sum(axis=0) - plain), rel=1e-3, abs=1e-3)
    assert (smeared - plain)[:, 200].min() > 1.5 * np.median(smeared - plain)  # the mover's column
