"""A ground step that raises or breaks its Protocol stops the run; the error names the seam, the class and the frame."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ground.chain import GroundSteps
from ground.guard import guarded
from sboc_e2e.cli.main import run as command
from sboc_e2e.icd import validate
from sboc_e2e.icd.errors import PluginError, UserError
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.products import Tracklet
from tests.astrometry.star_fields import Field
from tests.astrometry.test_ground_chain import chain_of, fields

__all__ = ["fields"]


@dataclass(frozen=True, kw_only=True)
class Broken:
    """A step of any kind with a bug, or one that returns `answer`."""

    answer: Any = None
    number: int = 1

    def _fail(self, *_: Any, **__: Any) -> Any:
        if self.answer is None:
            raise ZeroDivisionError("oops")
        return self.answer

    fit = probability = initial_state = solve = calibrate = link = estimate = decode = _fail


@dataclass(frozen=True, kw_only=True)
class StartsThenFails:
    """Astrometry that fails at the first frame, not before."""

    answer: Any = None

    def initial_state(self, *_: Any) -> Any:
        """Nothing."""
        return ()

    def solve(self, *_: Any) -> Any:
        """Fails."""
        return Broken(answer=self.answer)._fail()


def linked(*members: tuple[int, tuple[tuple[int, int], ...]]) -> tuple[Tracklet, ...]:
    """Tracklets of given ids and members (frame, streak id)."""
    return tuple(
        Tracklet(
            tracklet_id=number,
            frames=np.array([frame for frame, _ in keys], dtype=np.int64),
            streak_ids=np.array([streak for _, streak in keys], dtype=np.int64),
            t_tai_ns=np.zeros(0, np.int64),
            ra_deg=np.zeros(0),
            dec_deg=np.zeros(0),
            sigma_along_arcsec=np.zeros(0),
            sigma_cross_arcsec=np.zeros(0),
            t_ref_tai_ns=0,
            **dict.fromkeys(("ra_ref_deg", "dec_ref_deg", "rate_deg_s", "rate_err_deg_s", "position_angle_deg"), 0.0),
            **dict.fromkeys(("mag", "mag_err", "chi2_nu", "probability"), 0.5),
            direction_resolved=False,
            flags=StreakFlag.NO_SKY,
        )
        for number, keys in members
    )


CASES: Sequence[tuple[str, Any, str]] = (
    ("astrometry", Broken(), r"ground\.astrometry .*:Broken: ZeroDivisionError: oops"),
    ("astrometry", StartsThenFails(), r"ground\.astrometry .*:StartsThenFails, frame 0: ZeroDivisionError: oops"),
    ("astrometry", StartsThenFails(answer=(1, 2)), r"StartsThenFails, frame 0: expected a state and a FrameSolution"),
    ("photometry", Broken(), r"ground\.photometry .*:Broken, frame 0: ZeroDivisionError: oops"),
    ("photometry", Broken(answer=3.0), r"Broken, frame 0: expected PhotometricSolution, got float"),
    ("streak_fitter", Broken(), r"ground\.streak_fitter .*:Broken, frame 0, region \d+: ZeroDivisionError: oops"),
    ("vetter", Broken(), r"ground\.vetter .*:Broken, frame 0: ZeroDivisionError: oops"),
    ("vetter", Broken(answer=np.array([0.5, 0.5, 0.5])), r"Broken, frame 0: expected 1 probabilities from 0 to 1"),
    ("vetter", Broken(answer=np.array([1.5])), r"Broken, frame 0: expected 1 probabilities from 0 to 1"),
    ("linker", Broken(), r"ground\.linker .*:Broken: ZeroDivisionError: oops"),
    ("linker", Broken(answer=("no tracklet",)), r"ground\.linker .*:Broken: expected Tracklet, got str"),
    (
        "linker",
        Broken(answer=linked((7, ((99, 9_900_000),)))),
        r"Broken, tracklet 7: streak 9900000 of frame 99 is none of those",
    ),
    ("linker", Broken(answer=linked((7, ((0, 5),)))), r"Broken, tracklet 7: streak 5 of frame 0 is none of those given"),
    (
        "linker",
        Broken(answer=linked((7, ((0, 100_000),)))),
        r"Broken, tracklet 7: streak 100000 of frame 0 is none of those given",
    ),
    ("linker", Broken(answer=linked((7, ()))), r"Broken, tracklet 7: expected one or more members"),
    ("linker", Broken(answer=linked((7, ((0, 0),)), (8, ((0, 0),)))), r"Broken, tracklet 8: streak 0 is in tracklet 7 already"),
    ("linker", Broken(answer=linked((7, ((0, 0), (0, 0))))), r"Broken, tracklet 7: streak 0 is in tracklet 7 already"),
    ("linker", Broken(answer=linked((7, ((0, 0),)), (7, ((1, 100_000),)))), r"Broken, tracklet 7: the id of two tracklets"),
    ("orbit", Broken(), r"ground\.orbit .*:Broken, tracklet 0 from frame 0: ZeroDivisionError: oops"),
)


@pytest.mark.parametrize(("seam", "step", "message"), CASES)
def test_faulty_step_stops_the_run_and_is_named(fields: list[Field], seam: str, step: Any, message: str) -> None:
    with pytest.raises(PluginError, match=message):
        _run_with(fields, seam, step)


def _run_with(made: list[Field], seam: str, step: Any) -> None:
    chain = chain_of(made[0], steps_of=lambda steps: _exchanged(steps, seam, step), orbits=True)
    state, products = chain.initial_state(), []
    frames = [field.frame for field in made]
    for frame in frames:
        state, product = chain.process_frame(state, frame)
        products.append(product)
    chain.finish(frames, products)


def _exchanged(steps: GroundSteps, seam: str, step: Any) -> GroundSteps:
    return replace(steps, **{seam: step})


def test_what_the_user_can_mend_passes() -> None:
    """A missing file is the user's to mend; a record that breaks the contract is the step's fault."""

    def missing() -> None:
        raise UserError("no such file")

    with pytest.raises(UserError, match="no such file"):
        guarded("orbit", Broken(), "", object, missing)
    with pytest.raises(PluginError, match=r"ground\.orbit .*:Broken, frame 7: ContractError: "):
        guarded("orbit", Broken(), "frame 7", object, validate.within, "share", 2.0, 0.0, 1.0)


PLUG_IN = '''
from dataclasses import dataclass

@dataclass(frozen=True, kw_only=True)
class Failing:
    """A linker with a bug."""

    def link(self, headers, streaks):
        """Fails."""
        raise KeyError("oops")
'''


@pytest.mark.slow
def test_exit_code_and_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """On the command line: exit code 3, one line with the plug-in's name, traceback in a log file."""
    from tests.end_to_end.conftest import tiny

    (tmp_path / "failing_linker.py").write_text(PLUG_IN)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.chdir(tmp_path)
    path = tiny(tmp_path)
    out = ["--set", 'ground.linker.use="failing_linker:Failing"', "--plugin", "failing_linker", "--out", str(tmp_path / "run")]
    assert command(["run", str(path), *out]) == 3
    complaint = capsys.readouterr().err.strip().splitlines()[-1]
    assert complaint.startswith("sboc: ground.linker failing_linker:Failing: KeyError: 'oops' (traceback in ")
