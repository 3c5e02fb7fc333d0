"""docs/flight.md: work limits, counts by stage and the table of parameters, from the code.

``python -m sboc_e2e.bench.flight_page docs/flight.md`` writes the page; a test holds it to the code.
"""

import argparse
import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from onboard import work
from onboard.options import DownlinkOptions, RoiOptions
from sboc_e2e.bench import flight_vectors
from sboc_e2e.icd.work import Work
from sboc_e2e.registry import SEAMS, Registry
from sboc_e2e.scenario.option_models import option_fields, to_document

MPX: Final = 1024 * 1024  # Pixels of the megapixel that the page's times are for: a frame of the smallest side below.
SIDES: Final = (1024, 2048, 4096)  # Sides (px) of the frames in the table of limits; the largest is the frame of `sboc_like`.


@dataclass(frozen=True, kw_only=True)
class Pass:
    """A pass over every pixel. operations : adds, products, comparisons and conversions per pixel, counted by hand in the inner
    loops for a PSF of 2 px FWHM; traffic : bytes read and written per pixel; lines : rows held at once; arithmetic : of data."""

    name: str
    module: str
    operations: float
    traffic: float
    lines: str
    arithmetic: str


PASSES: Final = (
    Pass(name="background mesh, one row of eight", module="image/background", operations=0.8, traffic=0.6, lines="64",
         arithmetic="16-bit counts in 32-bit histograms"),
    Pass(name="dead and saturated areas, glare", module="image/dead_area, image/glare", operations=3, traffic=4, lines="1",
         arithmetic="8 bit"),
    Pass(name="calibrated image and row sums", module="image/calibrate", operations=16, traffic=10, lines="1",
         arithmetic="16-bit counts - dark in 1/128 ADU, then float32"),
    Pass(name="star peaks: 5 + 5 taps, maxima", module="stars/peaks", operations=23, traffic=4, lines="7", arithmetic="float32"),
    Pass(name="level and noise beside the stars", module="image/star_free_sky", operations=6, traffic=9, lines="32",
         arithmetic="float32"),
    Pass(name="image in sigma/16", module="detect/whiten", operations=4, traffic=6, lines="1", arithmetic="to int8, clipped"),
    Pass(name="kept frame", module="detect/line_integral/kept_frame", operations=5, traffic=6, lines="1",
         arithmetic="to int8, and a table of what lies beyond"),
    Pass(name="faint static stars: both frames smoothed", module="detect/line_integral/static_sky", operations=40, traffic=4,
         lines="64 + margin", arithmetic="int8 x int16 taps in int16 and int32"),
    Pass(name="level of tiles", module="detect/whiten", operations=2, traffic=2, lines="64", arithmetic="int8 in int32"),
    Pass(name="smoothed and binned 2 x 2", module="detect/whiten", operations=20, traffic=1.5, lines="6",
         arithmetic="int8 x int16 taps in int16 and int32, to int16"),
    Pass(name="dyadic line sums, four quadrants", module="detect/line_integral/dyadic", operations=27, traffic=66,
         lines="the frame at half resolution, and 1.3 times as much", arithmetic="int16, halved after 64 and 512 rows"),
    Pass(name="smoothed at full resolution", module="detect/whiten", operations=17, traffic=2, lines="5",
         arithmetic="int8 x int16 taps in int16 and int32, to int8"),
)  # fmt: skip

