"""One row for each star, see `stars_tables`."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from astropy.table import Table

from ground.products.tables.columns import parts_of, table_of
from ground.records import GroundProducts
from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.products import FrameSolution
from sboc_e2e.icd.signals import StarList


def stars_tables(products: GroundProducts, frames: Sequence[DownlinkFrame]) -> Iterator[Table]:
    """One row for each star that was received, with its identification where there is one."""
    for part in parts_of(len(frames)):
        yield _stars_table([(frames[k].header.frame, frames[k].stars, products.solutions[k]) for k in part])


def _stars_table(found: Sequence[tuple[int, StarList, FrameSolution]]) -> Table:
    """found : number, stars and solution of each frame."""
    parts: dict[str, list[Any]] = {name: [] for name in ("frame", "row", "col", "flux", "snr", "flags", "v", "bv", "dr", "dc")}
    for number, stars, solution in found:
        n = len(stars)
        matched = {name: np.full(n, np.nan) for name in ("v", "bv", "dr", "dc")}
        index = np.asarray(solution.star_index, dtype=np.intp)
        matched["v"][index], matched["bv"][index] = solution.star_v_mag, solution.star_b_v
        matched["dr"][index], matched["dc"][index] = solution.star_residual_px[:, 0], solution.star_residual_px[:, 1]
        parts["frame"].append(np.full(n, number))
        for name, values in (("row", stars.row), ("col", stars.col), ("flux", stars.flux_e)):
            parts[name].append(values)
        parts["snr"].append(stars.snr)
        parts["flags"].append(stars.flags)
        for name, values in matched.items():
            parts[name].append(values)
    column = {name: np.concatenate(values) if values else np.zeros(0) for name, values in parts.items()}
    return table_of(
        [
            ("frame", column["frame"].astype(np.int64), None, "frame number"),
            ("row", column["row"], "pix", "centroid"),
            ("col", column["col"], "pix", "centroid"),
            ("flux_e", column["flux"], "electron", "flux in one exposure"),
            ("snr", column["snr"], None, "matched-filter S/N"),
            ("v_mag", column["v"], "mag", "catalogue V; NaN when not identified"),
            ("b_v", column["bv"], "mag", "catalogue B-V"),
            ("residual_row_px", column["dr"], "pix", "measured minus fitted"),
            ("residual_col_px", column["dc"], "pix", "measured minus fitted"),
            ("flags", column["flags"].astype(np.int64), None, "StarFlag bits"),
        ],
        "stars",
    )
