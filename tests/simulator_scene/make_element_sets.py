"""Make scenarios/data/made_up.3le: made-up satellites for `catalogue_pass`, because real catalogues may not be passed on.

``python -m tests.simulator_scene.make_element_sets scenarios/data/made_up.3le``. Orbits are drawn from rough classes of
the catalogued population; those that cross the field in the scenario's minute are kept, and one in 300 of the others.
"""

import argparse
import math
import tempfile
from pathlib import Path

import numpy as np
from sgp4.api import WGS72, Satrec
from sgp4.exporter import export_tle

from sboc_e2e import scenario
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.registry import Registry
from simulator.chain import Simulator

EPOCH_1949_DAYS = 26319.25  # 2022-01-22T06:00 in days since 1949-12-31T00:00, as SGP4 counts
N_DRAWN = 9000
N_BATCHES = 4
KEEP_EVERY = 300
EARTH_KM = 6378.135
MU_KM3_S2 = 398600.8
CLASSES = (  # share, perigee heights (km), apogee above perigee (km), inclinations (deg)
    (0.55, (520, 900), (0, 60), (53, 66, 74, 82, 97.5, 98.2)),
    (0.30, (900, 1500), (0, 200), (65, 74, 82, 99, 100.5)),
    (0.05, (200, 700), (20000, 38000), (7, 28, 63.4)),
    (0.05, (19100, 23200), (0, 100), (55, 56, 64.8)),
    (0.05, (35700, 35900), (0, 60), (0.05, 2, 8, 14)),
)


def orbits(rng: np.random.Generator) -> list[tuple[float, ...]]:
    """Eccentricity, perigee, inclination, mean motion (rad/min), mean anomaly and node of each drawn satellite."""
    shares = np.array([share for share, *_ in CLASSES])
    found = []
    for k in rng.choice(len(CLASSES), N_DRAWN, p=shares / shares.sum()):
        _, perigee, rise, inclinations = CLASSES[k]
        low = EARTH_KM + rng.uniform(*perigee)
        high = low + rng.uniform(*rise)
        motion = 60.0 * math.sqrt(MU_KM3_S2 / (0.5 * (low + high)) ** 3)
        inclination = math.radians(abs(rng.choice(inclinations) + rng.normal(0, 0.2)))
        turn = 2 * math.pi
        found.append(
            ((high - low) / (high + low), rng.uniform(0, turn), inclination, rng.uniform(0, turn), motion, rng.uniform(0, turn))
        )
    return found


def element_set(number: int, orbit: tuple[float, ...]) -> list[str]:
    """Name and the two lines of a satellite."""
    eccentricity, perigee, inclination, anomaly, motion, node = orbit
    satellite = Satrec()
    satellite.sgp4init(
        WGS72, "i", number, EPOCH_1949_DAYS, 1e-5, 0.0, 0.0, eccentricity, perigee, inclination, anomaly, motion, node
    )
    satellite.classification = "U"
    satellite.intldesg = "22001A"
    return [f"0 MADE-UP {number}", *export_tle(satellite)]


def main(target: Path) -> None:
    """Draw in batches, see who crosses the field, keep them and some others."""
    rng = np.random.default_rng(20220122)
    kept: list[tuple[float, ...]] = []
    with tempfile.TemporaryDirectory() as folder:
        everyone = Path(folder) / "all.3le"
        for _ in range(N_BATCHES):
            drawn = orbits(rng)
            everyone.write_text("\n".join(line for k, orbit in enumerate(drawn) for line in element_set(90000 + k, orbit)) + "\n")
            chosen = scenario.load("catalogue_pass", registry=Registry(), overrides=[f'objects.satellites.file="{everyone}"'])
            simulator = Simulator(chosen.simulator, seed=chosen.seed, catalogue=StarCatalogue.embedded())
            crossing = {int(str(name).split()[-1]) - 90000 for name in simulator.objects()["name"]}
            kept += [orbit for k, orbit in enumerate(drawn) if k in crossing or k % KEEP_EVERY == 0]
    target.write_text("\n".join(line for k, orbit in enumerate(kept) for line in element_set(90000 + k, orbit)) + "\n")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Write made-up element sets.")
    parser.add_argument("target", type=Path)
    main(parser.parse_args().target)
