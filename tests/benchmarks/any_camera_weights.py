"""The weights of `ground.vetting.any_camera`, fitted again: ``python -m tests.benchmarks.any_camera_weights``.

tests/streaks/lines_of_all_cameras.csv has the measured lines of 541 frames of 368 repositories and of 96 frames of six simulated
skies (docs/vetting-record.md): repository, frame, the trail by eye that the line lies on (empty for none; 99 for one that only
the second eye marked), the share of this trail that it covers, whether it was refused outright, its weight in the fit, and what
the log odds are made of. Lines that the vetter and look-alikes give less than `LEAST_PROBABILITY` are judged by these alone,
and are here only where they lie on trails. The weights of a repository's trails add up to four at most, those of its other lines
to 40. The frames themselves are not part of the project.

Prints the weights, and how lines are judged by weights that were fitted to the other cameras.
"""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from astropy.table import Table
from numpy.typing import NDArray
from scipy.optimize import brentq, minimize
from scipy.special import expit

from ground.vetting.any_camera import terms_of
from ground.vetting.surroundings import NAMES

LINES: Final = Path(__file__).resolve().parents[1] / "streaks" / "lines_of_all_cameras.csv"
TERMS: Final = (
    "PER_LOG_ODDS",
    "PER_WINS",
    "PER_PEAK",
    "PER_LN_WIDTHS",
    "PER_LN_READOUT",
    "PER_LN_SHARPER",
    "PER_LN_WIDER",
    "PER_LN_OTHERS",
    *NAMES,
)
RIDGE: Final = 0.5  # of weights in units of a term's scatter: one half of a line. Chosen, not measured
LEAST_WIDTHS: Final = 3.0  # shorter lines count as this long in the fit; some have no length at all
HALF: Final = 0.5  # of a trail's length, which counts as found
SIMULATED: Final = "sim_"
"""How the names of simulated skies begin; they count as one camera."""

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Lines:
    """n lines: terms (n, 15) in the order of `TERMS`, log odds that later rules add (light that rises and falls, texture,
    showers, short lines; n), whether each lies on a trail, its weight in the fit, camera, trail.
    """

    terms: Array
    later: Array
    real: NDArray[np.bool_]
    weight: Array
    refused: NDArray[np.bool_]
    share: Array
    camera: NDArray[np.str_]
    trail: NDArray[np.str_]

    @classmethod
    def of(cls, path: Path = LINES) -> "Lines":
        """As the table has them."""
        t = Table.read(path, format="ascii.csv", fill_values=[("", "-1", "trail")])
        trail, camera = np.asarray(t["trail"].filled(-1)), np.asarray(t["camera"], dtype=str)
        t["widths"] = np.maximum(t["widths"], LEAST_WIDTHS)
        columns = ("vetter_log_odds", "pieces", "wins", "peak", "widths", "ln_readout", "ln_sharpness", "others")
        picture: Array = np.column_stack([np.asarray(t[name], dtype=float) for name in NAMES])
        name = [f"{c} {f} {k}" for c, f, k in zip(camera, t["frame"], trail, strict=True)]
        return cls(
            terms=terms_of(*[*(np.asarray(t[name], dtype=float) for name in columns), picture]),
            later=np.asarray(t["later_log_odds"], dtype=float), real=trail >= 0,
            weight=np.asarray(t["weight"], dtype=float), refused=np.asarray(t["refused"]) == 1,
            share=np.asarray(t["share"], dtype=float),
            camera=np.where(np.char.startswith(camera, SIMULATED), SIMULATED, camera), trail=np.array(name),
        )  # fmt: skip


def fitted(lines: Lines, among: NDArray[np.bool_], start: Array | None = None) -> Array:
    """Weights (16,) of the terms, the constant last: logistic regression on some of the lines, with a small ridge.

    The constant is that with which the probabilities of these lines are right in the mean, each line counting once.
    start : weights that are near, which save time.
    """
    use = among & (lines.weight > 0.0)
    terms, later, w, sign = lines.terms[use], lines.later[use], lines.weight[use], np.where(lines.real[use], 1.0, -1.0)
    mean, scatter = terms.mean(axis=0), terms.std(axis=0) + 1e-9
    columns = np.column_stack([(terms - mean) / scatter, np.ones(len(terms))])

    def loss(b: Array) -> tuple[float, Array]:
        odds = sign * (columns @ b + later)
        slope = -columns.T @ (w * sign * np.exp(-np.logaddexp(0.0, odds)))
        ridge = np.append(b[:-1], 0.0)
        return float(w @ np.logaddexp(0.0, -odds) + 0.5 * RIDGE * ridge @ ridge), slope + RIDGE * ridge

    near = np.zeros(columns.shape[1]) if start is None else np.append(start[:-1] * scatter, start[-1] + start[:-1] @ mean)
    b = minimize(loss, near, jac=True).x
    odds = columns @ b + later

    def missing(shift: float) -> float:
        return float(np.sum(expit(odds + shift))) - np.count_nonzero(sign > 0.0)

    return np.append(b[:-1] / scatter, b[-1] - float((b[:-1] * mean / scatter).sum()) + brentq(missing, -10.0, 10.0))


def out_of_camera(lines: Lines) -> Array:
    """Log odds (n,) of each line by weights that were fitted to the lines of the other cameras."""
    out = np.empty(len(lines.real))
    every = fitted(lines, np.ones(len(lines.real), dtype=bool))
    for camera in np.unique(lines.camera):
        own = lines.camera == camera
        weights = fitted(lines, ~own, every)
        out[own] = lines.terms[own] @ weights[:-1] + weights[-1] + lines.later[own]
    return out


@dataclass(frozen=True, kw_only=True)
class Judged:
    """Trails, those published with half their length or more, false lines; lines published at 0.9 or more, the false ones."""

    trails: int
    published: int
    false: int
    sure: int
    sure_false: int


def judged(lines: Lines, log_odds: Array, *, simulated: bool) -> Judged:
    """What log odds (n,) publish of real or of simulated frames."""
    part = (lines.camera == SIMULATED) == simulated
    shown, sure = part & ~lines.refused & (log_odds >= 0.0), part & ~lines.refused & (log_odds >= np.log(9.0))
    return Judged(
        trails=len(np.unique(lines.trail[part & lines.real])),
        published=len(np.unique(lines.trail[shown & lines.real & (lines.share >= HALF)])),
        false=int((shown & ~lines.real).sum()),
        sure=int(sure.sum()),
        sure_false=int((sure & ~lines.real).sum()),
    )


def main() -> None:
    """Print the weights and the two judgements."""
    lines = Lines.of()
    weights = fitted(lines, np.ones(len(lines.real), dtype=bool))
    for name, value in zip((*TERMS, "CONSTANT"), weights, strict=True):
        sys.stdout.write(f"{name:15s} {value:7.3f}\n")
    elsewhere = out_of_camera(lines)
    for simulated in (False, True):
        what = "simulated" if simulated else "real"
        sys.stdout.write(f"{what} frames, judged by the other cameras: {judged(lines, elsewhere, simulated=simulated)}\n")


if __name__ == "__main__":
    main()
