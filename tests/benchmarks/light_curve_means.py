"""Mean light of simulated objects over their light curves, which is what a tracklet's magnitude states.

Trails show parts of a light curve: the mean light of three exposures of a slow tumbler is not that of its turns. The light curves
are those that the simulator draws from the run's seed.
"""

from pathlib import Path

import numpy as np
from astropy.table import Table

from sboc_e2e.registry import Registry
from sboc_e2e.scenario import load
from simulator.platform.earth import tai_ns_of_utc
from simulator.randomness import Effect, generator
from simulator.scene.reflection import LightCurve
from simulator.scene.sources import light_curves


def true_mean_magnitudes(run_dir: Path, scenario: str, seed: int) -> dict[int, float]:
    """V of the mean light over the light curve, by object: the mean over the epochs of its trails, the range being what it is."""
    options = load(scenario, registry=Registry(), seed=seed).simulator
    epoch_ns = tai_ns_of_utc(options.epoch_utc)
    objects = Table.read(run_dir / "truth/objects.ecsv", format="ascii.ecsv")
    streaks = Table.read(run_dir / "truth/streaks.ecsv", format="ascii.ecsv")
    drawn = [int(row["object_id"]) for row in objects if row["kind"] == "population"]
    curves = dict(zip(drawn, light_curves(generator(seed, Effect.LIGHT_CURVE), len(drawn), options.population), strict=True))
    out = {}
    for number in sorted({int(k) for k in streaks["object_id"]}):
        mine = [row for row in streaks if int(row["object_id"]) == number]
        curve = curves.get(number, LightCurve())
        out[number] = float(np.mean([_steady_mag(row, curve, epoch_ns) for row in mine])) - 2.5 * np.log10(turn_mean(curve))
    return out


def turn_mean(curve: LightCurve) -> float:
    """Mean of a light curve over a turn: one, and its flash."""
    return 1.0 + curve.glint_factor * curve.glint_width_s * np.sqrt(2.0 * np.pi) / curve.period_s


def _steady_mag(row: Table.Row, curve: LightCurve, epoch_ns: int) -> float:
    """V that a trail's object would have with constant light; its table has that of mid-trail."""
    light, t_ns = np.asarray(row["path_flux_e_s"], float), np.asarray(row["path_t_tai_ns"], np.int64)
    good = np.isfinite(light) & (light > 0.0)
    factor = curve.factor((t_ns[good] - epoch_ns) * 1e-9)
    middle = float(light[len(light) // 2])
    return float(row["mag"]) - 2.5 * float(np.log10(np.median(light[good] / factor) / middle))
