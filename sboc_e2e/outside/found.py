"""What was found in frames from outside, without truth: counts, image quality, solutions, as rows of name, value and note."""

import json
from dataclasses import dataclass, field
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Any, Final

import numpy as np
from astropy.table import Table
from numpy.typing import NDArray

from sboc_e2e.icd.errors import UserError
from sboc_e2e.outside.look_alikes import FWHM_PER_SIGMA
from sboc_e2e.report.words import Row, number
from sboc_e2e.run.directory import RunDirectory
from sboc_e2e.run.manifest import Manifest
from sboc_e2e.view.run_frames import RunFrames, ShownFrame, is_published

NOISE_FRAMES: Final = 24
"""Frames whose noise is measured, as many as the page shows. Each must be read again; a median of more changes little. Chosen."""
DIRECTIONS: Final = (
    "Directions of streaks keep the annual aberration (up to 20.5 arcsec from the place by the WCS) and the light time. "
    "They keep the aberration of the observer's own motion too where its velocity is not known."
)


@dataclass(frozen=True, kw_only=True)
class RunFound:
    """Published tables of a run of `sboc process`, and what its ingest noted."""

    run: RunFrames
    _last: dict[str, Any] = field(default_factory=dict, init=False, repr=False, compare=False)

    @classmethod
    def of(cls, path: Path) -> "RunFound":
        """Of a run directory. Raises `UserError` where products are absent."""
        return cls(run=RunFrames(path=path))

    @cached_property
    def ingest(self) -> dict[str, Any]:
        """products/ingest.json."""
        return dict(json.loads((self.run.path / "products" / "ingest.json").read_text(encoding="utf-8")))

    @cached_property
    def published(self) -> NDArray[np.bool_]:
        """Which rows of the streaks are published, (n,)."""
        return np.array([is_published(row) for row in self.run.streaks], dtype=bool)

    @property
    def n_tracklets(self) -> int:
        """Objects that were followed over several frames."""
        linked = np.asarray(self.run.streaks["tracklet_id"])
        return len(np.unique(linked[linked >= 0]))

    def rows(self) -> list[Row]:
        """Figures of the run."""
        frames, streaks = self.run.frames, self.run.streaks
        n, n_published = len(frames), int(self.published.sum())
        left_out = len(self.ingest.get("outside", {}).get("left_out", ()))
        wrong = float(np.sum(1.0 - np.asarray(streaks["probability"], dtype=float)[self.published]))
        return [
            ("frames", number(n), f"{left_out} files or planes left out" if left_out else ""),
            ("streaks published", number(n_published), _each(n_published, n)),
            ("... expected to be false", f"{wrong:.2f}", "sum of 1 - probability over the published ones"),
            ("... look-alikes in the negative", *self._look_alikes()),
            ("streaks measured and rejected", number(len(streaks) - n_published), _each(len(streaks) - n_published, n)),
            ("tracklets", number(self.n_tracklets), ""),
            ("stars found in a frame", *_median(frames, "n_stars_found", least=0.0)),
            ("PSF, FWHM (px)", *_median(frames, "psf_sigma_px", least=1e-6, factor=FWHM_PER_SIGMA)),
            ("noise of a pixel (ADU)", *self._noise),
            ("frames solved on the sky", number(int(np.sum(frames["solved"]))), f"of {n}"),
            ("stars in a solution", *_median(frames[np.asarray(frames["solved"], dtype=bool)], "n_stars", least=1.0)),
            ("residual of its stars (px)", *_median(frames, "rms_px", least=0.0)),
            ("frames with a zero point", number(int(np.sum(np.asarray(frames["n_phot"]) > 0))), f"of {n}"),
        ]

    def _look_alikes(self) -> tuple[str, str]:
        """Lines that the search finds in the negatives of the frames, where nothing is real: what it finds falsely."""
        counts = [frame.get("look_alikes") for frame in self.ingest.get("outside", {}).get("frames", ())]
        counts = [each for each in counts if each]
        if not counts:
            return "-", "no negative was searched"
        in_all = {key: sum(each[key] for each in counts) for key in counts[0]}
        levels = sorted(int(key.removeprefix("snr_")) for key in in_all if key != "all")
        words = ", ".join(f"{in_all[f'snr_{level}']} at S/N >= {level}" for level in levels)
        return number(in_all["all"]), f"{_each(in_all['all'], len(counts))}; {words}"

    @cached_property
    def _noise(self) -> tuple[str, str]:
        """Median over some frames of the scatter of neighbouring pixels' differences, over the square root of two."""
        levels = []
        for frame in islice(self.run, NOISE_FRAMES):
            image = self.image(frame)
            if image is not None and image.shape[1] > 1:
                difference = np.diff(image[:: max(1, image.shape[0] // 256)], axis=1)
                levels.append(np.subtract(*np.nanpercentile(difference, [75.0, 25.0])) / 1.349 / np.sqrt(2.0))
        if not levels:
            return "-", "the files of the frames are not where they were"
        return number(float(np.median(levels))), f"median of {len(levels)} frames, from neighbouring pixels"

    def image(self, frame: ShownFrame) -> NDArray[np.float32] | None:
        """Pixels of a frame, see `image_of`; the last one that was asked for stays in memory."""
        if self._last.get("number") != frame.number:
            self._last.update(number=frame.number, image=image_of(frame))
        return self._last["image"]

    def lacking(self) -> list[str]:
        """What products lack, what headers lack, what was left out: a sentence each."""
        outside = self.ingest.get("outside", {})
        notes: dict[str, int] = {}
        for frame in outside.get("frames", ()):
            for note in frame["notes"]:
                notes[note] = notes.get(note, 0) + 1
        n = len(self.run.frames)
        return [
            *self.ingest.get("products_lack", ()),
            *(f"{count} of {n} frames: {note}" for note, count in notes.items()),
            *(f"left out: {text}" for text in outside.get("left_out", ())),
        ]


def image_of(frame: ShownFrame) -> NDArray[np.float32] | None:
    """Pixels as float32; None where they are not there any more or are no single image."""
    try:
        pixels = frame.pixels()
    except UserError:
        return None
    return np.ascontiguousarray(pixels, dtype=np.float32) if pixels is not None and pixels.ndim == 2 else None


def is_unscored(run_dir: Path) -> bool:
    """Whether a directory holds a run of `sboc process` that was never held against truth. Raises `UserError` without a run."""
    manifest = Manifest.read(RunDirectory(path=run_dir).require().manifest)
    return "simulate" not in manifest.stages and not manifest.done("score") and "ground" in manifest.stages


def closing_text(found: RunFound) -> str:
    """Lines for a terminal, without a newline at the end."""
    rows = found.rows()
    width = max(len(label) for label, _, _ in rows)
    lines = [f"{label:<{width}}  {value}{f'  ({note})' if note else ''}" for label, value, note in rows]
    return "\n".join([*lines, DIRECTIONS])


def _each(n: int, frames: int) -> str:
    return f"{n / frames:.2f} a frame" if frames else ""


def _median(table: Table, name: str, *, least: float, factor: float = 1.0) -> tuple[str, str]:
    """Median of a column's known values, and of how many frames."""
    values = factor * np.asarray(table[name], dtype=float)
    values = values[np.isfinite(values) & (values >= least)]
    if not values.size:
        return "-", "not measured in any frame"
    return number(float(np.median(values))), f"median of {values.size} frames"
