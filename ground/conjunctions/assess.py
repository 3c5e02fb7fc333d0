"""One encounter judged: the two-dimensional probability, whether its assumptions hold, and which figure stands."""

from dataclasses import dataclass
from typing import Final

from ground.conjunctions.curved import CurvedProbability, curved
from ground.conjunctions.encounter import Encounter, StateEstimate, encounter_of
from ground.conjunctions.monte_carlo import Trial, monte_carlo, nearest_window
from ground.conjunctions.probability import Dilution, alfano, chan, dilution, foster

_ALLOWED: Final = 0.10
"""Largest relative difference from the curved probability at which straight lines stand."""
_NO_MATTER: Final = 1e-10
"""Probabilities below this are not told apart."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Assessment:
    """All figures of an encounter.

    foster : NaN where its grid does not resolve the errors. chan : NaN where its equal area may be wrong by more than a per cent.
    stands : "two-dimensional", "curved" or "Monte Carlo"; probability : that one. reason : why the plane does or does not hold.
    trial : of Monte Carlo, None where it was not needed.
    """

    encounter: Encounter
    alfano: float
    foster: float
    chan: float
    dilution: Dilution
    curved: CurvedProbability
    trial: Trial | None
    stands: str
    probability: float
    reason: str


def assess(first: StateEstimate, second: StateEstimate, hard_body_km: float, drawn: int = 1_000_000) -> Assessment:
    """Judge the encounter of two states near TCA. drawn : pairs of orbits for Monte Carlo, if that is needed."""
    encounter = encounter_of(first, second, hard_body_km)
    plane = alfano(encounter)
    bent = curved(first, second, hard_body_km)
    trial = None
    if bent.reliable or (not bent.slow and max(plane, bent.probability) < _NO_MATTER and bent.lost < 0.5):
        if abs(bent.probability - plane) <= _ALLOWED * max(plane, _NO_MATTER):
            stands, probability = "two-dimensional", plane
            reason = f"bent orbits and doubtful velocities change it by less than {100 * _ALLOWED:.0f} %"
        else:
            stands, probability = "curved", bent.probability
            reason = f"straight lines with constant covariances would give {plane:.3g}"
    else:
        trial = monte_carlo(first, second, hard_body_km, drawn, nearest_window(first, second))
        stands, probability = "Monte Carlo", trial.probability
        reason = "the objects stay near each other or meet again" if bent.slow else "no single most probable hit was found"
        reason += f"; half a revolution before and after, 95 % {trial.low:.2g} to {trial.high:.2g}"
    return Assessment(
        encounter=encounter, alfano=plane, foster=foster(encounter), chan=chan(encounter), dilution=dilution(encounter),
        curved=bent, trial=trial, stands=stands, probability=probability, reason=reason,
    )  # fmt: skip
