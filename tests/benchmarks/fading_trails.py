"""Ends of drawn trails that fade, end or cross a frame, as frames from outside are measured.

``python -m tests.benchmarks.fading_trails --seeds 40 --kinds vignetted uniform`` prints, for each kind, how many trails were
measured, how many of their ends lie within 2 px or the quoted interval of the true ones, and how many intervals exceed 20 px.

Each frame of 512 x 512 px holds one trail, stars and noise, drawn here with numpy and by nothing of the simulator. The true
end of a trail that goes on to the border is the border, however faint it is there.

vignetted : sky and trail fall to a few per cent along the corners. crossing : uniform, from border to border.
uniform : uniform, both ends inside. Fits were made with these three in view. The others were drawn afterwards:
decaying : falls exponentially to the border. penumbra : fades out inside. lobe : a Gaussian of light, which the frame cuts.
"""

import argparse
import math
import sys
from dataclasses import dataclass
from typing import Final

import numpy as np
from astropy.table import Table
from numpy.typing import NDArray
from scipy.special import erf

from ground.products import tables
from sboc_e2e import scenario as scenarios
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.outside import one_step
from sboc_e2e.outside.process import base_document
from sboc_e2e.registry import Registry
from sboc_e2e.run.ground_stage import ground_chain
from tests.benchmarks.sky_frames import add_points

SIDE_PX: Final = 512
SKY_E: Final = 400.0
PEDESTAL: Final = 1_000.0
READ_NOISE_E: Final = 8.0
FWHM_PX: Final = 2.8
SIGMA_PX: Final = FWHM_PX / 2.3548
STARS: Final = 120
NEAR_PX: Final = 2.0
BESIDE_PX: Final = 6.0
WIDE_PX: Final = 20.0
TUNED: Final = ("vignetted", "crossing", "uniform")
KINDS: Final = (*TUNED, "decaying", "penumbra", "lobe")

Light = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Drawn:
    """A frame (rows, cols) uint16 and the true ends (row0, col0, row1, col1) of its trail."""

    pixels: NDArray[np.uint16]
    ends: tuple[float, float, float, float]


def border_of(row: float, col: float, angle_rad: float, side: int = SIDE_PX) -> tuple[float, float]:
    """Distances along a line from a point to the borders, backwards (negative) and forwards."""
    low, high = -math.inf, math.inf
    for place, way in ((row, math.sin(angle_rad)), (col, math.cos(angle_rad))):
        if abs(way) > 1e-9:
            a, b = sorted(((-0.5 - place) / way, (side - 0.5 - place) / way))
            low, high = max(low, a), min(high, b)
    return low, high


def drawn(kind: str, seed: int) -> Drawn:
    """One frame of a kind."""
    random = np.random.default_rng((KINDS.index(kind), seed))
    row, col = random.uniform(0.3, 0.7, 2) * SIDE_PX
    angle = random.uniform(0.0, math.pi)
    low, high = border_of(row, col, angle)
    y, x = np.mgrid[:SIDE_PX, :SIDE_PX].astype(np.float64)
    open_share = np.ones((SIDE_PX, SIDE_PX))
    start, stop = low - 10.0, high + 10.0
    u = (x - col) * math.cos(angle) + (y - row) * math.sin(angle)
    v = (y - row) * math.cos(angle) - (x - col) * math.sin(angle)
    bright = np.ones_like(u)
    if kind == "vignetted":
        radius = np.hypot(y - random.normal(255.5, 15.0), x - random.normal(255.5, 15.0))
        open_share = 0.03 + 0.97 / (1.0 + np.exp((radius - random.uniform(200.0, 260.0)) / random.uniform(12.0, 40.0)))
        bright = open_share
    elif kind == "uniform":
        start, stop = random.uniform(0.2, 0.9) * low, random.uniform(0.2, 0.9) * high
    elif kind == "decaying":
        bright = np.exp(-(u - low) / random.uniform(50.0, 200.0))
    elif kind == "penumbra":
        stop = random.uniform(0.4, 0.9) * high
        bright = np.clip((stop - u) / random.uniform(30.0, 200.0), 0.0, 1.0)
    elif kind == "lobe":
        bright = np.exp(-0.5 * ((u - random.uniform(-60.0, 60.0)) / random.uniform(40.0, 120.0)) ** 2)
    noise_e = math.sqrt(SKY_E + READ_NOISE_E**2)
    # S/N of 200 px of the full trail, 15 to 300
    density = math.exp(random.uniform(math.log(15.0), math.log(300.0))) * noise_e * math.sqrt(
        2.0 * math.sqrt(math.pi) * SIGMA_PX / 200.0
    )  # fmt: skip
    light = SKY_E * open_share
    root = math.sqrt(2.0) * SIGMA_PX
    profile = 0.5 * (erf((v + 0.5) / root) - erf((v - 0.5) / root))
    light += density * bright * profile * 0.5 * (erf((u - start) / root) - erf((u - stop) / root))
    flux = noise_e * FWHM_PX * 8.0 * random.pareto(0.9, STARS).clip(max=300.0)
    stars = np.zeros_like(light)
    star_row, star_col = random.uniform(0.0, SIDE_PX, (2, STARS))
    add_points(stars, star_row, star_col, flux, FWHM_PX)
    light += stars * open_share
    counts = PEDESTAL + random.poisson(light) + random.normal(0.0, READ_NOISE_E, light.shape)
    start, stop = max(start, low), min(stop, high)
    ends = (
        row + start * math.sin(angle),
        col + start * math.cos(angle),
        row + stop * math.sin(angle),
        col + stop * math.cos(angle),
    )
    return Drawn(pixels=np.clip(np.rint(counts), 0, 65535).astype(np.uint16), ends=ends)


