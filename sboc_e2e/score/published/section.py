"""Section `products` of a score: every published file read again and compared with the truth."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
from astropy.table import Table

from sboc_e2e.score.figures import absent
from sboc_e2e.score.published.angles import StatedSigmas, angle_figures
from sboc_e2e.score.published.kvn import UnreadableProduct
from sboc_e2e.score.published.magnitudes import magnitude_figures
from sboc_e2e.score.published.observer import observer_figures
from sboc_e2e.score.published.oem_reader import Ephemeris, read_oem
from sboc_e2e.score.published.tdm_reader import TdmSegment, read_tdm
from sboc_e2e.score.published.true_motion import true_motions, true_observer

Item = TypeVar("Item")

COMPANION_COLUMNS: Final = ("tracklet_id", "t_tai_ns", "sigma_along_arcsec", "sigma_cross_arcsec")
"""A table in products/ with these columns says how well each angle of the message is known."""


def published_products(
    folder: Path | None,
    streaks: Table,
    tracklets: Table,
    truth: Mapping[str, Table],
    owner: Mapping[int, int],
    truth_mag: Mapping[int, float],
) -> dict[str, Any]:
    """All parts of the section.

    folder : products/ of a run, None for a run without files. streaks, tracklets : its tables. truth : `frames` and `streaks`.
    owner : tracklet -> object, -1 for none. truth_mag : V of the mean light of each row of truth/streaks.ecsv. Where a file
    is missing or cannot be read, the figures that rest on it are absent for that reason, file and line named.
    """
    motions, observer = true_motions(truth["streaks"]), true_observer(truth["frames"])

    def of_segments(segments: Sequence[TdmSegment]) -> dict[str, dict[str, Any]]:
        return {
            "angles": angle_figures(segments, streaks, _companion(folder), owner, motions),
            "magnitudes": magnitude_figures(segments, streaks, tracklets, owner, motions, truth_mag),
        }

    def of_ephemerides(ephemerides: Sequence[Ephemeris]) -> dict[str, dict[str, Any]]:
        return {"observer": observer_figures(ephemerides, observer)}

    return _from_files(folder, "*.tdm", "tracking data message", read_tdm, of_segments) | _from_files(
        folder, "*.oem", "orbit ephemeris message of the camera", read_oem, of_ephemerides
    )


def _from_files(
    folder: Path | None,
    pattern: str,
    what: str,
    read: Callable[[Path], Sequence[Item]],
    figures_of: Callable[[Sequence[Item]], dict[str, dict[str, Any]]],
) -> dict[str, dict[str, Any]]:
    """Figures of what the files of one kind hold, or the same figures absent."""
    paths = sorted(folder.glob(pattern)) if folder else []
    reason = "" if paths else f"no {what} was published (products/{pattern})"
    items: list[Item] = []
    try:
        for path in paths:
            items += read(path)
    except UnreadableProduct as error:
        items, reason = [], str(error)
    parts = figures_of(items)
    return {part: dict.fromkeys(figures, absent(reason)) for part, figures in parts.items()} if reason else parts


def _companion(folder: Path | None) -> dict[int, StatedSigmas]:
    """Stated errors of angles by tracklet, from the table that has them; none without such a table."""
    for path in sorted(folder.glob("*.ecsv")) if folder else ():
        with path.open(encoding="utf-8") as lines:
            names = next((line.split() for line in lines if not line.startswith("#")), [])
        if all(name in names for name in COMPANION_COLUMNS):
            return _sigmas(Table.read(path, format="ascii.ecsv"))
    return {}


def _sigmas(table: Table) -> dict[int, StatedSigmas]:
    tracklet = np.asarray(table["tracklet_id"], int)
    t = np.asarray(table["t_tai_ns"], np.int64)
    sigma = np.stack([np.asarray(table[f"sigma_{name}_arcsec"], float) for name in ("along", "cross")], axis=1)
    sigma = np.where(sigma > 0.0, sigma, np.nan)
    return {
        int(number): StatedSigmas(t_tai_ns=t[tracklet == number], sigma_arcsec=sigma[tracklet == number])
        for number in np.unique(tracklet)
    }
