"""Trails drawn into real frames that hold none: what share of them comes back, by length, brightness and kind of frame.

    python -m tests.benchmarks.drawn_in_real_frames EXAM.json ... --frames FRAMES --out DIR [--each 3] [--seed 1] [--only TEXT]
        [--kind meteors|satellites] [--fits]

EXAM.json and FRAMES: see `real_frames_exam`; frames of its list without trails are taken. The sky, its noise, the lens and the
compression are those of the frame, the trail is drawn: a line convolved with a Gaussian, in steps of a quarter of a pixel.
Meteors are short, of even light or of one that rises to its brightest point at two thirds, and fades. They are as wide as the
stars of the frame, as `sep` measures them, or up to 1.4 times as wide. Satellites are long and of even light, up to twice as wide
as stars, and four in ten cross the frame from border to border. Lengths are log-uniform. The light is given as that of the
brightest pixel over the scatter of the frame around it (pixels minus their median over 15 x 15), so that it counts texture and
faint stars as noise. Places where this scatter is above twice the frame's median are left out: trees and buildings.
Nothing of the simulator or of ground is used. Intervals hold 95 % (Clopper-Pearson).
"""

import argparse
import json
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
import sep
from astropy.io import fits
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from tests.benchmarks.real_frames import COMMAND, report
from tests.benchmarks.real_frames_exam import frame_of, processed
from tests.benchmarks.real_frames_table import Row, share_text

SIGMAS_PX: Final = (0.7, 1.6)
"""Width of the Gaussian where no stars tell it, log-uniform, px."""
STAR_SIGMAS_PX: Final = (0.55, 4.0)
"""Widths of stars that are believed."""
FEWEST_STARS: Final = 10
"""Fewer stars do not tell it."""
STAR_SNR: Final = 8.0
"""Of a pixel of a star."""
ROUND: Final = 1.5
"""Long axis of a star over its short one, at most."""
FULL_SHARE: Final = 0.7
"""Stars with more of the frame's brightest pixel may be full, and say nothing of their width."""
SUB_OBJECTS: Final = 1 << 16
"""Parts of one bright area, at most: a landscape has many. `sep` gives up at 1,024."""
APERTURE_AXES: Final = 6.0
"""Radius in which the light of a star is measured, in long axes: half of it lies within 1.18 sigma of a Gaussian."""
MEDIAN_PX: Final = 15
AROUND_PX: Final = 50
"""The scatter is that within so many pixels of a place."""
ROUGH: Final = 2.0
BOXES: Final = 30
"""Places that tell the usual scatter of a frame; rougher ones by that factor take no trail."""
STEP_PX: Final = 0.25
BRIGHTEST_AT: Final = 2.0 / 3.0
APART_PX: Final = 40.0
"""Middles of trails are so far apart at least, and 0.6 of their length more."""
TRIES: Final = 200
BEYOND_PX: Final = 10.0
"""A trail that crosses the frame is drawn so far beyond its borders."""
SEEN_AT_BORDER: Final = 0.3
"""Share of the middle's scatter at both borders that such a trail crosses, at least: an overscan or a black rim has less."""


@dataclass(frozen=True, kw_only=True)
class Kind:
    """What is drawn; all ranges are log-uniform.

    lengths_px : shortest and longest trail. peaks : brightest pixel over the scatter around it. wider : width of the Gaussian
    over that of the frame's stars. curves : of `CURVES`. crossing : share that goes from border to border.
    length_edges_px, peak_edges : of the rows of the table.
    """

    lengths_px: tuple[float, float]
    peaks: tuple[float, float]
    wider: tuple[float, float]
    curves: tuple[str, ...]
    crossing: float
    length_edges_px: tuple[float, ...]
    peak_edges: tuple[float, ...]


