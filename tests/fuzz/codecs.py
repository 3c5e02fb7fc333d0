"""Fuzz target: any bytes as a block of each codec."""

import struct

from ground.ingest.codecs import Ccsds121Decoder, PlanesDecoder, RawDecoder, SqrtPlanesDecoder
from sboc_e2e.icd.errors import ContractError

DECODERS = (PlanesDecoder(), RawDecoder(), Ccsds121Decoder(), SqrtPlanesDecoder())
HEAD = struct.Struct(">BHHif")


def one_input(data: bytes) -> None:
    """Decoder, shape and levels from the first bytes, block from the rest: values or a ContractError."""
    if len(data) < HEAD.size:
        return
    which, rows, cols, level, sigma = HEAD.unpack_from(data)
    try:
        values = DECODERS[which % len(DECODERS)].decode(data[HEAD.size :], (rows, cols), level_adu=level, sigma_adu=sigma)
    except ContractError:
        return
    assert values.shape == (rows, cols)
