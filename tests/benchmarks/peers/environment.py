"""Where the peers live and how one of them is asked: JSON to its standard input, JSON from a file that it writes."""

import json
import os
import subprocess
import tempfile
from pathlib import Path
from typing import Any, Final

ROOT: Final = Path(__file__).resolve().parents[3]
FOLDER: Final = ROOT / ".peers"
PYTHON: Final = FOLDER / "bin" / "python"
HOW: Final = "not installed; python -m tests.benchmarks.peers.install makes the environment"
ONE_THREAD: Final = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "TF_NUM_INTRAOP_THREADS", "TF_NUM_INTEROP_THREADS"), "1"
)


class PeerError(RuntimeError):
    """A peer is absent or failed; the text says why, for a figure without a value."""


def ask(script: str, question: dict[str, Any], timeout_s: float = 900.0) -> dict[str, Any]:
    """The answer of a script of this folder, run by the peers' interpreter. Raises `PeerError`."""
    if not PYTHON.exists():
        raise PeerError(HOW)
    with tempfile.TemporaryDirectory() as folder:
        answer = Path(folder) / "answer.json"
        command = [str(PYTHON), str(Path(__file__).with_name(f"{script}.py")), str(answer)]
        environment = os.environ | ONE_THREAD | {"TF_CPP_MIN_LOG_LEVEL": "3", "CUDA_VISIBLE_DEVICES": "-1"}
        try:
            done = subprocess.run(
                command,
                input=json.dumps(question),
                env=environment,
                capture_output=True,
                text=True,
                timeout=timeout_s,
                check=False,
            )
        except subprocess.TimeoutExpired as error:
            raise PeerError(f"no answer within {timeout_s:g} s") from error
        if done.returncode != 0 or not answer.exists():
            last = (done.stderr.strip().splitlines() or ["no output"])[-1]
            raise PeerError(f"failed: {last[:200]}")
        return dict(json.loads(answer.read_text()))


def absent(error: Exception) -> dict[str, Any]:
    """A figure without a value."""
    return {"value": None, "n": 0, "reason": str(error)[:300]}


def spread(values: list[float]) -> dict[str, Any]:
    """Median of repeats with their range."""
    ordered = sorted(values)
    return {"value": ordered[len(ordered) // 2], "n": len(ordered), "low": ordered[0], "high": ordered[-1]}
