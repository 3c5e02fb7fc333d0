"""One row for each tracklet beside a catalogue, see `known_table`."""

import json
from collections.abc import Sequence

import numpy as np
from astropy.table import Table

from ground.orbit.catalogue_match import CatalogueMatch
from ground.products.tables.columns import Spec, table_of, texts
from ground.records import GroundProducts


def known_table(products: GroundProducts, matches: Sequence[CatalogueMatch]) -> Table:
    """One row for each tracklet: the nearest catalogue object and all that would do; '-' and NaN where none could be compared."""
    by_tracklet = {match.tracklet_id: match for match in matches}
    found = [by_tracklet.get(t.tracklet_id) for t in products.tracklets]
    columns: list[Spec] = [
        ("tracklet_id", [t.tracklet_id for t in products.tracklets], None, "tracklet"),
        (
            "known",
            np.array([m is not None and m.known for m in found], dtype=bool),
            None,
            "whether one catalogue object fits, no other, and chance gives no such match",
        ),
        (
            "status",
            texts([_status(m) for m in found]),
            None,
            "known; ambiguous: candidates are hypotheses; unknown: none fits; not compared: no directions or no observer orbit",
        ),
        ("name", texts([m.name if m is not None and m.known else "-" for m in found]), None, "object, when known"),
        ("number", np.array([m.number if m is not None and m.known else -1 for m in found], dtype=np.int64), None, "its number"),
    ]
    for name, unit, text in (
        ("along_arcsec", "arcsec", "observed minus computed along the motion of the nearest object"),
        ("cross_arcsec", "arcsec", "observed minus computed across it"),
        ("rate_residual_arcsec_s", "arcsec / s", "length of the difference between observed and computed rate"),
        ("range_km", "km", "distance of the nearest object"),
        ("sigmas", None, "distance in expected errors of element sets"),
        (
            "chance_probability",
            None,
            "that an unrelated object fits as well as the nearest, from the density of predicted objects in place and rate",
        ),
    ):
        columns.append((name, [float("nan") if m is None else getattr(m, name) for m in found], unit, text))
    n_candidates = np.array([0 if m is None else m.n_candidates for m in found], dtype=np.int64)
    columns.append(("n_candidates", n_candidates, None, "objects that would do; more than one: ambiguous"))
    hypotheses = [
        [[c.number, c.name, round(c.sigmas, 3), float(f"{c.chance_probability:.3g}")] for c in (m.candidates if m else ())]
        for m in found
    ]
    columns.append(
        ("candidates", texts([json.dumps(h) for h in hypotheses]), None, "[number, name, sigmas, chance_probability] of each")
    )
    return table_of(columns, "known")


def _status(match: CatalogueMatch | None) -> str:
    """Word for what a comparison with the catalogue gave."""
    if match is None:
        return "not compared"
    if match.known:
        return "known"
    return "ambiguous" if match.candidates else "unknown"
