"""A downlink without attitude or GPS, one frame, tracklets of one streak: each product says what it lacks, and why."""

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
    registry = Registry(trusted_modules=("tests.end_to_end.lone_linker",))
    run = begin_or_continue(folder, load("smoke", registry=registry, overrides=(*SMALL, *overrides)), workers=1)
    run.simulate_and_onboard()
    run.ground()
    return folder / "products"


@pytest.fixture(scope="module")
def blind(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return products_of(tmp_path_factory.mktemp("blind"), "frames=3", "telemetry.attitude=false", "telemetry.orbit=false")


@pytest.fixture(scope="module")
def single(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return products_of(tmp_path_factory.mktemp("single"), "frames=1")


@pytest.fixture(scope="module")
def lone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four tracklets of one streak; of the second and the fourth the sense of motion is known."""
    linker = "ground.linker.use=tests.end_to_end.lone_linker:LoneLinker"
    return products_of(tmp_path_factory.mktemp("lone"), "frames=3", linker)


def table(folder: Path, name: str) -> Table:
    return Table.read(folder / name, format="ascii.ecsv")


def test_without_attitude_and_gps_every_product_says_so(blind: Path) -> None:
    """Frames are flagged; there is no ephemeris, no orbit, no state and no flux, each with its reason."""
    lacks = "\n".join(json.loads((blind / "ingest.json").read_text())["products_lack"])
    assert "no frame has a state of the observer (GPS): observer.oem is not written, no orbit is determined" in lacks
    assert "3 of 3 frames have no telemetered attitude (NO_ATTITUDE)" in lacks
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
    lacks = "\n".join(json.loads((single / "ingest.json").read_text())["products_lack"])
    assert "one frame only: streaks cannot be linked over frames" in lacks
    assert "no tracklet: tracklets.tdm has no segment" in lacks
    assert {name: len(table(single, name)) for name in ("tracklets.ecsv", "orbits.ecsv", "orbit_samples.ecsv")} == {
        "tracklets.ecsv": 0, "orbits.ecsv": 0, "orbit_samples.ecsv": 0,
    }  # fmt: skip
    streaks = table(single, "streaks.ecsv")
    assert (streaks["tracklet_id"] == -1).all()
    assert "1 frame: tracklets and the time watched need two" in table(single, "population.ecsv").meta["lacks"]


def test_tracklets_of_one_streak_say_what_one_streak_cannot_tell(lone: Path) -> None:
    """No sense of motion: a middle without errors along and across, no rate, no orbit. With the sense: two dated ends with errors
    and an orbit whose posterior is published as samples."""
    tracklets, angles = table(lone, "tracklets.ecsv"), table(lone, "tdm_angles.ecsv")
    n = len(tracklets)
    assert n >= 2
    assert (tracklets["n_frames"] == 1).all()
    turned, known = (", ".join(str(k) for k in range(first, n, 2)) for first in (0, 1))
    lacks = json.loads((lone / "ingest.json").read_text())["products_lack"]
    assert f"seen in one frame only: tracklets {', '.join(map(str, range(n)))}" in lacks
    assert f"no orbit, since the sense of motion is unknown: tracklets {turned}" in lacks
    assert f"no covariance in the OPM, the posterior is not Gaussian, samples only: tracklets {known}" in lacks
    segments = (lone / "tracklets.tdm").read_text().split("META_START")[1:]
    assert len(segments) == n
    for number, segment in enumerate(segments):
        rows, tracklet = angles[angles["tracklet_id"] == number], tracklets[number]
        rate = np.ma.filled(tracklet["rate_deg_s"], np.nan)
        if number % 2:
            assert list(rows["end"]) == ["end 0", "end 1"]
            assert (np.ma.filled(rows["sigma_along_arcsec"], np.nan) > 0.0).all()
            assert rate > 0.0
            assert "Sense of motion unknown" not in segment
        else:
            assert list(rows["end"]) == ["middle"]
            assert np.isnan(rate)
            assert "Sense of motion unknown: directions are of middles, not of ends" in segment
            assert "Errors along and across are unknown: too few directions show no motion" in segment
    assert set(table(lone, "orbits.ecsv")["tracklet_id"]) == set(range(1, n, 2))
    assert len(table(lone, "orbit_samples.ecsv")) > 0
    assert not np.ma.filled(table(lone, "orbits.ecsv")["gaussian"], False).any()
    # a detection without a second one counts as nothing: the flux is of tracklets that were found in two frames or more
    assert "tracklets that the detector found in two single frames or more" in table(lone, "population.ecsv").meta["definition"]
