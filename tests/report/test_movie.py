"""A run as a short movie."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from sboc_e2e.cli.main import run
from sboc_e2e.report.movie import COLOURS, GREYS, MISSED, TRUE, write_movie


def test_a_movie_has_the_kept_frames_with_truth_over_them(reported_run: Path, tmp_path: Path) -> None:
    target = tmp_path / "run.gif"
    assert write_movie(reported_run, target) == 4
    with Image.open(target) as movie:
        assert movie.n_frames == 4
        seen = np.asarray(movie.convert("RGB"), float).reshape(-1, 3)
    for colour in (COLOURS[TRUE - GREYS], COLOURS[MISSED - GREYS]):
        assert (seen == colour).all(axis=1).any()


def test_another_kind_of_file_is_refused(reported_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["report", str(reported_run), "--movie", str(tmp_path / "run.mp4")]) == 2
    assert "ends in .gif" in capsys.readouterr().err
