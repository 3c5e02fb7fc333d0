"""A block of a survey: nature's passages of a quarter of a day, and what the response makes of them."""

import io
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ground.orbit.size import diameter_m
from ground.population.flux import ALBEDO
from sboc_e2e.icd.errors import UserError
from sboc_e2e.score.recovery import SIZE_EDGES_M
from sboc_e2e.survey.curve import found_share, shifts
from sboc_e2e.survey.response import Response
from simulator.platform.earth import EARTH_RADIUS_KM
from simulator.randomness import Effect, generator
from simulator.scene.fleet import KINDS as FLEET_KINDS
from simulator.scene.fleet import Fleet
from simulator.survey.blocks import Pools, candidate_number, draw_block, pilot_instants
from simulator.survey.flight import BLOCK_S, Flight, Instants
from simulator.survey.looks import Looks, looks_of
from simulator.survey.named import fleet_block
from simulator.survey.passages import Passages, orbits_of

Array = NDArray[np.float64]
Columns = dict[str, NDArray[Any]]

IDS_PER_BLOCK: Final = 1_000_000
"""Tracklets of a block have ids of their own: a quarter of a day has some 4,900 (docs/survey.md)."""
TURNS, FOUND, FALSE, NAMED = 101, 102, 103, 104
"""Random streams of a block beside those of its passages."""

KINDS: Final = ("debris", "false", "satellite", "fragment", "walker", "orbit")
REDRAWS: Final = 40
"""Draws by which the probability of a tracklet is known for each passage of an object with a name."""


@dataclass(frozen=True, kw_only=True)
class BlockJob:
    """What a worker needs for a block. frames_lost, packets_lost : shares that never arrive."""

    flight_options: Any
    seed: int
    numbers: tuple[int, ...]
    response: Mapping[str, Any]
    frames_lost: float
    packets_lost: float
    block: int


@dataclass(frozen=True, kw_only=True)
class BlockTables:
    """Parquet files of a block as bytes: what was measured, what was true of it; and sums over all passages, JSON-able."""

    tracklets: bytes
    truth: bytes
    sums: dict[str, Any]


def parquet_bytes(columns: Columns, meta: Mapping[str, str]) -> bytes:
    """A table as a parquet file; the same columns give the same bytes. UserError without pyarrow."""
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError as error:
        raise UserError('surveys write parquet and need the extra "survey": pip install "sboc-e2e[survey]"') from error
    table = pa.table({name: pa.array(values) for name, values in columns.items()}).replace_schema_metadata(dict(meta))
    stream = io.BytesIO()
    parquet.write_table(table, stream, compression="zstd", row_group_size=1 << 20)
    return stream.getvalue()


@lru_cache(maxsize=2)
def _flight(options: Any, seed: int) -> tuple[Flight, Pools]:
    return Flight.of(options, seed), Pools()


@lru_cache(maxsize=1)
def _pilot_instants(options: Any, seed: int) -> Instants:
    return pilot_instants(_flight(options, seed)[0])


def pilot(options: Any, seed: int, number: int) -> int:
    """How many candidates of a class the blocks of a survey need."""
    return candidate_number(_flight(options, seed)[0], _pilot_instants(options, seed), number)


def run_block(job: BlockJob) -> BlockTables:
    """Make a block."""
    flight, pools = _flight(job.flight_options, job.seed)
    at, passages = draw_block(flight, job.block, list(job.numbers), pools)
    looks = looks_of(flight, at, passages, generator(job.seed, Effect.SURVEY, job.block, TURNS))
    response = Response(content=job.response)
    rng = generator(job.seed, Effect.SURVEY, job.block, FOUND)
    finds = finds_of(passages.rate_deg_s, looks, response, rng, 1.0 - (1.0 - job.frames_lost) * (1.0 - job.packets_lost))
    measured, true = tables_of(at, passages, looks, finds, response, rng)
    sums: dict[str, Any] = {
        "block": job.block,
        "watched_s": at.watched_s,
        "span_s": BLOCK_S,
        "passages": len(passages.size_m),
        "found_once": int((finds.frames == 1).sum()),
        "found_not_linked": int(((finds.frames >= 2) & ~finds.linked).sum()),
        "tracklets": int(finds.linked.sum()),
        "crossings": crossings(passages),
    }
    measured, true = with_false(
        measured, true, response, at, at.watched_s / 3600.0, generator(job.seed, Effect.SURVEY, job.block, FALSE)
    )
    if flight.fleet is not None:
        measured, true, sums["named"] = _with_named(job, flight, flight.fleet, response, measured, true)
    ids = job.block * IDS_PER_BLOCK + np.arange(len(measured["n_frames"]))
    return BlockTables(
        tracklets=parquet_bytes({"tracklet_id": ids, **measured}, {"table": "tracklets", "units": MEASURED_UNITS}),
        truth=parquet_bytes({"tracklet_id": ids, **true}, {"table": "truth", "units": TRUE_UNITS}),
        sums=sums,
    )