METEORS: Final = Kind(
    lengths_px=(15.0, 300.0),
    peaks=(2.0, 40.0),
    wider=(1.0, 1.4),
    curves=("even", "meteor"),
    crossing=0.0,
    length_edges_px=(15.0, 25.0, 40.0, 80.0, 300.0),
    peak_edges=(2.0, 4.0, 8.0, 16.0, 40.0),
)
SATELLITES: Final = Kind(
    lengths_px=(40.0, 4000.0),
    peaks=(0.7, 30.0),
    wider=(1.0, 2.0),
    curves=("even",),
    crossing=0.4,
    length_edges_px=(40.0, 100.0, 300.0, 20000.0),
    peak_edges=(0.7, 1.5, 3.0, 6.0, 12.0, 30.0),
)
FITS_SUFFIXES: Final = (".fits", ".fit", ".fts", ".fz")
KINDS: Final = {"meteors": METEORS, "satellites": SATELLITES}


def even(u: NDArray[np.float64]) -> NDArray[np.float64]:
    """The same light all along."""
    return np.ones_like(u)


def meteor(u: NDArray[np.float64]) -> NDArray[np.float64]:
    """Light that rises evenly to its brightest at two thirds of the way, and falls evenly."""
    return np.minimum(u / BRIGHTEST_AT, (1.0 - u) / (1.0 - BRIGHTEST_AT))


CURVES: Final[dict[str, Callable[[NDArray[np.float64]], NDArray[np.float64]]]] = {"even": even, "meteor": meteor}


def drawn(
    shape: tuple[int, int], ends: tuple[float, float, float, float], sigma_px: float, curve: str
) -> tuple[tuple[slice, slice], NDArray[np.float64]]:
    """A trail whose brightest pixel is 1: where it lies in the frame, and its light there."""
    row0, col0, row1, col1 = ends
    margin = math.ceil(5.0 * sigma_px) + 1
    first = [max(0, math.floor(min(a, b)) - margin) for a, b in ((row0, row1), (col0, col1))]
    last = [min(n, math.ceil(max(a, b)) + margin + 1) for n, a, b in ((shape[0], row0, row1), (shape[1], col0, col1))]
    light = np.zeros((last[0] - first[0], last[1] - first[1]))
    number = math.ceil(math.hypot(row1 - row0, col1 - col0) / STEP_PX)
    u = (np.arange(number) + 0.5) / number
    for row, col, part in zip(row0 + u * (row1 - row0), col0 + u * (col1 - col0), CURVES[curve](u), strict=True):
        low_row, low_col = max(first[0], math.floor(row) - margin), max(first[1], math.floor(col) - margin)
        i = np.arange(low_row, min(last[0], math.ceil(row) + margin + 1))
        j = np.arange(low_col, min(last[1], math.ceil(col) + margin + 1))
        across = np.exp(-0.5 * ((i - row) / sigma_px) ** 2)[:, None] * np.exp(-0.5 * ((j - col) / sigma_px) ** 2)
        light[low_row - first[0] : low_row - first[0] + i.size, low_col - first[1] : low_col - first[1] + j.size] += part * across
    return (slice(first[0], last[0]), slice(first[1], last[1])), light / max(float(light.max(initial=0.0)), 1e-12)


def scatter_at(image: NDArray[np.float64], row: float, col: float) -> float:
    """Scatter of the pixels around a place, of what a median over `MEDIAN_PX` leaves; NaN where some are not known."""
    first_row, first_col = max(0, int(row) - AROUND_PX), max(0, int(col) - AROUND_PX)
    box = image[first_row : int(row) + AROUND_PX, first_col : int(col) + AROUND_PX]
    return 1.4826 * float(np.median(np.abs(box - median_filter(box, MEDIAN_PX))))


def star_sigma_px(image: NDArray[np.float64]) -> float | None:
    """Width (sigma, px) of the frame's stars as `sep` measures them; None where too few are round."""
    data = np.ascontiguousarray(np.nan_to_num(image, nan=float(np.nanmedian(image))))
    sky = sep.Background(data)
    data -= sky.back()
    sep.set_extract_pixstack(data.size + 1)
    sep.set_sub_object_limit(SUB_OBJECTS)
    found = sep.extract(data, STAR_SNR, err=max(sky.globalrms, 1e-6), deblend_cont=1.0)
    round_ones = (found["a"] < ROUND * found["b"]) & (found["peak"] < FULL_SHARE * data.max())
    stars = found[round_ones & (found["flag"] == 0)]
    if len(stars) < FEWEST_STARS:
        return None
    radius, _ = sep.flux_radius(data, stars["x"], stars["y"], APERTURE_AXES * stars["a"], 0.5)
    sigma = float(np.median(radius)) / math.sqrt(2.0 * math.log(2.0))
    return sigma if STAR_SIGMAS_PX[0] <= sigma <= STAR_SIGMAS_PX[1] else None


