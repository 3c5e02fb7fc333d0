"""Where the files of a run are, and which of them say how far it got."""

import re
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from sboc_e2e.files.atomic import remove_leftovers, require_writable
from sboc_e2e.icd.errors import UserError

STAGES: Final = ("simulate", "onboard", "ground", "score", "report")
_NUMBERED: Final = re.compile(r"(\d{6,})\.")


@dataclass(frozen=True, kw_only=True)
class RunDirectory:
    """The layout of a run directory; creates nothing by itself."""

    path: Path

    @property
    def manifest(self) -> Path:
        """Resolved scenario, versions, stage states and timings."""
        return self.path / "manifest.json"

    @property
    def calibration(self) -> Path:
        """What ground may know of the camera."""
        return self.path / "calibration"

    @property
    def frames(self) -> Path:
        """Kept frames."""
        return self.path / "frames"

    @property
    def truth(self) -> Path:
        """What ground must never see."""
        return self.path / "truth"

    @property
    def downlink(self) -> Path:
        """The packets."""
        return self.path / "downlink.bin"

    @property
    def products(self) -> Path:
        """Ground products."""
        return self.path / "products"

    @property
    def score(self) -> Path:
        """Scores against truth."""
        return self.path / "score.json"

    @property
    def log(self) -> Path:
        """Log with tracebacks of program errors."""
        return self.path / "sboc.log"

    def frame_file(self, frame: int) -> Path:
        """FITS file of a kept frame."""
        return self.frames / f"{frame:06d}.fits"

    def work(self, stage: str) -> Path:
        """Per-frame results of an unfinished stage."""
        return self.path / ".work" / stage

    def work_file(self, stage: str, frame: int, kind: str) -> Path:
        """One per-frame result."""
        return self.work(stage) / f"{frame:06d}.{kind}"

    def numbers(self, stage: str, kind: str) -> list[int]:
        """Frames for which a stage has a result of this kind, rising."""
        folder = self.work(stage)
        if not folder.is_dir():
            return []
        return sorted(int(m.group(1)) for p in folder.glob(f"*.{kind}") if (m := _NUMBERED.match(p.name)))

    def clear_work(self, stage: str) -> None:
        """Forget the per-frame results of a stage, and the work folder when nothing is left in it."""
        folder = self.work(stage)
        if folder.is_dir():
            shutil.rmtree(folder)
        parent = folder.parent
        if parent.is_dir() and not any(parent.iterdir()):
            parent.rmdir()

    def check(self, *, resume: bool | None, force: bool) -> bool:
        """Whether something is there; touches nothing. resume : None where the command cannot go on with a run.

        Raises `UserError` when neither `resume` nor `force` says what to do with it, or when it is no run directory.
        """
        if self.path.exists() and not self.path.is_dir():
            raise UserError(f"{self.path}: is a file; --out takes a directory")
        occupied = self.path.is_dir() and any(self.path.iterdir())
        if occupied and not self.manifest.is_file():
            raise UserError(f"{self.path}: is not empty and holds no run (no manifest.json); choose another --out")
        if occupied and not (resume or force):
            go_on = "" if resume is None else "--resume goes on with it, "
            raise UserError(f"{self.path}: holds a run; {go_on}--force replaces it")
        return occupied

    def prepare(self, *, resume: bool | None, force: bool) -> bool:
        """Make the directory ready after a `check`; True when there is an earlier run of it to resume, else that is removed."""
        occupied = self.check(resume=resume, force=force)
        if occupied and not resume:
            for child in self.path.iterdir():  # the folder stays: it may be the working folder, or a link to elsewhere
                if child.is_dir() and not child.is_symlink():
                    shutil.rmtree(child)
                else:
                    child.unlink()
            occupied = False
        require_writable(self.path)
        if occupied:
            for folder in (self.path, self.frames, self.calibration, self.truth, self.products):
                remove_leftovers(folder)
            for stage in STAGES:
                remove_leftovers(self.work(stage))
        return occupied

    def require(self) -> "RunDirectory":
        """This directory, or a `UserError` when it holds no run."""
        if not self.manifest.is_file():
            raise UserError(f"{self.path}: holds no run (no manifest.json); make one with: sboc run SCENARIO --out {self.path}")
        return self
