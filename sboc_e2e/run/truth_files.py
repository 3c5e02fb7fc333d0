"""truth/ of a run: per-frame truth joined into ECSV tables with the columns of `sboc_e2e.truth`."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.files import ecsv
from sboc_e2e.files.atomic import write_json
from sboc_e2e.run.directory import RunDirectory
from sboc_e2e.truth import TABLES, FrameTruth

META = (("contract", "columns, units and meanings: sboc_e2e/truth.py"),)


def columns(table: str) -> list[ecsv.TableColumn]:
    """Columns of a truth table."""
    return [ecsv.column(c.name, c.dtype, c.unit, c.text) for c in TABLES[table]]


def write(
    run: RunDirectory,
    truth_of: Callable[[int], FrameTruth],
    n_frames: int,
    objects: NDArray[np.void],
    population: dict[str, Any],
) -> None:
    """Join the truth of all frames, one table after the other, holding one frame in memory."""

    def parts(pick: Callable[[FrameTruth], NDArray[np.void]]) -> Iterator[NDArray[np.void]]:
        for frame in range(n_frames):
            yield pick(truth_of(frame))

    ecsv.write_parts(run.truth / "frames.ecsv", columns("frames"), parts(lambda t: np.atleast_1d(t.frame)), META)
    ecsv.write_parts(run.truth / "stars.ecsv", columns("stars"), parts(lambda t: t.stars), META)
    ecsv.write_parts(run.truth / "streaks.ecsv", columns("streaks"), parts(lambda t: t.streaks), META)
    ecsv.write_parts(run.truth / "cosmics.ecsv", columns("cosmics"), parts(lambda t: t.cosmics), META)
    ecsv.write(run.truth / "objects.ecsv", columns("objects"), objects, META)
    write_json(run.truth / "population.json", population)