def from_border_to_border(place: tuple[float, float], angle: float, shape: tuple[int, int]) -> tuple[float, float, float, float]:
    """Row and column of both ends, at the middles of the outermost pixels, of a line of this direction through a place."""
    steps = (math.sin(angle), math.cos(angle))
    to_borders = [
        sorted(((0.0 - at) / step, (side - 1.0 - at) / step))
        for at, step, side in zip(place, steps, shape, strict=True)
        if abs(step) > 1e-9
    ]
    back, forth = max(each[0] for each in to_borders), min(each[1] for each in to_borders)
    return (place[0] + back * steps[0], place[1] + back * steps[1], place[0] + forth * steps[0], place[1] + forth * steps[1])


def with_trails(
    image: NDArray[np.float64], number: int, rng: np.random.Generator, kind: Kind = METEORS
) -> Iterator[dict[str, Any]]:
    """Draw trails into a frame, in place; what each one is. Fewer than asked where the frame has no room."""
    rows, cols = image.shape
    places = rng.uniform(0.0, 1.0, (BOXES, 2)) * (rows, cols)
    usual = float(np.median([scatter_at(image, row, col) for row, col in places.tolist()]))
    stars = star_sigma_px(image)
    largest = float(np.nanmax(image))
    whole = largest <= 255.0 and float(np.nanmin(image)) >= 0.0
    middles: list[tuple[float, float]] = []
    for _ in range(TRIES):
        if len(middles) == number:
            return
        longest = min(kind.lengths_px[1], 0.6 * min(rows, cols))
        length = math.exp(rng.uniform(math.log(kind.lengths_px[0]), math.log(longest)))
        angle, row, col = rng.uniform(0.0, math.pi), rng.uniform(0.0, rows - 1.0), rng.uniform(0.0, cols - 1.0)
        half_row, half_col = 0.5 * length * math.sin(angle), 0.5 * length * math.cos(angle)
        ends = (row - half_row, col - half_col, row + half_row, col + half_col)
        curve = kind.curves[int(rng.integers(len(kind.curves)))]
        sigma = math.exp(rng.uniform(*np.log(SIGMAS_PX))) if stars is None else stars * math.exp(rng.uniform(*np.log(kind.wider)))
        peak = math.exp(rng.uniform(*np.log(kind.peaks)))
        crosses = kind.crossing > 0.0 and rng.uniform() < kind.crossing
        if crosses:
            ends = from_border_to_border((row, col), angle, (rows, cols))
            length = math.hypot(ends[2] - ends[0], ends[3] - ends[1])
        elif min(ends) < 8.0 or max(ends[0], ends[2]) > rows - 9.0 or max(ends[1], ends[3]) > cols - 9.0:
            continue
        if any(math.hypot(row - r, col - c) < APART_PX + 0.6 * length for r, c in middles):
            continue
        scatter = scatter_at(image, row, col)
        if not 0.0 < scatter < ROUGH * usual:
            continue
        beyond = (BEYOND_PX * math.sin(angle), BEYOND_PX * math.cos(angle)) if crosses else (0.0, 0.0)
        if crosses and min(scatter_at(image, *place) for place in (ends[:2], ends[2:])) < SEEN_AT_BORDER * scatter:
            continue
        from_to = (ends[0] - beyond[0], ends[1] - beyond[1], ends[2] + beyond[0], ends[3] + beyond[1])
        where, light = drawn((rows, cols), from_to, sigma, curve)
        image[where] += peak * scatter * light
        if whole:
            np.clip(np.rint(3.0 * image[where]) / 3.0, 0.0, 255.0, out=image[where])
        middles.append((row, col))
        yield {
            "ends": [round(e, 2) for e in ends],
            "length_px": length,
            "peak": peak,
            "sigma_px": sigma,
            "curve": curve,
            "crosses": crosses,
        }


