"""Run by the peers' interpreter: GalSim frames of stamps (drawImage, method auto) with box streaks, CPU seconds of each."""

import json
import sys
import time
from pathlib import Path

import galsim
import numpy as np


def draw(size: int, stars: np.ndarray, streaks: list, sigma_px: float, seed: int) -> np.ndarray:
    """One frame: stars (n, 3) of row, col, electrons; streaks of row, col, length (px), angle (deg), electrons."""
    image = galsim.ImageF(size, size, scale=1.0, xmin=0, ymin=0)
    psf = galsim.Gaussian(sigma=sigma_px)
    for row, col, flux in stars:
        stamp = psf.withFlux(flux).drawImage(nx=15, ny=15, scale=1.0, center=galsim.PositionD(col, row), dtype=np.float32)
        bounds = stamp.bounds & image.bounds
        if bounds.isDefined():
            image[bounds] += stamp[bounds]
    for row, col, length, angle, flux in streaks:
        trail = galsim.Convolve(galsim.Box(length, 1e-3).rotate(angle * galsim.degrees), psf).withFlux(flux)
        stamp = trail.drawImage(scale=1.0, center=galsim.PositionD(col, row), dtype=np.float32)
        bounds = stamp.bounds & image.bounds
        if bounds.isDefined():
            image[bounds] += stamp[bounds]
    image += 2.8
    rng = galsim.BaseDeviate(seed)
    image.addNoise(galsim.CCDNoise(rng, gain=1.0, read_noise=2.3))
    adu = image.array / 1.2 + 100.0
    return np.clip(np.rint(adu), 0, 65535).astype(np.uint16)


def main() -> None:
    """Four frames; the first one fills GalSim's caches and is not counted."""
    question = json.loads(sys.stdin.read())
    stars, costs, mean = np.array(question["stars"]), [], 0.0
    for k in range(4):
        begin = time.process_time()
        mean = float(draw(question["size"], stars, question["streaks"], question["sigma_px"], 1 + k).mean())
        costs.append(time.process_time() - begin)
    # Not getrusage: its peak starts from the process that started this one.
    peak_mb = float(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0]) / 1024
    Path(sys.argv[1]).write_text(json.dumps({"cpu_s": costs[1:], "first_cpu_s": costs[0], "mean": mean, "peak_mb": peak_mb}))


if __name__ == "__main__":
    main()