def _with_named(
    job: BlockJob, flight: Flight, fleet: Fleet, response: Response, measured: Columns, true: Columns
) -> tuple[Columns, Columns, dict[str, Any]]:
    """Tables with the tracklets of objects with names behind the others, and what is known of all their passages.

    ``passages``: for each object, time after the epoch, share of draws in which it became a tracklet, and best S/N of a frame.
    """
    found = fleet_block(flight, fleet, job.block, flight.options.objects.satellites.farthest_km)
    rng = generator(job.seed, Effect.SURVEY, job.block, NAMED)
    lost = 1.0 - (1.0 - job.frames_lost) * (1.0 - job.packets_lost)
    finds = finds_of(found.passages.rate_deg_s, found.looks, response, rng, lost)
    kinds = np.array([KINDS.index(name) for name in FLEET_KINDS])[fleet.kind[found.object]]
    rows = np.flatnonzero(finds.linked)
    mine, theirs = tables_of(found.at, found.passages, found.looks, finds, response, rng, kinds[rows])
    linked = np.zeros(len(found.object))
    for _ in range(REDRAWS):
        linked += finds_of(found.passages.rate_deg_s, found.looks, response, rng, lost).linked / REDRAWS
    best = np.zeros(len(found.object))
    np.maximum.at(best, found.looks.passage, found.looks.snr)
    columns = (found.object, found.at.time_s[found.passages.instant], linked, best)
    named = {
        "passages": [
            [int(o), round(float(t), 1), round(float(p), 4), round(float(s), 2)] for o, t, p, s in zip(*columns, strict=True)
        ],
        "too_slow": found.too_slow,
    }
    true = true | {"object": np.full(len(true["kind"]), -1, np.int32)}
    theirs = theirs | {"object": found.object[rows].astype(np.int32)}
    return (
        {name: np.concatenate([values, mine[name]]) for name, values in measured.items()},
        {name: np.concatenate([values, theirs[name]]) for name, values in true.items()},
        named,
    )


