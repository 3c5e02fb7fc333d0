"""Conjunction data messages: read as their standard says, written so that an independent reader takes them, refused by name."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ground.conjunctions.cdm import MessageObject, cdm_text, new_message, read_cdm, rtn_axes
from ground.conjunctions.encounter import StateEstimate
from sboc_e2e.cli.main import run
from sboc_e2e.icd.errors import UserError
from sboc_e2e.objects.conjunctions import assess_message, assessment_lines
from tests.conjunctions.reference import folder


def example() -> str:
    """A message of our own making."""
    covariance = np.diag([1e-4, 4e-2, 1e-4, 1e-10, 1e-10, 1e-10])
    covariance[0, 4] = covariance[4, 0] = -3e-8
    first = StateEstimate(name="A", state=np.array([7000.0, 10.0, -5.0, 0.1, 7.5, 0.2]), covariance=covariance)
    second = StateEstimate(name="B", state=np.array([7000.05, 10.1, -5.0, 0.1, -0.2, 7.5]), covariance=2.0 * covariance)
    message = new_message(
        MessageObject(designator="00001", name="A", international="2001-001A", estimate=first),
        MessageObject(designator="00002", name="B", international="2002-002B", estimate=second, comments=("own orbit",)),
        tca_tai_ns=2_000_000_000_123_000_000,
        created_tai_ns=1_999_990_000_000_000_000,
        originator="TEST",
        hard_body_km=0.012,
        probability=1.5e-4,
        method="ALFANO-2005",
    )
    return cdm_text(message)


def test_caras_messages_come_back_as_they_were() -> None:
    paths = sorted(folder("cdm").glob("*.cdm"))
    for path in paths:
        text = path.read_text()
        message = read_cdm(text, path.name)
        again = read_cdm(cdm_text(message), path.name)

        def squeezed(lines: str) -> list[str]:
            return [re.sub(r"\s+", " ", line.strip()) for line in lines.splitlines() if line.strip()]

        assert squeezed(cdm_text(message)) == squeezed(text)
        np.testing.assert_array_equal(again.first.covariance, message.first.covariance)
    assert len(paths) == 53


def test_what_is_written_is_read_back_to_the_micrometre() -> None:
    message = read_cdm(example(), "m")
    assert message.hard_body_km == pytest.approx(0.012)
    np.testing.assert_allclose(message.first.state, [7000.0, 10.0, -5.0, 0.1, 7.5, 0.2], rtol=0, atol=1e-9)
    assert message.first.covariance[0, 4] == pytest.approx(-3e-8, rel=1e-6)
    assert message.first.covariance[1, 1] == pytest.approx(4e-2, rel=1e-9)
    assert message.second.name == "B (00002)"


def test_an_independent_reader_takes_it() -> None:
    ndm = pytest.importorskip("ccsds_ndm.ndm_io", reason="ccsds-ndm is the oracle")
    parsed = ndm.NdmIo().from_string(example())
    first = parsed.body.segment[0].data
    assert float(first.state_vector.x.value) == pytest.approx(7000.0)
    assert float(first.covariance_matrix.ct_t.value) == pytest.approx(4e4, rel=0.02)


def test_axes_are_radial_transverse_normal() -> None:
    np.testing.assert_allclose(rtn_axes(np.array([7000.0, 0, 0, 1.0, 7.0, 0])), np.eye(3), atol=1e-12)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: "", "empty; expected a conjunction message"),
        (lambda t: '<?xml version="1.0"?>\n' + t, 'line 1: expected "KEYWORD = value"'),
        (lambda t: "ORIGINATOR = X\n" + t, "the first keyword is not CCSDS_CDM_VERS"),
        (lambda t: re.sub(r"(CCSDS_CDM_VERS .*= )1.0", r"\g<1>2.0", t), "CCSDS_CDM_VERS 2.0: expected 1.0"),
        (lambda t: t.replace("EME2000", "ITRF"), 'REF_FRAME "ITRF" is not computed with; expected EME2000 or GCRF'),
        (lambda t: re.sub(r"REF_FRAME .*\n", "", t, count=1), "OBJECT1: REF_FRAME is missing"),
        (lambda t: re.sub(r"TCA  .*\n", "", t), "TCA is missing"),
        (lambda t: re.sub(r"(CT_T .*= )\S+", r"\g<1>-4e4", t, count=1), "OBJECT1: covariance of the position: not positive"),
        (lambda t: re.sub(r"(CT_T .*= )\S+", r"\g<1>nan", t, count=1), 'CT_T: "nan" is no finite number'),
        (lambda t: t.replace("[m**2/s]", "[km**2/s]"), r"in \[km\*\*2/s\]; the standard has \[m\*\*2/s\]"),
        (lambda t: t[: t.index("OBJECT2")] + "\n", "OBJECT has no value"),
        (lambda t: t.replace("= OBJECT2", "= OBJECT1"), "OBJECT: expected OBJECT2"),
        (lambda t: re.sub(r"(\nX  .*= )\S+", r"\g<1>70.0", t, count=1), "are no orbit about the Earth"),
        (lambda t: t.replace("HBR = 12", "HBR = 0"), "HBR: expected more than 0 m"),
        (lambda t: t + "X = 1 [km]\n", "OBJECT2: X twice"),
    ],
)  # fmt: skip
def test_what_is_broken_is_refused_by_name(change, words: str) -> None:
    with pytest.raises(UserError, match=words):
        read_cdm(change(example()), "m")


def test_the_command_judges_and_writes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "one.cdm"
    path.write_text(example())
    assert run(["conjunctions", "assess", str(path), "--out", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr().out
    assert "probability" in printed
    assert "two-dimensional" in printed
    judged = read_cdm((tmp_path / "out" / "one.cdm").read_text(), "judged")
    assert judged.text_of("COLLISION_PROBABILITY_METHOD") == "ALFANO-2005"


def test_the_command_prints_no_form_where_it_is_not_valid(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "one.cdm"
    path.write_text(example())
    # the shorter error is 17 m
    assert run(["conjunctions", "assess", str(path), "--hard-body", "3000"]) == 0
    assert "Foster not valid, Chan not valid" in capsys.readouterr().out


def test_forms_of_the_plane_are_said_not_to_stand_where_they_do_not(tmp_path: Path) -> None:
    path = tmp_path / "one.cdm"
    path.write_text(example())
    message, judged = assess_message(path, None, 1000)
    assert "  two-dimensional: Alfano" in "\n".join(assessment_lines(message, judged))
    bent = replace(judged, stands="curved")
    assert "  two-dimensional, does not stand: Alfano" in "\n".join(assessment_lines(message, bent))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["none.cdm"], "none.cdm: no such file"),
        (["."], "is a folder"),
        (["one.cdm", "--hard-body", "-3"], "expected more than 0"),
    ],
)
def test_the_command_says_in_one_line_what_is_wrong(
    arguments: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "one.cdm").write_text(example())
    assert run(["conjunctions", "assess", *arguments]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