HEAD = """# Fit to fly: work, memory, latency, parameters

Generated from the code by `python -m sboc_e2e.bench.flight_page docs/flight.md`. What is measured says with what; what is
derived from counts says so. Nothing here was run on flight hardware.

## Work has a limit

Work is counted in operations, so that the same frame gives the same bytes on any machine (`onboard/work.py`,
`sboc_e2e/icd/work.py`). An operation is one value read and combined as a loop without vector instructions does it; on the
machine of the benchmark it takes about 1 ns. A frame's nominal work is {fixed} + {per_px} per pixel. Its limit is twice
that: the passes over every pixel, which are the same for every input, and a limit for each kind of work that grows with
what the frame shows.

{limits}

In order, first what is left first:

1. **Star list.** Beyond its limit the brightest entries of each of 8 x 8 parts of the field, in turn, are fitted; the next
   ones are listed with their pixel (flag `BLENDED`); the rest is not listed.
2. **Halos.** Faint ones of the bright stars keep the mask of the core.
3. **Candidates.** The best of each octave of length in turn; a search ends, the rest is left.
4. **Points.** New star-like entries, the faintest first.
5. **Trails.** Each octave of length in turn, the most significant first: many short ones cannot push a long one out.
6. **Regions.** Every second place goes to the best of each kind by length and ninth of the field in turn, the others by
   S/N.

Whatever is left is counted in the header packet and in `frames.ecsv` (`shed_*`, `operations`) and flags the frame
`WORK_SHED`. `python -m tests.benchmarks.fuzz_work` draws frames that nobody should send and prints the worst.

## Passes over every pixel

Scalar operations and bytes per pixel, counted by hand in the source, some of them estimated; vector units do several at once.

{passes}

Counted so: {operations:.0f} million operations and {traffic:.0f} MB for each megapixel; the line sums move more than half of
all bytes. Rows are taken as they come where the last column says so; the dyadic sums need the half-resolution frame, and
the comparison with the frame before needs that frame in eight bits.

## What that means (derived, not run)

- **GR740** (four LEON4FT at 250 MHz, 16 KiB of data cache each, 2 MiB shared, 64-bit PC100 SDRAM, no vector unit;
  GR740-UM-DS 1.7, 2017; 1.7 DMIPS/MHz for the LEON4 according to its vendor). With two instructions for an operation of a
  pass the passes take {leon:.1f} s for each megapixel and core, the nominal rest some {leon_rest:.1f} s at four cycles an
  operation. A 4096 x 4096 frame takes {leon_frame:.0f} s on four cores: it may process every {leon_every:.0f}th frame of
  four a second, or windows of 1024 x 1024 px. The bytes of the passes alone keep its memory (800 MB/s at most) busy for
  {leon_memory:.1f} s a frame.
- **Cortex-A53** (in order, two instructions at once, 128-bit NEON; assumed 1.2 GHz). With eight lanes of 16 bits at half
  efficiency the passes take {arm:.2f} s for each megapixel and core, the rest {arm_rest:.2f} s at three cycles an
  operation; {arm_frame:.1f} s for 4096 x 4096 on four cores.
- **FPGA**: the passes up to the line sums are streams with 1 to 64 lines of memory, integer from the image in sigma/16 on.
  At one pixel a clock of 150 MHz a 4096 x 4096 frame streams in 0.11 s. The line sums need {dyadic:.0f} MB of memory and 66
  bytes of traffic a pixel (1.1 GB a frame), seven elevenths of it in the 1.1 MB that blocks of up to 128 rows take. Fits,
  search and tests of candidates stay on the processor.

**Latency**: a frame's packets follow from that frame and what is remembered of those before, and leave at once. A frame that has
no predecessor with the same stars, the first of a run or of a new direction, waits for the next one and is held against that
(`onboard/latency.py`); its packets leave one frame later, before those of the next. While it waits its pixels stay in memory as
they came, two bytes each. The step that ends the wait judges two frames and calibrates three times, as the newer one is looked
at before and after; each frame keeps its own limit. Frames that share no stars at all wait one after the other, and each is
calibrated twice.

**The number of a set of parameters**: the CRC-32 of all options below and of the steps' names, in every header packet
(`parameter_set`) and in `frames.ecsv`.

## Golden vectors

`tests/golden/flight` holds inputs and outputs of each stage for frames of {vector_side} x {vector_side} px, in npz files: a zip
of NumPy's npy arrays, each with type and shape in its header, little endian, no pickles; arrays `in_*` and `out_*`. The inputs
of a stage stand beside its outputs, so each can be ported alone. `python -m sboc_e2e.bench.flight_vectors tests/golden/flight`
writes them anew, after a change of a stage or of a default (`packets` has the number of the set of parameters);
`pytest tests/bench/test_flight_vectors.py` holds the stages to them: whole numbers to the bit, floating-point ones to 1e-6.
Integer stages are exact on any machine. Those with floating point are exact, with the versions of `requirements.lock`, on the
processor that made them. On another x86-64 processor compiled code takes sums in another order: the places of stars differ by
2e-7 px. On other machines an integer that is rounded from a float may differ by one.

{vectors}

## Parameters

{parameters}"""