MEASURED_UNITS: Final = (
    "t_tai_ns: ns since 1958-01-01 TAI; ra_deg, dec_deg: GCRS; n_frames; snr: root of the summed squares; rate_deg_s; mag: V; "
    "range_km, altitude_km (over 6378.137 km), i_deg, size_m: medians, NaN without an orbit"
)
TRUE_UNITS: Final = "size_m, albedo, a_km, e, i_deg, range_km, altitude_km; frames: of the stay; kind: " + ", ".join(
    f"{k} {name}" for k, name in enumerate(KINDS)
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Finds:
    """What was found of passages (n,): look (k,) whether each look was; frames; snr : root of the summed squares.

    mag : V of the mean light of found trails; arc_deg : from the first to the last of them; linked : into a tracklet.
    """

    look: NDArray[np.bool_]
    frames: NDArray[np.int64]
    snr: Array
    mag: Array
    arc_deg: Array
    linked: NDArray[np.bool_]


def finds_of(rate_deg_s: Array, looks: Looks, response: Response, rng: np.random.Generator, lost: float = 0.0) -> Finds:
    """Draw what is found. rate_deg_s (n,) : of each passage; lost : share of frames and packets that never arrive."""
    n = len(rate_deg_s)
    noise, shift = response.noise_ratio(looks.noise_e), shifts(response.curve, n, rng)[looks.passage]
    share = found_share(response.curve, looks.snr, looks.length_px, noise, looks.cut, shift) * (1.0 - lost)
    found = rng.random(len(share)) < np.where(looks.snr > 0.0, share, 0.0)
    whose, weight = looks.passage[found], looks.stands_for[found]

    def total(values: Array) -> Array:
        return np.asarray(np.bincount(whose, weights=weight * values, minlength=n), dtype=np.float64)

    looked = total(np.ones(len(whose)))
    frames = np.round(looked).astype(np.int64)
    first, last = np.full(n, np.inf), np.full(n, -np.inf)
    np.minimum.at(first, whose, looks.open_s[found])
    np.maximum.at(last, whose, looks.open_s[found])
    light = total(10.0 ** (-0.4 * looks.mag[found])) / np.maximum(looked, 1e-9)
    return Finds(
        look=found,
        frames=frames,
        snr=np.sqrt(total(looks.snr[found] ** 2)),
        mag=-2.5 * np.log10(np.maximum(light, 1e-99)),
        arc_deg=np.where(frames > 1, rate_deg_s * np.where(frames > 1, last - np.where(frames > 1, first, 0.0), 0.0), 0.0),
        linked=rng.random(n) < response.linked_share(frames),
    )


def tables_of(
    at: Instants,
    passages: Passages,
    looks: Looks,
    finds: Finds,
    response: Response,
    rng: np.random.Generator,
    kind: NDArray[np.int64] | int = 0,
) -> tuple[Columns, Columns]:
    """Measured and true columns of the tracklets. kind : of each of them, or of all."""
    rows = np.flatnonzero(finds.linked)
    p = passages.taken(rows)
    observer = at.position_km[p.instant]
    line = (p.position_km - observer) / p.range_km[:, None]
    shown = finds.frames[rows].astype(np.float64), finds.snr[rows], finds.arc_deg[rows], p.range_km
    wrong = response.residuals(*shown, rng)
    sun = at.sun_km[p.instant] / np.linalg.norm(at.sun_km[p.instant], axis=1, keepdims=True)
    phase = np.arccos(np.clip(-np.sum(line * sun, axis=1), -1.0, 1.0))
    by_light = diameter_m(finds.mag[rows], p.range_km, ALBEDO, phase)
    range_km = p.range_km * np.exp(wrong["ln_range_error"])
    a_km, e, i_deg = orbits_of(p)
    inclination = np.abs(i_deg + wrong["i_error_deg"])
    measured: Columns = {
        "t_tai_ns": np.round(at.time_s[p.instant] * 1e9).astype(np.int64) + at.epoch_tai_ns,
        "ra_deg": (np.degrees(np.arctan2(line[:, 1], line[:, 0])) % 360.0).astype(np.float32),
        "dec_deg": np.degrees(np.arcsin(np.clip(line[:, 2], -1.0, 1.0))).astype(np.float32),
        "n_frames": finds.frames[rows].astype(np.int32),
        "snr": finds.snr[rows].astype(np.float32),
        "rate_deg_s": (p.rate_deg_s * np.exp(wrong["ln_rate_error"])).astype(np.float32),
        "mag": (finds.mag[rows] + wrong["mag_error"]).astype(np.float32),
        "range_km": range_km.astype(np.float32),
        "altitude_km": (np.linalg.norm(observer + range_km[:, None] * line, axis=1) - EARTH_RADIUS_KM).astype(np.float32),
        "i_deg": np.where(inclination > 180.0, 360.0 - inclination, inclination).astype(np.float32),
        "size_m": (by_light * np.exp(wrong["ln_size_error"])).astype(np.float32),
    }
    true: Columns = {
        "kind": np.full(len(rows), kind, dtype=np.int8),
        "size_m": p.size_m.astype(np.float32),
        "albedo": p.surfaces.albedo.astype(np.float32),
        "a_km": a_km.astype(np.float32),
        "e": e.astype(np.float32),
        "i_deg": i_deg.astype(np.float32),
        "range_km": p.range_km.astype(np.float32),
        "altitude_km": (np.linalg.norm(p.position_km, axis=1) - EARTH_RADIUS_KM).astype(np.float32),
        "frames": looks.frames[rows].astype(np.int32),
    }
    return measured, true


def with_false(
    measured: Columns, true: Columns, response: Response, at: Instants, hours: float, rng: np.random.Generator
) -> tuple[Columns, Columns]:
    """Add false tracklets at the measured rate: rows of real ones of two frames, or of the fewest, at other times."""
    n = int(rng.poisson(response.false_per_hour * hours))
    short = np.flatnonzero(measured["n_frames"] <= 3)
    if n == 0 or not len(short):
        return measured, true
    like = short[rng.integers(len(short), size=n)]
    times = at.epoch_tai_ns + np.round(at.time_s[rng.integers(len(at.time_s), size=n)] * 1e9).astype(np.int64)
    extra = {name: values[like] for name, values in measured.items()} | {"t_tai_ns": times}
    nothing = {name: np.full(n, np.nan, values.dtype) if values.dtype.kind == "f" else np.zeros(n, values.dtype)
               for name, values in true.items()} | {"kind": np.full(n, KINDS.index("false"), np.int8)}  # fmt: skip
    return (
        {name: np.concatenate([values, extra[name]]) for name, values in measured.items()},
        {name: np.concatenate([values, nothing[name]]) for name, values in true.items()},
    )


CLASS_EDGES_M: Final = SIZE_EDGES_M
"""Diameters: the classes of the scores of runs."""
ALTITUDE_EDGES_KM: Final = (0.0, 500.0, 600.0, 700.0, 800.0, 900.0, 1000.0, 1200.0, 1500.0, 60000.0)
"""Shells of the published flux: 100 km wide where the debris is, wider above. Chosen."""
INCLINATION_EDGES_DEG: Final = (0.0, 60.0, 70.0, 80.0, 90.0, 100.0, 110.0, 180.0)
"""Bands of the published flux: 10 deg wide from 60 to 110 deg, where the debris is. Chosen."""


def crossings(p: Passages) -> list[list[list[int]]]:
    """Passages by true size, altitude and inclination: what nature sent that could be seen."""
    _, _, i_deg = orbits_of(p)
    altitude = np.linalg.norm(p.position_km, axis=1) - EARTH_RADIUS_KM
    sample = np.stack([p.size_m, altitude, i_deg], axis=1)
    table, _ = np.histogramdd(
        sample, bins=[np.array(CLASS_EDGES_M), np.array(ALTITUDE_EDGES_KM), np.array(INCLINATION_EDGES_DEG)]
    )
    return [[[int(v) for v in row] for row in plane] for plane in table]
