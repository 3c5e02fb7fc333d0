"""Bits sent, by kind of packet, and compared with the entropy bound."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.layout import PRIMARY, Apid
from sboc_e2e.icd.signals import RoiGroup
from sboc_e2e.score.figures import Figure, absent, bootstrap, exact

RAW_BITS_PER_PIXEL = 12  # Definition of `raw_bytes` (docs/scoring.md): a 12-bit converter's numbers, packed.


def bytes_by_kind(downlink: bytes) -> dict[str, int]:
    """Bytes of each kind of packet in an undamaged downlink file, headers and CRC counted."""
    out = {kind.name.lower(): 0 for kind in Apid}
    at = 0
    while at + PRIMARY.size <= len(downlink):
        word, _, length = PRIMARY.unpack_from(downlink, at)
        size = PRIMARY.size + length + 1
        try:
            out[Apid(word & 0x7FF).name.lower()] += size
        except ValueError:
            break
        at += size
    return out


def compression(
    downlink: bytes,
    n_frames: int,
    shape: tuple[int, int],
    n_stars: int,
    groups: Mapping[int, Sequence[RoiGroup]],
    captured: Sequence[float],
    lossless_bits: Figure,
    bit_exact: Figure,
    entropy_bits: NDArray[np.float64],
) -> dict[str, Any]:
    """Compression figures; requested whole frames are reported apart from the reduction."""
    raw = n_frames * shape[0] * shape[1] * RAW_BITS_PER_PIXEL // 8
    kinds = bytes_by_kind(downlink)
    regular = len(downlink) - kinds["frame"]
    entropies = entropy_bits[np.isfinite(entropy_bits)]
    n_groups = sum(len(g) for g in groups.values())
    return {
        "raw_bytes": exact(raw, n_frames),
        "downlink_bytes": exact(len(downlink), n_frames),
        "reduction": exact(raw / regular, n_frames) if regular else absent("empty downlink"),
        "bytes_by_kind": kinds,
        "whole_frame_bytes": exact(kinds["frame"], n_frames),
        "bits_per_pixel_lossless": lossless_bits,
        "entropy_bound_bits": bootstrap(entropies, lambda v: float(v.mean()), "fewer than three frames with an entropy"),
        "captured_flux_fraction": bootstrap(captured, lambda v: float(v.mean()), "fewer than three detected streaks"),
        "lossless_bit_exact": bit_exact,
        "bits_per_frame": exact(8 * regular / n_frames, n_frames) if n_frames else absent("no frame"),
        "bits_per_star": exact(8 * kinds["stars"] / n_stars, n_stars) if n_stars else absent("no star sent"),
        "bits_per_streak": exact(8 * kinds["roi"] / n_groups, n_groups) if n_groups else absent("no ROI sent"),
    }
