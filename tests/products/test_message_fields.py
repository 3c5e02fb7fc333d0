"""The tracking message field by field, against the standard's words and a message that three independent readers take.

reference.tdm with reference.oem: Orekit 13.1, ccsds-ndm 3.1 and ccsds-ndm-py read them, write them and read them again without
loss; angles and comments in them are invented, their keywords, order, spacing and number formats are what is compared.
"""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ground.options import ProductOptions
from ground.products.oem import oem_text
from ground.products.tdm import tdm_text
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.frame import FrameHeader, ObserverState
from sboc_e2e.icd.products import Tracklet
from tests.link.sky_scene import Camera, streak
from tests.products.ndm_reader import read

HERE = Path(__file__).parent
T0_TAI_NS = 2_179_872_037_000_000_000
"""2027-01-29T00:00:00 UTC, 37 s behind TAI."""
STEP_NS = 250_000_000
MAGNITUDES = (11.25, 11.5, 11.375)


def headers() -> list[FrameHeader]:
    """Three frames with the observer's state."""
    return [
        FrameHeader(
            frame=k, t_start_tai_ns=T0_TAI_NS + k * STEP_NS, exposure_ns=200_000_000, line_time_ns=0, rows=64, cols=64,
            observer=ObserverState(
                tai_ns=T0_TAI_NS + k * STEP_NS, position_m=np.array([7.078e6, 1.5e3 * k, 0.0]),
                velocity_m_s=np.array([0.0, 1200.0, 7300.0]), sigma_position_m=10.0, sigma_velocity_m_s=0.1,
            ),
        )
        for k in range(3)
    ]  # fmt: skip


def tracklet(number: int, probability: float = 0.99) -> Tracklet:
    """One direction in each of three frames."""
    return Tracklet(
        tracklet_id=number, streak_ids=np.arange(3), frames=np.arange(3), t_tai_ns=T0_TAI_NS + STEP_NS * np.arange(3),
        ra_deg=np.array([57.1, 57.6, 58.1]), dec_deg=np.array([19.9, 20.0, 20.1]), sigma_along_arcsec=np.full(3, 0.5),
        sigma_cross_arcsec=np.full(3, 0.25), t_ref_tai_ns=T0_TAI_NS, ra_ref_deg=57.0, dec_ref_deg=20.0, rate_deg_s=2.0,
        rate_err_deg_s=0.01, position_angle_deg=10.0, mag=11.4, mag_err=0.1, chi2_nu=1.0, probability=probability,
        direction_resolved=True, flags=StreakFlag(0),
    )  # fmt: skip


def message(*tracklets: Tracklet) -> str:
    """The message of tracklets, each with a streak and a magnitude in every frame."""
    ends = np.array([[10.0, 10.0], [20.0, 40.0]])
    members = [
        [
            replace(
                streak(Camera(), k, k, ends, 0.3, 0.1, StreakFlag(0)),
                tracklet_id=one.tracklet_id, mag=mag, t_tai_ns=np.full(3, T0_TAI_NS + k * STEP_NS),
            )
            for k, mag in enumerate(MAGNITUDES)
        ]
        for one in tracklets
    ]  # fmt: skip
    return tdm_text(tracklets, members, headers(), ProductOptions(), oem_name="observer.oem")


def segments(text: str) -> list[list[str]]:
    """Lines of each segment."""
    return [part.splitlines() for part in re.findall(r"META_START\n.*?DATA_STOP", text, flags=re.DOTALL)]


def keywords(lines: list[str]) -> list[str]:
    """Keywords in order, comments left out; a data line counts once for its keyword."""
    found = [line.split("=")[0].strip() for line in lines if line and not line.startswith("COMMENT")]
    return list(dict.fromkeys(found))


def plain(value: object) -> str:
    """Text of a field that the reader may have wrapped in an enumeration or a unit."""
    return str(getattr(value, "value", value))


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("track_id", "SBOC-T000017"),
        ("data_types", "ANGLE_1,ANGLE_2,MAG"),
        ("time_system", "UTC"),
        ("start_time", "2027-01-29T00:00:00.000000"),
        ("stop_time", "2027-01-29T00:00:00.500000"),
        ("participant_1", "SBOC-1"),
        ("participant_2", "UCT-000017"),
        ("mode", "SEQUENTIAL"),
        ("path", "2,1"),
        ("ephemeris_name_1", "observer.oem"),
        ("timetag_ref", "RECEIVE"),
        ("angle_type", "RADEC"),
        ("reference_frame", "EME2000"),
        ("data_quality", "VALIDATED"),
    ],
)
def test_metadata_as_the_independent_reader_gets_it(tmp_path: Path, field: str, value: str) -> None:
    """The receiver is participant 1, so that light goes 2,1 without a space; axes and epochs are named."""
    (segment,) = read(message(tracklet(17)), tmp_path).body.segment
    assert plain(getattr(segment.metadata, field)) == value


def test_header_as_the_independent_reader_gets_it(tmp_path: Path) -> None:
    """Version 2.0; the creation date is the last frame's epoch, so that bytes repeat."""
    made = read(message(tracklet(17)), tmp_path)
    assert made.version == "2.0"
    assert made.header.originator == "SBOC"
    assert plain(made.header.creation_date) == "2027-01-29T00:00:00.500"


