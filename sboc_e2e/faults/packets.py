"""Damage to a downlink: lost, duplicated, reordered, truncated and bit-flipped packets."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sboc_e2e.faults.options import PacketFaults
from sboc_e2e.faults.random import FaultStream, generator
from sboc_e2e.icd.errors import UserError
from sboc_e2e.icd.layout import PRIMARY


@dataclass(frozen=True, kw_only=True)
class Damage:
    """Indices of the packets that met each fault."""

    lost: frozenset[int]
    duplicated: frozenset[int]
    reordered: frozenset[int]
    truncated: frozenset[int]
    bit_flipped: frozenset[int]

    @property
    def gone(self) -> frozenset[int]:
        """Packets that do not arrive intact in any copy."""
        return self.lost | self.truncated | self.bit_flipped


def split_packets(downlink: bytes) -> list[bytes]:
    """The packets of an undamaged downlink. Raises `UserError` when it is damaged already."""
    packets, at = [], 0
    while at < len(downlink):
        if at + PRIMARY.size > len(downlink):
            raise UserError("downlink: ends inside a packet; faults are injected into undamaged downlinks")
        size = PRIMARY.size + PRIMARY.unpack_from(downlink, at)[2] + 1
        if at + size > len(downlink):
            raise UserError("downlink: ends inside a packet; faults are injected into undamaged downlinks")
        packets.append(downlink[at : at + size])
        at += size
    return packets


def draw_damage(n_packets: int, options: PacketFaults, seed: int) -> Damage:
    """Which packets are hit; a packet that is lost meets nothing else, one that is cut is not flipped as well."""
    chance = generator(seed, FaultStream.PACKETS).random((5, n_packets))
    rates = (options.lost, options.truncated, options.bit_flipped, options.duplicated, options.reordered)
    hit = [set(np.flatnonzero(row < rate).tolist()) for row, rate in zip(chance, rates, strict=True)]
    lost, truncated, flipped, duplicated, reordered = hit
    truncated -= lost
    flipped -= lost | truncated
    whole = set(range(n_packets)) - lost - truncated - flipped
    return Damage(
        lost=frozenset(lost),
        truncated=frozenset(truncated),
        bit_flipped=frozenset(flipped),
        duplicated=frozenset(duplicated & whole),
        reordered=frozenset(reordered - lost),
    )


def damaged_packets(packets: Sequence[bytes], options: PacketFaults, seed: int) -> tuple[bytes, Damage]:
    """The stream that arrives, and what was done to it."""
    damage = draw_damage(len(packets), options, seed)
    rng = generator(seed, FaultStream.PACKETS, 1)
    arriving: list[tuple[float, bytes]] = []
    for index, packet in enumerate(packets):
        if index in damage.lost:
            continue
        place = float(rng.uniform(0, len(packets))) if index in damage.reordered else float(index)
        data = packet
        if index in damage.truncated:
            data = packet[: int(rng.integers(1, len(packet)))]
        elif index in damage.bit_flipped:
            bit = int(rng.integers(0, 8 * len(packet)))
            flipped = bytearray(packet)
            flipped[bit // 8] ^= 1 << (bit % 8)
            data = bytes(flipped)
        arriving.append((place, data))
        if index in damage.duplicated:
            arriving.append((float(rng.uniform(0, len(packets))), data))
    arriving.sort(key=lambda item: item[0])
    return b"".join(data for _, data in arriving), damage
