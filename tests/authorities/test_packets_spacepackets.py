"""Packet headers against an independent implementation of CCSDS 133.0-B and of its time codes."""

import binascii
import struct
from datetime import UTC, datetime, timedelta

import pytest
from spacepackets.ccsds.spacepacket import PacketType, SequenceFlags, SpacePacketHeader

from sboc_e2e.icd import layout
from tests.ingest.test_downlink import split
from tests.onboard import small_run


@pytest.fixture(scope="module")
def packets() -> list[bytes]:
    """Packets of two frames."""
    return split(small_run.short_run(2).downlink)


def test_primary_headers_read_back(packets: list[bytes]) -> None:
    """Version, type, secondary header flag, APID, sequence flags, count and length of every packet."""
    counts: dict[int, int] = {}
    for packet in packets:
        header = SpacePacketHeader.unpack(packet)
        assert header.ccsds_version == 0
        assert header.packet_type == PacketType.TM
        assert header.sec_header_flag
        assert header.seq_flags == SequenceFlags.UNSEGMENTED
        assert header.apid in set(layout.Apid)
        assert header.packet_len == len(packet)
        assert header.seq_count == counts.get(header.apid, 0)
        counts[header.apid] = header.seq_count + 1


def test_primary_header_bytes_are_identical(packets: list[bytes]) -> None:
    """Packed by the other implementation from the same fields."""
    for packet in packets:
        read = SpacePacketHeader.unpack(packet)
        again = SpacePacketHeader(
            packet_type=PacketType.TM,
            apid=read.apid,
            seq_count=read.seq_count,
            data_len=len(packet) - 7,
            sec_header_flag=True,
            seq_flags=SequenceFlags.UNSEGMENTED,
        )
        assert bytes(again.pack()) == packet[:6]


def test_checksum_is_the_standard_one() -> None:
    """CRC-16-CCITT, start 0xFFFF: 0x29B1 for the nine digits (ECSS-E-ST-70-41C, annex B)."""
    assert binascii.crc_hqx(b"123456789", layout.CRC_START) == 0x29B1


def test_time_code_is_unsegmented_and_level_one(packets: list[bytes]) -> None:
    """CCSDS 301.0-B-4, 3.2: P-field and T-field decoded here by the standard's text."""
    p1, p2 = packets[0][6], packets[0][7]
    assert p1 >> 7 == 1  # a second octet follows
    assert (p1 >> 4) & 0b111 == 0b001  # 1958-01-01 TAI
    coarse_octets = ((p1 >> 2) & 0b11) + 1 + ((p2 >> 5) & 0b11)
    fine_octets = (p1 & 0b11) + ((p2 >> 2) & 0b111)
    assert p2 >> 7 == 0
    assert (coarse_octets, fine_octets) == (4, 4)
    seconds, fraction = struct.unpack_from(">II", packets[0], 8)
    expected_ns = small_run.header(0).t_start_tai_ns
    assert seconds == expected_ns // 10**9
    assert round(fraction * 1e9 / 2**32) == expected_ns % 10**9
    instant = datetime(1958, 1, 1, tzinfo=UTC) + timedelta(seconds=seconds)
    assert instant.year == 2027
