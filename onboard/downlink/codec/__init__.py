"""Codecs: blocks of integers to bytes. Each module here has its decoder in `ground.ingest.codecs`."""

from onboard.downlink.codec.ccsds121 import Ccsds121Codec
from onboard.downlink.codec.planes import PlanesCodec
from onboard.downlink.codec.rans import RansCodec
from onboard.downlink.codec.raw import RawCodec
from onboard.downlink.codec.sqrt_planes import SqrtPlanesCodec

__all__ = ["Ccsds121Codec", "PlanesCodec", "RansCodec", "RawCodec", "SqrtPlanesCodec"]