def made(entry: dict[str, Any], source: Path, path: Path, number: int, seed: int, kind: Kind = METEORS) -> dict[str, Any] | None:
    """A frame with trails drawn into it, written to path; its entry, as an exam has it. None where there is no room."""
    image = np.array(fits.getdata(source), dtype=np.float64)
    if image.ndim != 2 or min(image.shape) < 100:
        return None
    rng = np.random.default_rng([seed, int(entry["sha256"][:8], 16)])
    trails = list(with_trails(image, number, rng, kind))
    if not path.exists():
        header = fits.getheader(source)
        for key in ("BZERO", "BSCALE", "BLANK"):
            header.remove(key, ignore_missing=True)
        fits.writeto(path, image.astype(np.float32), header, output_verify="silentfix+ignore")
    return {**entry, "trails": [t["ends"] for t in trails], "drawn": trails} if trails else None


def table_text(rows: list[tuple[dict[str, Any], Row]], kind: Kind = METEORS) -> str:
    """Shares that were measured and published, by what the trail and the frame are."""
    each = [
        {"trail": trail, "kind": entry["blank_kind"], **drawn_as}
        for entry, row in rows
        for drawn_as, trail in zip(entry["drawn"], row.trails, strict=True)
    ]

    def line(name: str, chosen: list[dict[str, Any]]) -> str:
        trails = [one["trail"] for one in chosen]
        measured, published = sum(t.found >= 0.5 for t in trails), sum(t.published >= 0.5 for t in trails)
        return f"| {name} | {share_text(measured, len(trails))} | {share_text(published, len(trails))} |"

    lines = ["| trails | measured | published |", "|---|---|---|", line("all", each)]
    for low, high in pairwise(kind.length_edges_px):
        for faint, bright in pairwise(kind.peak_edges):
            some = [one for one in each if low <= one["length_px"] < high and faint <= one["peak"] < bright]
            lines.append(line(f"{low:g} to {high:g} px, brightest pixel {faint:g} to {bright:g}", some))
    groups: list[tuple[str, str, object]] = [
        *((curve, "curve", curve) for curve in kind.curves),
        ("raw", "kind", "raw"),
        ("calibrated", "kind", "calibrated"),
    ]
    groups += [("from border to border", "crosses", True)] if kind.crossing > 0.0 else []
    lines += [line(name, [one for one in each if one[key] == value]) for name, key, value in groups]
    # where a border is masked, a trail that crosses it ends before
    ends = [inside for one in each if one["trail"].published >= 0.5 and not one["crosses"] for inside in one["trail"].inside]
    lines.append(f"Ends within 2 px or their interval: {share_text(sum(ends), len(ends))}.")
    lines.append(f"Published beside the trails: {sum(row.false for _, row in rows)} in {len(rows)} frames.")
    return "\n".join(lines)


def main() -> None:
    """Draw, process what was not yet, compare, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("exams", type=Path, nargs="+")
    parser.add_argument("--frames", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True, help="folder of the frames and runs")
    parser.add_argument("--each", type=int, default=3, help="trails of a frame")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kind", choices=sorted(KINDS), default="meteors", help="what is drawn")
    parser.add_argument("--fits", action="store_true", help="frames that came as FITS files alone, and no pictures")
    parser.add_argument("--only", default="", help="part of a file's name")
    parser.add_argument("--sboc", default=" ".join(COMMAND), help="the command that is measured")
    chosen = parser.parse_args()
    # others of these draw other trails, whose frames and runs are not those
    out = chosen.out / f"seed_{chosen.seed}_each_{chosen.each}_{chosen.kind}"
    (out / "frames").mkdir(parents=True, exist_ok=True)
    rows = []
    for entry in (e for exam in chosen.exams for e in json.loads(exam.read_text())):
        if entry["blank_kind"] is None or chosen.only not in entry["file"]:
            continue
        if chosen.fits and not entry["path"].lower().endswith(FITS_SUFFIXES):
            continue
        source, path = frame_of(entry, chosen.frames), out / "frames" / entry["file"]
        full = None if source is None else made(entry, source, path, chosen.each, chosen.seed, KINDS[chosen.kind])
        if full is not None:
            rows.append((full, processed(full, path, out / "runs" / path.stem, chosen.sboc.split())))
    report(table_text(rows, KINDS[chosen.kind]))


if __name__ == "__main__":
    main()
