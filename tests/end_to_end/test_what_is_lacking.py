"""A downlink without attitude or GPS, and one of a single frame: each product says what it lacks, and why."""

import json
from pathlib import Path

import numpy as np
import pytest
from astropy.table import Table

from sboc_e2e.icd.flags import FrameFlag
from sboc_e2e.registry import Registry
from sboc_e2e.run.begin import begin_or_continue
from sboc_e2e.scenario import load

SMALL = ("output.keep_frames_every=0", "ground.products.images=none")


def products_of(folder: Path, *overrides: str) -> Path:
    """Products of `smoke`, changed."""
    run = begin_or_continue(folder, load("smoke", registry=Registry(), overrides=(*SMALL, *overrides)), workers=1)
    run.simulate_and_onboard()
    run.ground()
    return folder / "products"


@pytest.fixture(scope="module")
def blind(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return products_of(tmp_path_factory.mktemp("blind"), "frames=3", "telemetry.attitude=false", "telemetry.orbit=false")


@pytest.fixture(scope="module")
def single(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return products_of(tmp_path_factory.mktemp("single"), "frames=1")


def table(folder: Path, name: str) -> Table:
    return Table.read(folder / name, format="ascii.ecsv")


def test_without_attitude_and_gps_every_product_says_so(blind: Path) -> None:
    """Frames are flagged; there is no ephemeris, no orbit, no state and no flux, each with its reason."""
    said = "\n".join(json.loads((blind / "ingest.json").read_text())["products_lack"])
    assert "no frame has a state of the observer (GPS): observer.oem is not written, no orbit is determined" in said
    assert "3 of 3 frames have no telemetered attitude (NO_ATTITUDE)" in said
    assert not (blind / "observer.oem").exists()
    assert not list(blind.glob("states/*"))
    missing = int(FrameFlag.NO_OBSERVER | FrameFlag.NO_ATTITUDE)
    assert all(int(flags) & missing == missing for flags in table(blind, "frames.ecsv")["flags"])
    for row in table(blind, "orbits.ecsv"):
        assert not row["converged"]
        assert np.isnan(np.ma.filled(row["range_km"], np.nan))
    assert len(table(blind, "orbit_samples.ecsv")) == 0
    flux = table(blind, "population.ecsv")
    assert "observer" in flux.meta["lacks"]
    assert not np.isfinite(np.ma.filled(flux["larger"], np.nan)).any()


def test_directions_without_gps_say_what_was_not_removed(blind: Path) -> None:
    """In the message beside its segments."""
    tracklets = table(blind, "tracklets.ecsv")
    assert len(tracklets) > 0
    text = (blind / "tracklets.tdm").read_text()
    told = "observer state unknown: aberration of the observer's geocentric velocity NOT removed"
    assert text.count(told) == text.count("META_START") > 0
    assert text.count("No ephemeris of the observer covers all of these frames") == text.count("META_START")


def test_one_frame_gives_streaks_and_says_why_there_is_no_more(single: Path) -> None:
    """No sense of motion, no tracklet, no orbit, no flux."""
    said = "\n".join(json.loads((single / "ingest.json").read_text())["products_lack"])
    assert "one frame only: streaks cannot be linked over frames" in said
    assert "no tracklet: tracklets.tdm has no segment" in said
    assert {name: len(table(single, name)) for name in ("tracklets.ecsv", "orbits.ecsv", "orbit_samples.ecsv")} == {
        "tracklets.ecsv": 0, "orbits.ecsv": 0, "orbit_samples.ecsv": 0,
    }  # fmt: skip
    streaks = table(single, "streaks.ecsv")
    assert (streaks["tracklet_id"] == -1).all()
    assert "1 frame: tracklets and the time watched need two" in table(single, "population.ecsv").meta["lacks"]