def streaks_of(pixels: NDArray[np.uint16], *, fading_ends: bool = True) -> Table:
    """Measured streaks of one image, as `sboc process` measures them without its count of look-alikes."""
    frame, _ = one_step._frame(pixels, 1.0, READ_NOISE_E, None, 1.0)
    document = base_document("none")
    document["ground"]["streak_fitter"]["fading_ends"] = fading_ends
    scenario = scenarios.bare("fading_trails", document, registry=Registry())
    _, (camera, packets) = one_step._on_board(frame, scenario, scenario.step("onboard.detector"))
    chain = ground_chain(scenario, calibration=None, camera=camera, catalogue=StarCatalogue.embedded(), run_id=one_step.RUN_ID)
    frames, report = chain.ingest(packets)
    _, products = chain.process_frame(chain.initial_state(), frames[0])
    (table,) = tables.streaks_tables(chain.finish(frames, [products], report))
    return table


def off_px(streak: object, ends: tuple[float, float, float, float]) -> list[tuple[float, float, bool]] | None:
    """Of each end: its distance outwards (px) from the true one, the side of its interval towards that, and whether it holds it;
    None where the streak is not on the trail's line. Ends on a border and beyond are on it."""
    s = streak
    true = np.array(ends).reshape(2, 2)
    found = np.array([[s["row0"], s["col0"]], [s["row1"], s["col1"]]])  # type: ignore[index]
    along = (true[1] - true[0]) / np.linalg.norm(true[1] - true[0])
    across = (found - true[0]) @ np.array([-along[1], along[0]])
    if np.abs(across).max() > BESIDE_PX:
        return None
    swapped = (found[1] - found[0]) @ along < 0.0
    out = []
    for end in (0, 1):
        k = 1 - end if swapped else end
        sign = -1.0 if end == 0 else 1.0
        outwards = float((found[k] - true[end]) @ along) * sign
        edge = int(s["flags"]) & (StreakFlag.EDGE0 if k == 0 else StreakFlag.EDGE1)  # type: ignore[index]
        if edge and outwards > 0.0:
            outwards = 0.0
        low, high = float(s[f"end{k}_low_px"]), float(s[f"end{k}_high_px"])  # type: ignore[index]
        room = high if outwards < 0.0 else -low
        room = room if math.isfinite(room) else 0.0
        out.append((outwards, room, abs(outwards) <= max(NEAR_PX, room)))
    return out


def main() -> None:
    """Draw, measure, compare, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=30)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS)
    parser.add_argument("--each", action="store_true", help="a line for each trail")
    parser.add_argument("--without", action="store_true", help="fits as they are before ends that fade are followed")
    arguments = parser.parse_args()
    for kind in arguments.kinds:
        measured, held, ends, wide, off = 0, 0, 0, 0, []
        for seed in range(arguments.first, arguments.first + arguments.seeds):
            frame = drawn(kind, seed)
            on = [
                (s, o)
                for s in streaks_of(frame.pixels, fading_ends=not arguments.without)
                if (o := off_px(s, frame.ends)) is not None
            ]
            if not on:
                continue
            streak, of = max(on, key=lambda pair: float(pair[0]["snr"]))
            measured += 1
            ends += 2
            held += sum(each[2] for each in of)
            wide += sum(each[1] > WIDE_PX for each in of)
            off += [each[0] for each in of]
            if arguments.each:
                words = " ".join(f"{o:+.1f}({r:.1f}){'' if inside else '!'}" for o, r, inside in of)
                of_trail = f"S/N {streak['snr']:.0f} p {streak['probability']:.2f} flags {int(streak['flags']):#x}"
                sys.stdout.write(f"  {kind} {seed}: {of_trail} {words}\n")
        middle = float(np.median(np.abs(off))) if off else math.nan
        sys.stdout.write(
            f"{kind}: {measured} of {arguments.seeds} measured, {held} of {ends} ends hold, "
            f"{wide} intervals over {WIDE_PX:g} px, median off {middle:.2f} px\n"
        )
        sys.stdout.flush()


if __name__ == "__main__":
    main()
