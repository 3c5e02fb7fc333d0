"""The frames of a run with what was measured in each: pixels from where they lie, rows of the published tables."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from astropy.io import fits
from astropy.table import Table
from numpy.typing import NDArray

from sboc_e2e.files import ecsv
from sboc_e2e.icd.errors import UserError
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.run.manifest import Manifest


@dataclass(frozen=True, kw_only=True)
class ShownFrame:
    """A frame: its number, the FITS file and HDU that hold its pixels (None: not kept), its streaks and stars."""

    number: int
    file: Path | None
    hdu: int
    streaks: Table
    stars: Table

    @property
    def name(self) -> str:
        """Name of what is written for it, without suffix."""
        return f"{self.number:06d}"

    def pixels(self) -> NDArray[Any] | None:
        """(rows, cols) as stored; None where they are not kept. Raises `UserError` for a file that cannot be read."""
        if self.file is None:
            return None
        try:
            return np.asarray(fits.getdata(self.file, self.hdu))
        except (OSError, IndexError, TypeError) as error:
            raise UserError(f"{self.file}, HDU {self.hdu}: cannot be read; is it still the file that was processed?") from error


@dataclass(frozen=True, kw_only=True)
class RunFrames:
    """A run directory with products, of a scenario or of `sboc process`."""

    path: Path

    def __post_init__(self) -> None:
        for name in ("manifest.json", "products/frames.ecsv", "products/streaks.ecsv", "products/stars.ecsv"):
            if not (self.path / name).is_file():
                raise UserError(f"{self.path}: has no {name}; `sboc run` or `sboc process` make it")

    @cached_property
    def frames(self) -> Table:
        """products/frames.ecsv."""
        return self._table("frames")

    @cached_property
    def streaks(self) -> Table:
        """products/streaks.ecsv."""
        return self._table("streaks")

    @cached_property
    def stars(self) -> Table:
        """products/stars.ecsv."""
        return self._table("stars")

    def _table(self, name: str) -> Table:
        """Raises `UserError` for a damaged file."""
        return ecsv.read(self.path / "products" / f"{name}.ecsv")

    @cached_property
    def _source(self) -> Path | None:
        """Folder of the FITS files that `sboc process` read. Raises `UserError` for a damaged manifest."""
        folder = Manifest.read(self.path / "manifest.json").sources.get("frames")
        return Path(folder) if isinstance(folder, str) else None

    def __iter__(self) -> Iterator[ShownFrame]:
        """Frames in the order of their table."""
        streak_frame, star_frame = np.asarray(self.streaks["frame"]), np.asarray(self.stars["frame"])
        for row in self.frames:
            number = int(row["frame"])
            file, hdu = self._place(row)
            yield ShownFrame(
                number=number,
                file=file,
                hdu=hdu,
                streaks=self.streaks[streak_frame == number],
                stars=self.stars[star_frame == number],
            )

    def _place(self, row: Any) -> tuple[Path | None, int]:
        """File and HDU of a frame's pixels."""
        if "file" not in self.frames.colnames:
            kept = self.path / "frames" / f"{int(row['frame']):06d}.fits"
            return (kept if kept.is_file() else None), 0
        file = None if self._source is None else self._source / str(row["file"])
        return (file if file is not None and file.is_file() else None), int(row["hdu"])


def is_published(streak: Any) -> bool:
    """Whether a row of the streaks is published."""
    return not int(streak["flags"]) & int(StreakFlag.VETOED)
