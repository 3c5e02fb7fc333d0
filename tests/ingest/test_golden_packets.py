"""Golden packets: bytes on disk and a readable table hold encoder and decoder to ICD.md."""

import csv
import re
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ground.ingest import records
from ground.ingest.codecs import PlanesDecoder, RawDecoder
from ground.ingest.packets import Packet, StreamFaults, read_packets
from sboc_e2e.icd import flags, version
from sboc_e2e.icd.flags import FLAG_TEXT
from sboc_e2e.icd.layout import Apid
from tests.golden import cases

KINDS = tuple(apid.name.lower() for apid in Apid)
ICD = (Path(__file__).parents[2] / "sboc_e2e" / "icd" / "ICD.md").read_text(encoding="utf-8")
DECODERS = {0: RawDecoder(), 1: PlanesDecoder()}


def golden(kind: str) -> bytes:
    """The bytes on disk."""
    return (cases.FOLDER / f"{kind}.bin").read_bytes()


def rows(kind: str) -> list[dict[str, str]]:
    """The readable table."""
    with (cases.FOLDER / f"{kind}.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def parsed(kind: str) -> Packet:
    """The golden packet through the ground's reader."""
    faults = StreamFaults()
    (packet,) = read_packets(golden(kind), faults)
    assert faults == StreamFaults()
    return packet


@pytest.mark.parametrize("kind", KINDS)
def test_encoder_writes_the_golden_bytes(kind: str) -> None:
    """Byte for byte; where zstd is inside, its output may differ between versions, the rest may not."""
    written, expected = cases.make_packets()[kind], golden(kind)
    if kind in ("background", "thumbnail", "frame"):
        sizes = 6 + sum(struct.calcsize(form) for name, form in cases.PAYLOAD_FIELDS[kind] if not name.endswith("_bytes"))
        assert written[:4] == expected[:4]
        assert written[6:sizes] == expected[6:sizes]
    else:
        assert written == expected


@pytest.mark.parametrize("kind", KINDS)
def test_table_describes_the_bytes(kind: str) -> None:
    """Every row of the table, read with its own offset and format, and no gap between rows up to the block."""
    packet, next_offset = golden(kind), 0
    table = rows(kind)
    for row in table[:-1]:
        value = struct.unpack_from(row["format"], packet, int(row["offset"]))[0]
        assert repr(value) == row["value"], row["field"]
        assert int(row["offset"]) == next_offset
        next_offset += struct.calcsize(row["format"])
    assert table[-1]["field"] == "crc"
    assert int(table[-1]["offset"]) == len(packet) - 2


@pytest.mark.parametrize("kind", KINDS)
def test_icd_documents_every_field_at_its_offset(kind: str) -> None:
    """ICD.md has a line ``| offset | bytes | field |`` for each field of the payload and of the common headers."""
    start = 44
    types = {">B": 1, ">H": 2, ">I": 4, ">i": 4, ">f": 4, ">Q": 8, ">q": 8, ">d": 8}
    for row in rows(kind)[:-1]:
        field = row["field"]
        if re.match(r"(star[1-9]|previous\.|value[0-9]|this\.)", field):
            continue
        name = field.split(".")[-1]
        offset = int(row["offset"]) - (start if int(row["offset"]) >= start else 0)
        assert re.search(rf"^\| {offset} \| {types[row['format']]} \| `{re.escape(name)}`", ICD, re.MULTILINE), (kind, row)


def check_header(packet: Packet) -> None:
    """Frame header, housekeeping, telemetry of two frames."""
    record = records.decode_header(packet)
    assert record.housekeeping == cases.HOUSEKEEPING
    assert record.psf_sigma_px == 0.875
    for name in ("frame", "t_start_tai_ns", "exposure_ns", "line_time_ns", "rows", "cols", "bin_rows", "bin_cols",
                 "window_row0", "window_col0", "gain_e_adu", "read_noise_e", "saturation_adu", "temperature_k"):  # fmt: skip
        assert getattr(record.header, name) == getattr(cases.HEADER, name), name
    assert record.header.attitude is not None
    assert cases.HEADER.attitude is not None
    assert (record.header.attitude.quaternion == cases.HEADER.attitude.quaternion).all()
    assert (record.header.attitude.covariance_rad2 == cases.HEADER.attitude.covariance_rad2).all()
    assert record.header.observer is not None
    assert cases.HEADER.observer is not None
    assert (record.header.observer.velocity_m_s == cases.HEADER.observer.velocity_m_s).all()
    assert record.header.observer.tai_ns == cases.HEADER.observer.tai_ns
    assert record.previous is not None
    assert record.previous.frame == 40
    assert record.previous.observer is None


def check_stars(packet: Packet) -> None:
    """Positions to 1/512 px, fluxes and S/N to half a code."""
    stars = records.star_list(records.decode_stars(packet))
    assert np.abs(stars.row - cases.STARS.row).max() <= 0.5 / 512
    assert np.abs(stars.col - cases.STARS.col).max() <= 0.5 / 512
    assert np.abs(stars.flux_e / cases.STARS.flux_e - 1.0).max() < 2e-4
    assert np.abs(np.log2((1 + stars.snr) / (1 + cases.STARS.snr))).max() <= 0.5 / 16 + 1e-6
    assert (stars.flags == cases.STARS.flags).all()


def check_roi(packet: Packet) -> None:
    """Detection and strip."""
    record = records.decode_strip(packet, DECODERS)
    assert record.detection == cases.DETECTION
    assert (record.strip.values_adu == cases.STRIP.values_adu).all()
    for name in ("axis", "major0", "minor0_fp", "slope_fp", "level_adu"):
        assert getattr(record.strip, name) == getattr(cases.STRIP, name)


def check_background(packet: Packet) -> None:
    """Level and noise to their units."""
    band = records.decode_mesh(packet)
    assert (band.level_adu == cases.BACKGROUND.level_adu).all()
    assert (band.sigma_adu == cases.BACKGROUND.sigma_adu).all()
    assert (band.tile_px, band.shape, band.first) == (64, (2, 3), 0)


def check_thumbnail(packet: Packet) -> None:
    """Means of cells."""
    assert (records.decode_thumbnail(packet).cells_adu == -2.0 + 0.25 * cases.CELLS).all()


def check_frame(packet: Packet) -> None:
    """A chunk of a whole frame."""
    chunk = records.decode_chunk(packet, DECODERS)
    assert (chunk.row, chunk.col) == (64, 128)
    assert (chunk.values == cases.CHUNK).all()


def check_track(packet: Packet) -> None:
    """A member whose pixels came with a region of an earlier frame."""
    record = records.decode_track(packet, DECODERS)
    assert (record.number, record.frame, record.snr, record.roi_id) == (3, 40, 8.25, 5)
    assert record.t_start_tai_ns == cases.PREVIOUS.t_start_tai_ns
    assert record.strip is None


CHECKS: dict[str, Callable[[Packet], None]] = {
    "header": check_header,
    "stars": check_stars,
    "roi": check_roi,
    "background": check_background,
    "thumbnail": check_thumbnail,
    "frame": check_frame,
    "track": check_track,
}


@pytest.mark.parametrize("kind", KINDS)
def test_decoder_reads_the_golden_bytes(kind: str) -> None:
    """Common headers, then the record of each kind."""
    packet = parsed(kind)
    expected: dict[str, Any] = {
        "apid": int(Apid[kind.upper()]),
        "count": 16383,
        "run_id": cases.RUN_ID,
        "frame": 41,
        "t_start_tai_ns": cases.HEADER.t_start_tai_ns,
        "exposure_ns": 200_000_000,
        "line_time_ns": -10_000,
        "item": 7,
        "segment": 0,
        "n_segments": 1,
    }
    for name, value in expected.items():
        assert getattr(packet, name) == value, name
    CHECKS[kind](packet)


@pytest.mark.parametrize("table", sorted(FLAG_TEXT))
def test_icd_lists_every_flag(table: str) -> None:
    """Bit, name and meaning of each flag as in `flags.py`."""
    for flag in getattr(flags, table):
        assert f"| {flag.value.bit_length() - 1} | `{flag.name}` | {FLAG_TEXT[table][flag.name]} |" in ICD
    assert len(FLAG_TEXT[table]) == len(getattr(flags, table))


def test_icd_names_the_version_in_the_packets() -> None:
    """The page, the newest entry of the history and the number in every packet agree."""
    assert re.search(r"^Version (\S+) ", ICD, re.MULTILINE).group(1) == version.CONTRACT_VERSION  # type: ignore[union-attr]
    assert version.HISTORY[-1][0] == version.CONTRACT_VERSION
