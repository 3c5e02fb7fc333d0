"""A small finished run directory without a chain: synthetic truth, products with one miss and one false alarm."""

import json
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table

from sboc_e2e.report.write import write_report
from sboc_e2e.score import score_run
from tests.score.conftest import SHAPE, Synthetic


@pytest.fixture(scope="session")
def reported_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run directory with score.json and both reports."""
    run_dir = tmp_path_factory.mktemp("run")
    synthetic = Synthetic(4)
    for name in ("truth", "products", "frames", "calibration"):
        (run_dir / name).mkdir()
    for name, table in synthetic.tables.items():
        table.write(run_dir / "truth" / f"{name}.ecsv", format="ascii.ecsv")
    streaks = synthetic.perfect_streaks()
    for end in ("0", "1"):
        streaks[f"ra{end}_deg"], streaks[f"dec{end}_deg"] = streaks["ra_mid_deg"] + 0.01 * int(end), streaks["dec_mid_deg"]
    streaks["row_mid"], streaks["col_mid"] = (streaks["row0"] + streaks["row1"]) / 2, (streaks["col0"] + streaks["col1"]) / 2
    streaks["row0"][0] += 60.0  # one streak misses its truth and is a false alarm instead
    streaks.write(run_dir / "products" / "streaks.ecsv", format="ascii.ecsv")
    frames = Table({"frame": np.arange(4), "rows": [SHAPE[0]] * 4, "cols": [SHAPE[1]] * 4, "flags": [1 << 17] * 4})
    frames["zero_point_mag"] = np.nan
    frames.write(run_dir / "products" / "frames.ecsv", format="ascii.ecsv")
    for name in ("orbits", "tracklets"):
        Table({"tracklet_id": np.zeros(0, int)}).write(run_dir / "products" / f"{name}.ecsv", format="ascii.ecsv")
    rng = np.random.default_rng(4)
    for k in range(4):
        pixels = rng.normal(100, 3, SHAPE).astype(np.uint16)
        fits.writeto(run_dir / "frames" / f"{k:06d}.fits", pixels)
    fits.writeto(run_dir / "calibration" / "dark.fits", np.full(SHAPE, 64, np.float32))
    (run_dir / "downlink.bin").write_bytes(b"")
    (run_dir / "manifest.json").write_text(json.dumps({"frame_rate_hz": 4.0, "stages": {}, "note": "</script> & <b>"}))
    (run_dir / "score.json").write_text(json.dumps(score_run(run_dir)))
    write_report(run_dir)
    return run_dir
