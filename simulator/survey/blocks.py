"""Blocks of time with nature's number of passages: each candidate is kept as often as it stands for."""

from typing import Final

import numpy as np

from simulator.platform import earth
from simulator.randomness import Effect, generator
from simulator.scene.debris import SizeClass
from simulator.survey.candidates import Pool, candidates, pool_of
from simulator.survey.flight import BLOCK_S, Flight, Instants, block_instants, instants_of
from simulator.survey.passages import Passages, joined, none_of

BEYOND_ONE: Final = 0.05
"""Share of nature's passages that may lie beyond weights of 1, where passages come in pairs."""

POOL_BLOCKS: Final = 32
"""Sizes and orbits are drawn once for `POOL_BLOCKS` blocks, `POOL` of them for each class. Candidates take theirs from there."""

POOL_GROUP: Final = 5_000_000
"""Random streams of the pilot and of pools, beside those of blocks."""

CHUNK: Final = 200_000  # candidates at a time; bounds memory
PILOT: Final = 400_000  # candidates of the pilot for each class: more of them, fewer heavy weights missed. Chosen, not measured
PILOT_DAYS: Final = 365.0  # a year, so that it sees all seasons of the orbit
PILOT_BLOCK: Final = 4_000_000  # beyond any block of time: 2,700 years of four a day


def pilot_instants(flight: Flight) -> Instants:
    """Instants of a year, at which the pilots of all classes look."""
    rng = generator(flight.seed, Effect.SURVEY, PILOT_BLOCK)
    return instants_of(flight, np.sort(rng.random(240)) * PILOT_DAYS * earth.DAY_S, BLOCK_S)


def candidate_number(flight: Flight, at: Instants, number: int) -> int:
    """How many candidates of a class a block needs, so that few stand for more than one passage; from a pilot at instants."""
    options = flight.options.population
    size_class = options.classes[number]
    if size_class.count == 0:
        return 0
    rng = generator(flight.seed, Effect.SURVEY, PILOT_BLOCK, number + 1)
    drawn = candidates(flight, at, pool_of(flight, size_class, rng), PILOT, rng)
    weight = np.sort(drawn.natural[drawn.snr >= options.snr_min])[::-1] * PILOT
    if not weight.size:
        return 1000
    # with n candidates those above n stand for more than one; what is above is sum(w - n)
    above = np.cumsum(weight) - np.arange(1, len(weight) + 1) * weight
    allowed = np.searchsorted(above, BEYOND_ONE * weight.sum(), side="right")
    return int(np.clip(weight[min(allowed, len(weight) - 1)], 1000, 20_000_000))


class Pools:
    """The pools of the blocks that a worker makes; the last of each class is kept."""

    def __init__(self) -> None:
        self._kept: dict[int, tuple[int, Pool]] = {}

    def of(self, flight: Flight, size_class: SizeClass, number: int, block: int) -> Pool:
        """The pool of a class for a block: the same for all blocks of a group."""
        group = block // POOL_BLOCKS
        kept = self._kept.get(number)
        if kept is None or kept[0] != group:
            rng = generator(flight.seed, Effect.SURVEY, POOL_GROUP + group, number + 1)
            kept = group, pool_of(flight, size_class, rng)
            self._kept[number] = kept
        return kept[1]


def draw_block(flight: Flight, block: int, numbers: list[int], pools: Pools) -> tuple[Instants, Passages]:
    """Passages of nature in a block that reach `population.snr_min`, one row for each (`natural` 1)."""
    options = flight.options.population
    at = block_instants(flight, block)
    parts = []
    for k, (size_class, n) in enumerate(zip(options.classes, numbers, strict=True)):
        if n == 0:
            continue
        rng = generator(flight.seed, Effect.SURVEY, block, k + 1)
        pool = pools.of(flight, size_class, k, block)
        for first in range(0, n, CHUNK):
            some = candidates(flight, at, pool, min(CHUNK, n - first), rng)
            # each call's `natural` is of its own number of candidates: all calls together make n
            weight = some.natural * min(CHUNK, n - first) / n
            copies = np.floor(np.where(some.snr >= options.snr_min, weight, 0.0) + rng.random(len(weight))).astype(np.int64)
            parts.append(some.taken(np.repeat(np.arange(len(copies)), copies)))
    return at, joined(parts) if parts else none_of(flight, at)