def _limits() -> str:
    rows = [
        "| kind | fixed | per pixel | " + " | ".join(f"{s} x {s} px" for s in SIDES) + " |",
        "|---|---|---|" + "---|" * len(SIDES),
    ]
    cells = " | ".join(f"{work.REGULAR_PER_PX * s * s / 1e6:.0f} M" for s in SIDES)
    rows.append(f"| passes over every pixel | 0 | {work.REGULAR_PER_PX} | {cells} |")
    for kind in Work:
        fixed, each = work.LIMITS[kind]
        cells = " | ".join(f"{(fixed + each * s * s) / 1e6:.0f} M" for s in SIDES)
        rows.append(f"| {kind.value} | {fixed / 1e6:.0f} M | {each} | {cells} |")
    cells = " | ".join(f"{2 * work.nominal(s * s) / 1e6:.0f} M" for s in SIDES)
    rows.append(f"| **twice the nominal work** | {2 * work.NOMINAL_FIXED / 1e6:.0f} M | {2 * work.NOMINAL_PER_PX} | {cells} |")
    return "\n".join(rows)


def _passes() -> str:
    rows = ["| pass | `onboard/` | operations | bytes | lines held | arithmetic |", "|---|---|---|---|---|---|"]
    rows += [f"| {p.name} | `{p.module}` | {p.operations:g} | {p.traffic:g} | {p.lines} | {p.arithmetic} |" for p in PASSES]
    return "\n".join(rows)


def _table(title: str, options: Any) -> str:
    shown = to_document(options)
    rows = [f"### {title}\n", "| parameter | default | meaning and range |", "|---|---|---|"]
    step: type = type(options)
    for option in option_fields(step):
        default = f"`{shown.get(option.key)}`".replace("|", "/")
        rows.append(f"| `{option.key}` | {default} | {option.doc} |")
    return "\n".join(rows) + "\n"


def _parameters() -> str:
    registry = Registry()
    parts = [_table("onboard.roi", RoiOptions()), _table("onboard.downlink", DownlinkOptions())]
    for name, seam in SEAMS.items():
        if name.startswith("onboard."):
            step = registry.resolve(name, seam.default)()
            if dataclasses.fields(step):
                parts.append(_table(f"{name} = {seam.default}", step))
    return "\n".join(parts)


def page() -> str:
    """The whole page."""
    operations, traffic = sum(p.operations for p in PASSES), sum(p.traffic for p in PASSES)
    rest = work.NOMINAL_PER_PX - work.REGULAR_PER_PX
    frame = 16.0
    leon, leon_rest = 2.0 * operations * MPX / 250e6, 4.0 * rest * MPX / 250e6
    arm, arm_rest = operations / 4.0 * MPX / 1.2e9, 3.0 * rest * MPX / 1.2e9
    leon_frame = frame * (leon + leon_rest) / 4.0
    return HEAD.format(
        fixed=f"{work.NOMINAL_FIXED / 1e6:.0f} million",
        per_px=work.NOMINAL_PER_PX,
        limits=_limits(),
        passes=_passes(),
        operations=operations * MPX / 1e6,
        traffic=traffic * MPX / 1e6,
        leon=leon,
        leon_rest=leon_rest,
        leon_frame=leon_frame,
        leon_every=4.0 * leon_frame,
        leon_memory=frame * traffic * MPX / 800e6,
        arm=arm,
        arm_rest=arm_rest,
        arm_frame=frame * (arm + arm_rest) / 4.0,
        dyadic=2 * 0.25 * frame * 2.34,
        parameters=_parameters(),
        vectors=flight_vectors.table(),
        vector_side=flight_vectors.SIDE,
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m sboc_e2e.bench.flight_page", description="Write the page of flight figures.")
    parser.add_argument("page", type=Path, help="the page's file, docs/flight.md")
    parser.parse_args().page.write_text(page(), encoding="utf-8")
