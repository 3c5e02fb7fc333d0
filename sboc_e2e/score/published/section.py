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
from sboc_e2e.score.published.opm_reader import PublishedState, read_opm
from sboc_e2e.score.published.samples_reader import StateSamples, read_samples
from sboc_e2e.score.published.states import state_figures
from sboc_e2e.score.published.tdm_reader import TdmSegment, read_tdm
from sboc_e2e.score.published.true_motion import true_motions, true_observer
from sboc_e2e.score.published.true_states import TrueOrbits

Item = TypeVar("Item")

SAMPLES: Final = "orbit_samples.ecsv"

COMPANION_COLUMNS: Final = ("tracklet_id", "epoch_tai_ns", "sigma_along_arcsec", "sigma_cross_arcsec")
"""A table in products/ with these columns says how well each angle of the message is known; their correlation is optional."""

_TOGETHER: Final = "correlation_along_cross"


def published_products(
    folder: Path | None,
    streaks: Table,
    tracklets: Table,
    truth: Mapping[str, Table],
    owner: Mapping[int, int],
    truth_mag: Mapping[int, float],
) -> dict[str, Any]:
    """All parts of the section.

    folder : products/ of a run, None for a run without files. streaks, tracklets : its tables. truth : `frames`, `streaks` and
    `objects`. owner : tracklet -> object, -1 for none. truth_mag : V of the mean light of each row of truth/streaks.ecsv. Where a
    file is missing or cannot be read, the figures that rest on it are absent for that reason, file and line named.
    """
    motions, observer = true_motions(truth["streaks"]), true_observer(truth["frames"])
    orbits = TrueOrbits(truth["streaks"], truth["objects"], observer)

    def of_segments(segments: Sequence[TdmSegment]) -> dict[str, dict[str, Any]]:
        return {
            "angles": angle_figures(segments, streaks, _companion(folder), owner, motions),
            "magnitudes": magnitude_figures(segments, streaks, tracklets, owner, motions, truth_mag),
        }

    def of_ephemerides(ephemerides: Sequence[Ephemeris]) -> dict[str, dict[str, Any]]:
        return {"observer": observer_figures(ephemerides, observer)}

    def of_states(states: Sequence[PublishedState | StateSamples]) -> dict[str, dict[str, Any]]:
        single = [s for s in states if isinstance(s, PublishedState)]
        clouds = [s for s in states if isinstance(s, StateSamples)]
        return {"states": state_figures(single, clouds, len(tracklets), owner, orbits, observer)}

    messages, ephemerides = _files(folder, "*.tdm"), _files(folder, "*.oem")
    states = [*_files(folder, "*.opm"), *_files(folder, SAMPLES)]
    return (
        _from_files(messages, read_tdm, of_segments, "no tracking data message was published (products/*.tdm)")
        | _from_files(ephemerides, read_oem, of_ephemerides, "no ephemeris of the camera was published (products/*.oem)")
        | _from_files(states, _read_state, of_states, "")
    )


def _files(folder: Path | None, pattern: str) -> list[Path]:
    """Files of products/ and its folders by name."""
    return sorted(folder.rglob(pattern)) if folder else []


def _read_state(path: Path) -> tuple[PublishedState | StateSamples, ...]:
    return (read_opm(path),) if path.suffix == ".opm" else read_samples(path)


def _from_files(
    paths: Sequence[Path],
    read: Callable[[Path], Sequence[Item]],
    figures_of: Callable[[Sequence[Item]], dict[str, dict[str, Any]]],
    without: str,
) -> dict[str, dict[str, Any]]:
    """Figures of what files hold; the same figures absent where one cannot be read, or where there is none (`without`)."""
    reason = "" if paths else without
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
    for path in _files(folder, "*.ecsv"):
        with path.open(encoding="utf-8") as lines:
            names = next((line.split() for line in lines if not line.startswith("#")), [])
        if all(name in names for name in COMPANION_COLUMNS):
            return _sigmas(Table.read(path, format="ascii.ecsv"))
    return {}


def _sigmas(table: Table) -> dict[int, StatedSigmas]:
    tracklet = np.asarray(table["tracklet_id"], int)
    t = np.asarray(table["epoch_tai_ns"], np.int64)
    sigma = np.stack([np.asarray(table[f"sigma_{name}_arcsec"], float) for name in ("along", "cross")], axis=1)
    sigma = np.where(sigma > 0.0, sigma, np.nan)
    together = np.asarray(table[_TOGETHER], float) if _TOGETHER in table.colnames else np.zeros(len(table))
    stated = np.concatenate([sigma, together[:, None]], axis=1)
    return {
        int(number): StatedSigmas(t_tai_ns=t[tracklet == number], stated=stated[tracklet == number])
        for number in np.unique(tracklet)
    }
