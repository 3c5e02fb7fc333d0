"""A published SP3 file in which one object leaves its orbit in the last tenth of the day."""

from pathlib import Path

from ground.determination.precise import uncompressed
from tests.conjunctions.reference import folder


def burnt_table(name: str, out: Path) -> Path:
    """GFZ's file of 2015-05-05 as `out`, with an object that moves off at 10 m/s along an Earth-fixed axis from 21:40 on."""
    source = folder("sp3") / "gbm18432.sp3.Z"
    lines = uncompressed(source.read_bytes(), source.name).decode("ascii").splitlines()
    epoch = -1
    for k, line in enumerate(lines):
        epoch += line.startswith("*")
        if line.startswith(f"P{name}") and epoch >= 260:
            x_km = float(line[4:18]) + 1e-2 * 300.0 * (epoch - 259)
            lines[k] = f"{line[:4]}{x_km:14.6f}{line[18:]}"
    out.write_text("\n".join(lines) + "\n", encoding="ascii")
    return out
