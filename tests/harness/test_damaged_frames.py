"""Faults that would change nothing, and files of states with random damage."""

from pathlib import Path

import numpy as np
import pytest

from sboc_e2e.faults import damaged_frame
from sboc_e2e.faults.options import FaultOptions, PixelFaults
from sboc_e2e.files import checkpoint
from sboc_e2e.icd.errors import UserError
from sboc_e2e.icd.frame import Frame, FrameHeader

TRIALS = 4000


def test_a_stuck_column_beyond_the_frame_is_refused() -> None:
    header = FrameHeader(frame=0, t_start_tai_ns=0, exposure_ns=1, line_time_ns=0, rows=4, cols=6)
    frame = Frame(header=header, pixels=np.zeros((4, 6), dtype=np.uint16))

    def damaged(column: int) -> Frame:
        return damaged_frame(frame, FaultOptions(pixels=PixelFaults(stuck_column=column, stuck_level_adu=9)), 1)

    assert damaged(-1) is frame
    assert np.flatnonzero(damaged(5).pixels.any(axis=0)).tolist() == [5]
    with pytest.raises(UserError, match=r"stuck_column: expected -1 to 5 in frames of 4 x 6 px, got 6"):
        damaged(6)


def test_random_damage_of_a_checkpoint_is_a_value_or_one_line(tmp_path: Path) -> None:
    whole = checkpoint.to_bytes({"a": np.arange(5), "b": [1.5, None, "text", (2, True)]})
    rng = np.random.default_rng(7)
    path = tmp_path / "state.npz"
    refused = 0
    for _ in range(TRIALS):
        data = bytearray(whole)
        for at in rng.integers(0, len(data), rng.integers(1, 4)):
            data[at] = rng.integers(0, 256)
        path.write_bytes(data)
        try:
            checkpoint.load(path)
        except UserError as error:
            assert "not a checkpoint of this program" in str(error)
            refused += 1
    assert refused > TRIALS // 2
