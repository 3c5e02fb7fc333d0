"""Where each target begins: small valid inputs, and for texts a dictionary of words, so that fuzzing goes deep at once."""

import io
from pathlib import Path

import numpy as np
from astropy.io import fits

from onboard.downlink.codec import Ccsds121Codec, PlanesCodec, RansCodec, RawCodec, SqrtPlanesCodec
from sboc_e2e.icd.layout import CRC, HEADER_BYTES, ITEM, Apid
from sboc_e2e.scenario import schema
from sboc_e2e.scenario.toml_files import FOLDER
from tests.fuzz.codecs import HEAD

GOLDEN = Path(__file__).resolve().parents[1] / "golden"
FOUND = Path(__file__).parent / "found"
"""Inputs that found something, in a folder for each target; tests run them for ever."""

ENCODERS = (PlanesCodec(), RawCodec(), Ccsds121Codec(), SqrtPlanesCodec(), RansCodec())
"""In the order of the decoders of the codec target."""

MAX_BYTES = {"packets": 4096, "codecs": 2048, "fits": 12_000, "scenario": 4096}
"""Longest input of each target: some times its seeds."""


def packets() -> list[bytes]:
    """The golden packets as streams, and in the form that the target frames itself."""
    found = []
    for place, apid in enumerate(Apid):
        packet = (GOLDEN / f"{apid.name.lower()}.bin").read_bytes()
        found += [packet, bytes([place]) + packet[HEADER_BYTES - ITEM.size : -CRC.size]]
    return found


def codecs() -> list[bytes]:
    """A noise block and an empty one of each codec."""
    noise = np.random.default_rng(1).normal(5.0, 4.0, (7, 16)).astype(np.int32)
    noise[3, 4] = 30_000
    return [
        HEAD.pack(which, *block.shape, 5, 4.0) + encoder.encode(block, level_adu=5, sigma_adu=4.0)
        for which, encoder in enumerate(ENCODERS)
        for block in (noise, np.zeros((1, 3), dtype=np.int32))
    ]


def fits_files() -> list[bytes]:
    """Files of each kind that telescopes write, and the tail of a header."""
    image = np.arange(256, dtype=np.int16).reshape(16, 16)
    tail = "".join(f"{card:<80}" for card in ("DATE-OBS= '2024-03-01T02:03:04'", "EXPTIME =                 1.5", "END")).encode()
    found = [tail.ljust(2880 - 400) + image.astype(">i2").tobytes().ljust(2880, b"\0")]
    for hdus in (
        [fits.PrimaryHDU(image)],
        [fits.PrimaryHDU(image.astype(np.float32) / 3)],
        [fits.PrimaryHDU(), fits.CompImageHDU(image, compression_type="RICE_1")],
        [fits.PrimaryHDU(image), fits.ImageHDU(image.astype(np.uint16))],
    ):
        stream = io.BytesIO()
        fits.HDUList(hdus).writeto(stream)
        found.append(stream.getvalue())
    return found


def scenarios() -> list[bytes]:
    """Scenarios and presets that come with the project, as far as they are short."""
    texts = [path.read_bytes() for path in sorted(FOLDER.rglob("*.toml"))]
    return [text[: MAX_BYTES["scenario"]] for text in texts] + [b'[onboard.detector]\nuse = "subprocess:Popen"\n']


SEEDS = {"packets": packets, "codecs": codecs, "fits": fits_files, "scenario": scenarios}


def words(target: str) -> list[str]:
    """Words that the parser of a target knows."""
    if target == "fits":
        return ["SIMPLE", "BITPIX", "NAXIS", "NAXIS1", "XTENSION", "IMAGE", "ZIMAGE", "ZCMPTYPE", "ZTILE1", "TFORM1", "BZERO"]
    if target == "scenario":
        return [*sorted(_keys(schema.schema())), "[[", "]]", " = ", '"1 s"', '"5 px"', "inf", "nan", "true", "1e400"]
    return []


def _keys(tables: object) -> set[str]:
    """All keys of properties in a JSON schema."""
    if isinstance(tables, list):
        return {key for item in tables for key in _keys(item)}
    if not isinstance(tables, dict):
        return set()
    properties = tables.get("properties")
    own = set(properties) if isinstance(properties, dict) else set()
    return own | {key for item in tables.values() for key in _keys(item)}


def write(target: str, folder: Path) -> list[str]:
    """Seeds and dictionary of a target in a folder; the arguments that make the fuzzer use them."""
    corpus = folder / "corpus"
    corpus.mkdir()
    found = FOUND / target
    earlier = [path.read_bytes() for path in sorted(found.iterdir())] if found.is_dir() else []
    for number, data in enumerate([*SEEDS[target](), *earlier]):
        (corpus / f"seed-{number:03d}").write_bytes(data)
    arguments = [str(corpus), f"-max_len={MAX_BYTES[target]}"]
    if words(target):
        escaped = (word.replace("\\", "\\\\").replace('"', '\\"') for word in words(target))
        (folder / "words").write_text("".join(f'"{word}"\n' for word in escaped), encoding="utf-8")
        arguments.append(f"-dict={folder / 'words'}")
    return arguments
