"""Fuzz target: any bytes as a block of each codec."""

import struct

from ground.ingest.codecs import Ccsds121Decoder, PlanesDecoder, RawDecoder, SqrtPlanesDecoder
from ground.ingest.rans import RansDecoder
from sboc_e2e.icd.errors import ContractError

DECODERS = (PlanesDecoder(), RawDecoder(), Ccsds121Decoder(), SqrtPlanesDecoder(), RansDecoder())
HEAD = struct.Struct(">BHHif")
LARGEST_SIDE = 64
SHAPES_OF_ANY_SIZE = 192
"""First bytes from here on leave the shape as it is; below, it is small enough for the block to be decoded."""


def one_input(data: bytes) -> None:
    """Decoder, shape and levels from the first bytes, block from the rest: values or a ContractError."""
    if len(data) < HEAD.size:
        return
    which, rows, cols, level, sigma = HEAD.unpack_from(data)
    if which < SHAPES_OF_ANY_SIZE:
        rows, cols = 1 + (rows - 1) % LARGEST_SIDE, 1 + (cols - 1) % LARGEST_SIDE
    try:
        values = DECODERS[which % len(DECODERS)].decode(data[HEAD.size :], (rows, cols), level_adu=level, sigma_adu=sigma)
    except ContractError:
        return
    assert values.shape == (rows, cols)
