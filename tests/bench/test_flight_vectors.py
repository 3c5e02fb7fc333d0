"""The on-board stages give what the golden vectors say: whole numbers to the bit, floating-point ones as far as processors agree.

Compiled code sums in another order, and fuses other products, on another x86-64 processor of the same versions.
"""

from pathlib import Path

import numpy as np
import pytest

from sboc_e2e.bench.flight_vectors import STAGES, Stage, read

ANEW = "if that is meant: python -m sboc_e2e.bench.flight_vectors tests/golden/flight"
FOLDER = Path(__file__).resolve().parents[1] / "golden" / "flight"


@pytest.mark.parametrize("stage", STAGES, ids=lambda stage: stage.name)
@pytest.mark.slow
def test_a_stage_gives_what_is_stored(stage: Stage) -> None:
    given, wanted = read(FOLDER / f"{stage.name}.npz")
    got = stage.run(given)
    assert got.keys() == wanted.keys()
    for name, array in wanted.items():
        assert (got[name].dtype, got[name].shape) == (array.dtype, array.shape), name
        if array.dtype.kind == "f":
            # sums of float32 in another order differ by the rounding of the largest sum, also where they cancel to a small one
            rounding = max(1e-6, float(np.finfo(np.float32).eps) * float(np.abs(array).max(initial=0.0)))
            np.testing.assert_allclose(got[name], array, rtol=1e-6, atol=rounding, err_msg=f"{stage.name}: {name}; {ANEW}")
        else:
            assert got[name].tobytes() == array.tobytes(), f"{stage.name}: {name}; {ANEW}"


def test_the_vectors_show_something_in_little_room() -> None:
    stored = list(FOLDER.iterdir())
    assert {path.stem for path in stored} == {stage.name for stage in STAGES}
    assert sum(path.stat().st_size for path in stored) <= 300_000
    found = read(FOLDER / "packets.npz")[1]["detections"]
    assert set(found[:, 0]) == {0.0, 1.0}
    assert len(read(FOLDER / "lines.npz")[1]["candidates"]) > 0
    assert np.count_nonzero(read(FOLDER / "stars.npz")[1]["snr"] > 8.0) >= 10
