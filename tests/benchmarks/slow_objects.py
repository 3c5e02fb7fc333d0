"""Slow objects through the whole chain: pulls of the tracklets that `onboard.tracker = joint_and_stack` finds.

Points on great circles at constant rates within the default box of velocities, S/N 1.2 to 4 in each of 41 frames of 768 x 768 px
of `sboc_like`, beside the Earth's shadow on the geostationary ring. Run from the repository's root:

    python -m tests.benchmarks.slow_objects --seeds 101 102 103 --out DIR

prints how many are found by S/N, false tracklets, and pulls of places, rates and magnitudes.
"""

import argparse
import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from astropy.table import Table
from astropy.time import Time
from numpy.typing import NDArray

from sboc_e2e.api import run
from sboc_e2e.score.figures import bootstrap, half_point, pull_width, rate, rms

RA_DEG, DEC_DEG = 131.5, 2.5
EPOCH = "2027-01-29T00:00:00"
SIDE_PX, SCALE_ARCSEC = 768, 4.55
FRAMES, FRAME_S = 41, 0.25
COL_PX_S, HALF_COL_PX_S, HALF_ROW_PX_S = 9.0, 0.8, 0.35
V_MAG: Final = (16.0, 17.3)
APART_PX: Final = 30.0
MARGIN_PX: Final = 20.0
SAME_ARCSEC: Final = 15.0
"""A tracklet is an object's where it lies so near at its epoch: three pixels."""


