"""Read-out windows and binning through the whole chain."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from astropy.table import Table

from onboard.chain import OnboardChain, OnboardSteps
from onboard.downlink.codec import PlanesCodec
from onboard.image.background import MeshBackground
from onboard.options import OnboardOptions
from onboard.stars.matched import MatchedStars
from sboc_e2e import scenario
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd.frame import Calibration
from sboc_e2e.registry import Registry
from sboc_e2e.run.ground_stage import ground_chain
from simulator.chain import Simulator
from tests.end_to_end.conftest import products_only, request
from tests.onboard.small_run import STREAK, PlantedDetector

SMOKE = Path("scenarios/smoke.toml")
WINDOW = ("sensor.window.row0=100", "sensor.window.col0=60", "sensor.window.rows=256", "sensor.window.cols=288")
BINNED = ("sensor.binning.rows=2", "sensor.binning.cols=2")


@pytest.mark.parametrize("binning", [(), BINNED])
@pytest.mark.slow
def test_a_run_with_a_window_is_solved(tmp_path: Path, binning: tuple[str, ...]) -> None:
    """Sky above the dark, stars and attitude; a sky of 2.8 e- in 1.2 e-/ADU is far from the pedestal of 256 ADU."""
    run = products_only(request(SMOKE, tmp_path / "run", "frames=1", *WINDOW, *binning))
    (frame,) = Table.read(run.directory.products / "frames.ecsv", format="ascii.ecsv")
    rows, cols = (128, 144) if binning else (256, 288)
    assert (frame["rows"], frame["cols"]) == (rows, cols)
    assert frame["solved"]
    assert frame["rms_px"] < 0.2
    assert frame["n_stars"] > 20


@pytest.mark.slow
def test_maps_of_the_detector_and_of_the_window_give_the_same() -> None:
    """Packets, and pixels of streaks on ground, of a binned window: with the maps of the whole detector and with their part."""
    made = {}
    for name, overrides in (("whole", BINNED), ("window", (*BINNED, *WINDOW))):
        resolved = scenario.load(str(SMOKE), registry=Registry(), overrides=overrides)
        made[name] = Simulator(resolved.simulator, seed=resolved.seed, catalogue=StarCatalogue.embedded())
    frame, _ = made["window"].frame(0)
    row, col = np.indices(frame.pixels.shape)
    trail = replace(STREAK, row1=100.0, col1=120.0)
    share = np.linspace(0.0, 1.0, 1000)[:, None, None]
    rows, cols = trail.row0 + share * (trail.row1 - trail.row0), trail.col0 + share * (trail.col1 - trail.col0)
    light = np.exp(-0.5 * ((row[40:101] - rows) ** 2 + (col[40:101] - cols) ** 2)).sum(axis=0)
    pixels = frame.pixels.copy()
    pixels[40:101] += np.rint(light * (400.0 / light.max())).astype(np.uint16)
    frame = replace(frame, pixels=pixels)
    whole, camera = made["whole"].calibration(), made["window"].camera()
    part = np.s_[50:178, 30:174]
    maps = {name: getattr(whole, name)[part] for name in ("dark_adu", "flat", "defects")}
    assert np.ptp(maps["dark_adu"]) > 1.0
    cut = Calibration(camera=camera, **maps)
    packets = []
    for calibration in (whole, cut):
        steps = OnboardSteps(
            background=MeshBackground(),
            star_extractor=MatchedStars(),
            detector=PlantedDetector(detections=(trail,)),
            codec=PlanesCodec(),
        )
        onboard = OnboardChain(OnboardOptions(), steps, calibration=calibration, camera=camera, run_id=1)
        _, result = onboard.process(onboard.initial_state(), frame)
        packets.append(result.packets)
    assert packets[0] == packets[1]
    catalogue = StarCatalogue.embedded()
    chains = [ground_chain(resolved, calibration=given, camera=camera, catalogue=catalogue) for given in (whole, cut)]
    (received,), _ = chains[0].ingest(packets[0])
    first = chains[1].initial_state()
    fits = [chain.process_frame(first, received)[1].streaks[0].fit for chain in chains]
    assert fits[0].snr > 30.0
    assert (fits[0].flux_e, fits[0].snr, fits[0].chi2_nu) == (fits[1].flux_e, fits[1].snr, fits[1].chi2_nu)
