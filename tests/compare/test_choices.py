"""What is asked of a comparison is judged before anything is simulated."""

from pathlib import Path

import pytest

from sboc_e2e.compare import Request, compare
from sboc_e2e.icd.errors import UserError


@pytest.mark.parametrize(
    ("choices", "overrides", "words"),
    [
        (("threshold", "treshold"), (), '"treshold"'),
        (("threshold", "lsd"), ("ground.catalogue_file=none.npz",), "none.npz"),
        (("threshold",), (), "two or more"),
        (("threshold", "lsd", "threshold"), (), "each of them once"),
    ],
)
def test_a_choice_that_cannot_run_costs_nothing(
    tmp_path: Path, choices: tuple[str, ...], overrides: tuple[str, ...], words: str
) -> None:
    out = tmp_path / "versus"
    with pytest.raises(UserError, match=words):
        compare(Request(scenario="smoke", seam="onboard.detector", choices=choices, overrides=overrides), out)
    assert not out.exists()