@dataclass(frozen=True, kw_only=True)
class SlowPath:
    """A point's direction at the run's epoch, rates on the sky, and V."""

    ra_deg: float
    dec_deg: float
    east_arcsec_s: float
    north_arcsec_s: float
    v_mag: float

    def toml(self, number: int) -> str:
        """As an entry of `objects.sky_path`."""
        return (
            f'  {{ name = "slow-{number}", v = "{self.v_mag:.4f} mag", '
            f'ra = "{self.ra_deg:.8f} deg", dec = "{self.dec_deg:.8f} deg", '
            f'east = "{self.east_arcsec_s:.6f} arcsec/s", north = "{self.north_arcsec_s:.6f} arcsec/s", range = "38000 km" }},'
        )

    def at(self, seconds: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Direction (3,) and its rate (3,), rad/s, on the great circle."""
        ra, dec = np.radians([self.ra_deg, self.dec_deg])
        here = np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
        east, north = east_and_north(here)
        way = np.radians(self.east_arcsec_s / 3600.0) * east + np.radians(self.north_arcsec_s / 3600.0) * north
        speed = float(np.linalg.norm(way))
        angle, unit = speed * seconds, way / speed
        return np.cos(angle) * here + np.sin(angle) * unit, speed * (np.cos(angle) * unit - np.sin(angle) * here)


def east_and_north(here: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Unit vectors at a direction."""
    east = np.array([-here[1], here[0], 0.0]) / np.hypot(here[0], here[1])
    return east, np.cross(here, east)


def drawn(seed: int, n: int) -> list[SlowPath]:
    """Paths that stay inside the frame, apart from each other. East is towards lower columns, north towards lower rows."""
    rng = np.random.default_rng((seed, 11))
    seconds = FRAMES * FRAME_S
    places: list[NDArray[np.float64]] = []
    out: list[SlowPath] = []
    while len(out) < n:
        speed = np.array([rng.uniform(-1, 1) * HALF_ROW_PX_S, COL_PX_S + rng.uniform(-1, 1) * HALF_COL_PX_S])
        place = rng.uniform(MARGIN_PX, SIDE_PX - MARGIN_PX - np.array([0.0, COL_PX_S * seconds]))
        if any(np.hypot(*(place - other)) < APART_PX for other in places):
            continue
        places.append(place)
        north, east = -(place - 0.5 * SIDE_PX) * SCALE_ARCSEC / 3600.0
        dec = DEC_DEG + north
        out.append(
            SlowPath(
                ra_deg=RA_DEG + east / np.cos(np.radians(dec)), dec_deg=dec, east_arcsec_s=-speed[1] * SCALE_ARCSEC,
                north_arcsec_s=-speed[0] * SCALE_ARCSEC, v_mag=float(rng.uniform(*V_MAG)),
            )
        )  # fmt: skip
    return out


def scenario(paths: list[SlowPath], seed: int) -> str:
    """The run's file."""
    entries = "\n".join(path.toml(k) for k, path in enumerate(paths))
    return f"""description = "Slow points."
seed = {seed}
epoch_utc = "{EPOCH}"
frames = {FRAMES}
frame_rate = "{1.0 / FRAME_S:g} Hz"
[instrument]
preset = "sboc_like"
rows = {SIDE_PX}
cols = {SIDE_PX}
[pointing]
law = "inertial"
ra = "{RA_DEG} deg"
dec = "{DEC_DEG} deg"
[shutter]
exposure = "0.2 s"
[population]
classes = []
[objects]
orbit = []
passing = []
sky_path = [
{entries}
]
[onboard.tracker]
use = "joint_and_stack"
[output]
keep_frames_every = 0
"""


def compared(folder: Path, paths: list[SlowPath]) -> dict[str, list[Any]]:
    """Objects found, and residuals of their tracklets."""
    tracklets = Table.read(folder / "products/tracklets.ecsv")
    truth = Table.read(folder / "truth/streaks.ecsv")
    names = Table.read(folder / "truth/objects.ecsv")
    number = {int(r["object_id"]): int(str(r["name"]).split("-")[1]) for r in names if str(r["name"]).startswith("slow-")}
    snr = {number[k]: float(np.mean(truth["snr"][truth["object_id"] == k])) for k in number if k in set(truth["object_id"])}
    start = Time(EPOCH, scale="utc").tai
    out: dict[str, list[Any]] = {name: [] for name in ("snr", "seen", "false", "place", "rate", "mag", "mag_off")}
    found: set[int] = set()
    for t in tracklets:
        seconds = float((Time(str(t["t_ref_utc"]), scale="utc").tai - start).sec)
        ra, dec = np.radians([t["ra_ref_deg"], t["dec_ref_deg"]])
        seen = np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
        off = [np.degrees(np.arccos(np.clip(seen @ path.at(seconds)[0], -1, 1))) * 3600.0 for path in paths]
        k = int(np.argmin(off))
        out["false"].append(off[k] > SAME_ARCSEC)
        if off[k] > SAME_ARCSEC:
            continue
        found.add(k)
        here, way = paths[k].at(seconds)
        true_rate = np.degrees(np.linalg.norm(way))
        out["rate"].append((float(t["rate_deg_s"]) - true_rate) / float(t["rate_err_deg_s"]))
        east, north = east_and_north(here)
        out["place"] += [float((seen - here) @ axis) / np.radians(1 / 3600.0) for axis in (east, north)]
        if np.isfinite(t["mag"]):
            out["mag"].append((float(t["mag"]) - paths[k].v_mag) / float(t["mag_err"]))
            out["mag_off"].append(float(t["mag"]) - paths[k].v_mag)
    for k, value in snr.items():
        out["snr"].append(value)
        out["seen"].append(k in found)
    return out


def figures(folders: list[tuple[Path, list[SlowPath]]]) -> dict[str, Any]:
    """Of all runs."""
    each = [compared(folder, paths) for folder, paths in folders]
    joined = {name: [v for one in each for v in one[name]] for name in each[0]}
    mag, rates = np.array(joined["mag"]), np.array(joined["rate"])
    return {
        "runs": len(folders),
        "found": [sum(joined["seen"]), len(joined["seen"])],
        "s50": half_point(joined["snr"], joined["seen"]),
        "false_tracklets_per_window": rate(sum(joined["false"]), float(len(folders)), len(folders)),
        "rate_pull": bootstrap(rates, pull_width), "rate_rms": bootstrap(rates, rms),
        "mag_pull": bootstrap(mag, pull_width), "mag_rms": bootstrap(mag, rms),
        "mag_median_pull": round(float(np.median(mag)), 3), "mag_median_off": round(float(np.median(joined["mag_off"])), 4),
        "place_rms_arcsec": bootstrap(np.array(joined["place"]), rms),
    }  # fmt: skip


def main() -> None:
    """Make the runs that do not exist yet, and print the figures as JSON."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, nargs="+", default=[1])
    parser.add_argument("--objects", type=int, default=40)
    parser.add_argument("--out", type=Path, required=True)
    chosen = parser.parse_args()
    made = []
    for seed in chosen.seeds:
        paths = drawn(seed, chosen.objects)
        folder, file = chosen.out / f"run-{seed}", chosen.out / f"slow-{seed}.toml"
        if not (folder / "report.html").exists():
            chosen.out.mkdir(parents=True, exist_ok=True)
            file.write_text(scenario(paths, seed))
            run(file, folder)
        made.append((folder, paths))
    sys.stdout.write(json.dumps(figures(made), indent=1) + "\n")


if __name__ == "__main__":
    main()