def test_nothing_that_was_not_done_is_declared(tmp_path: Path) -> None:
    """No correction field: annual aberration is left in, and what was removed has no field but a comment."""
    text = message(tracklet(17))
    assert "CORRECTION" not in text
    (segment,) = read(text, tmp_path).body.segment
    for field in ("correction_aberration_yearly", "correction_aberration_diurnal", "corrections_applied", "correction_mag"):
        assert getattr(segment.metadata, field) is None
    comments = "\n".join(segment.metadata.comment)
    assert "aberration of the observer's geocentric velocity removed" in comments
    assert "annual aberration NOT removed" in comments
    assert "light time NOT removed" in comments
    assert "EME2000 axes" in comments
    assert "photon reception times at the row" in comments
    assert "Johnson V" in comments
    assert "arcsec" in comments


def test_magnitudes_stand_at_the_middle_of_each_exposure(tmp_path: Path) -> None:
    """One MAG for each streak that has one, in order of time; without any, neither data nor their type."""
    (segment,) = read(message(tracklet(17)), tmp_path).body.segment
    seen = [(plain(row.epoch), float(plain(row.mag))) for row in segment.data.observation if row.mag is not None]
    assert [mag for _, mag in seen] == list(MAGNITUDES)
    assert [epoch for epoch, _ in seen] == [f"2027-01-29T00:00:00.{250 * k:03d}000" for k in range(3)]
    bare = tdm_text([tracklet(17)], [[]], headers(), ProductOptions(), oem_name="observer.oem")
    assert "MAG =" not in bare
    assert "DATA_TYPES = ANGLE_1,ANGLE_2\n" in bare


def test_one_segment_for_each_tracklet_and_quality_by_probability(tmp_path: Path) -> None:
    """Three tracklets, three segments with three epochs each; one that is not sure says DEGRADED."""
    made = read(message(tracklet(1), tracklet(2, probability=0.5), tracklet(3)), tmp_path).body.segment
    assert [plain(segment.metadata.track_id) for segment in made] == [f"SBOC-T{k:06d}" for k in (1, 2, 3)]
    assert [plain(segment.metadata.data_quality) for segment in made] == ["VALIDATED", "DEGRADED", "VALIDATED"]
    for segment in made:
        assert sum(row.angle_1 is not None for row in segment.data.observation) == 3
        assert sum(row.angle_2 is not None for row in segment.data.observation) == 3


def test_structure_is_that_of_the_message_which_all_readers_take() -> None:
    """The same keywords in the same order in header, metadata and data; MESSAGE_ID, which is optional, apart."""
    reference, made = (HERE / "reference.tdm").read_text(), message(tracklet(17))
    heads = [keywords(text.partition("META_START")[0].splitlines()) for text in (reference, made)]
    assert [key for key in heads[0] if key != "MESSAGE_ID"] == heads[1]
    (ours,), (theirs,) = segments(made), segments(reference)
    assert keywords(ours) == keywords(theirs)
    value = {key: (re.compile(pattern)) for key, pattern in (
        ("START_TIME", r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{6}"), ("PATH", "2,1"), ("TRACK_ID", r"\w+-T\d{6}"),
        ("DATA_TYPES", "ANGLE_1,ANGLE_2,MAG"), ("ANGLE_1", r"\S{26} \d+\.\d{9,}"), ("ANGLE_2", r"\S{26} -?\d+\.\d{9,}"),
        ("MAG", r"\S{26} \d+\.\d{2,}"),
    )}  # fmt: skip
    for lines in (ours, theirs):
        assert "" not in lines
        for line in lines:
            key, _, text = line.partition(" = ")
            assert key not in value or value[key].fullmatch(text), line


def test_observer_message_has_the_structure_of_the_reference() -> None:
    """Keywords of header and metadata in order, and states of seven columns."""
    made = oem_text(headers(), ProductOptions())
    assert made is not None
    tables = []
    for text in ((HERE / "reference.oem").read_text(), made):
        lines = text.partition("COVARIANCE_START")[0].splitlines()
        fields = [line.split(" = ")[0] for line in lines if ("=" in line or line.startswith("META")) and "COMMENT" not in line]
        rows = [line for line in lines if line[:2] == "20"]
        assert all(len(row.split()) == 7 for row in rows)
        tables.append(fields)
    assert tables[0] == tables[1]


@pytest.mark.parametrize(
    ("line_time_ns", "start", "stop"), [(-10_000_000, "28T23:59:59", "29T00:00:01"), (10_000_000, "29T00:00:00", "29T00:00:02")]
)
def test_observer_message_spans_every_row_of_the_frames(line_time_ns: int, start: str, stop: str) -> None:
    """Frames of 64 rows start 0, 0.25 and 0.5 s after midnight, for 0.2 s. Row 63 starts 0.63 s before row 0, or after it.

    So the first row opens at -0.63 s and the last closes at 0.7 s, or at 0 and 1.33 s.
    """
    made = oem_text([replace(h, line_time_ns=line_time_ns) for h in headers()], ProductOptions())
    assert made is not None
    epochs = [re.search(rf"^{field} = (\S+)$", made, re.MULTILINE) for field in ("START_TIME", "STOP_TIME")]
    assert [plain(found[1]).partition(".")[0] if found else "" for found in epochs] == [f"2027-01-{start}", f"2027-01-{stop}"]


def test_epoch_of_a_magnitude_is_said_to_be_that_of_the_trails_middle(tmp_path: Path) -> None:
    """`ground.trail_epochs.with_middle_epoch` dates it; it is not half way between the ends where the object changes its rate."""
    (segment,) = read(message(tracklet(17)), tmp_path).body.segment
    comments = " ".join(segment.metadata.comment)
    assert "of MAG, when the object passed the middle of its trail" in comments
    assert "half way" not in comments
