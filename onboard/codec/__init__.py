"""Codecs: blocks of integers to bytes. Each module here has its decoder in `ground.ingest.codecs`."""

from onboard.codec.ccsds121 import Ccsds121Codec
from onboard.codec.planes import PlanesCodec
from onboard.codec.rans import RansCodec
from onboard.codec.raw import RawCodec
from onboard.codec.sqrt_planes import SqrtPlanesCodec

__all__ = ["Ccsds121Codec", "PlanesCodec", "RansCodec", "RawCodec", "SqrtPlanesCodec"]
