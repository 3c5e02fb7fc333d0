"""Fuzz target: any bytes as a downlink, whole streams and single packets with a right checksum."""

import binascii

from ground.ingest import decode_downlink
from ground.ingest.codecs import Ccsds121Decoder, PlanesDecoder, RawDecoder, SqrtPlanesDecoder
from ground.ingest.rans import RansDecoder
from sboc_e2e.icd import layout
from sboc_e2e.icd.version import CONTRACT_MAJOR, CONTRACT_MINOR

DECODERS = (PlanesDecoder(), RawDecoder(), Ccsds121Decoder(), SqrtPlanesDecoder(), RansDecoder())
APIDS = tuple(layout.Apid)


def packet_around(data: bytes) -> bytes:
    """A packet whose framing and checksum are right and whose content is the data."""
    apid = APIDS[data[0] % len(APIDS)] if data else APIDS[0]
    item = (data[1:] + bytes(layout.ITEM.size))[: layout.ITEM.size]
    fields = list(layout.ITEM.unpack(item))
    fields[0], fields[1] = CONTRACT_MAJOR, CONTRACT_MINOR
    body = layout.CUC_PREAMBLE + layout.CUC_TIME.pack(2_179_000_000, 0) + layout.ITEM.pack(*fields)
    body += data[1 + layout.ITEM.size :][: layout.MAX_PAYLOAD_BYTES]
    head = layout.PRIMARY.pack(0x0800 | apid, 0xC000, len(body) + layout.CRC.size - 1)
    return head + body + layout.CRC.pack(binascii.crc_hqx(head + body, layout.CRC_START))


def one_input(data: bytes) -> None:
    """A stream of the bytes themselves, and of a well-framed packet around them."""
    decode_downlink(data, DECODERS)
    decode_downlink(packet_around(data), DECODERS)
