"""Downlink bytes to frames: find packets, check them, decode records, assemble frames, report what is missing."""

from ground.ingest.decoding import decode_downlink
from ground.ingest.report import IngestReport

__all__ = ["IngestReport", "decode_downlink"]
