"""A synthetic run whose scores are known: straight trails, products made from them with chosen errors."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest
from astropy.table import Table

from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.signals import Detection, RoiGroup, Strip
from sboc_e2e.score.evaluation import Evaluation, assemble, truth_streaks
from sboc_e2e.truth import PATH_NODES, empty
from tests.downlink import bare_frame

SHAPE = (256, 256)
PIXEL_ARCSEC = 4.64
SIGMA_PX = 0.85
START_NS = 2_179_000_000_000_000_000


@dataclass
class Synthetic:
    """Truth of `n_frames` frames and products to be scored against it."""

    n_frames: int
    objects_per_frame: int = 3
    snr: float = 20.0
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(7))

    def __post_init__(self) -> None:
        n = self.n_frames * self.objects_per_frame
        t = empty("streaks", n)
        t["frame"] = np.repeat(np.arange(self.n_frames), self.objects_per_frame)
        t["object_id"] = np.tile(np.arange(self.objects_per_frame), self.n_frames)
        # Objects run in separate lanes, so that no pair of trails can be confused.
        lane = SHAPE[0] / self.objects_per_frame
        t["row0"] = (t["object_id"] + 0.5) * lane + self.rng.uniform(-3, 3, n)
        t["row1"] = t["row0"] + 12.0
        t["col0"] = self.rng.uniform(40, 60, n)
        t["col1"] = t["col0"] + 80.0
        t["t0_tai_ns"] = START_NS + t["frame"].astype(np.int64) * 250_000_000
        t["t1_tai_ns"] = t["t0_tai_ns"] + 200_000_000
        t["length_px"] = np.hypot(t["row1"] - t["row0"], t["col1"] - t["col0"])
        t["flux_e"], t["snr"], t["psf_sigma_px"] = 2000.0, self.snr, SIGMA_PX
        t["rate_deg_s"], t["range_km"], t["mag"] = 0.5, 500.0, 11.0
        node = np.linspace(0, 1, PATH_NODES)
        t["path_row"] = t["row0"][:, None] + node * (t["row1"] - t["row0"])[:, None]
        t["path_col"] = t["col0"][:, None] + node * (t["col1"] - t["col0"])[:, None]
        t["path_flux_e_s"] = 10_000.0
        t["path_t_tai_ns"] = t["t0_tai_ns"][:, None] + (node * 200_000_000).astype(np.int64)
        t["path_ra_deg"] = 130.0 - t["path_col"] * PIXEL_ARCSEC / 3600.0
        t["path_dec_deg"] = t["path_row"] * PIXEL_ARCSEC / 3600.0
        frames = empty("frames", self.n_frames)
        frames["frame"] = np.arange(self.n_frames)
        frames["entropy_bits"], frames["zero_point_mag"] = 3.29, 21.7
        objects = empty("objects", self.objects_per_frame)
        objects["object_id"] = np.arange(self.objects_per_frame)
        objects["kind"], objects["size_m"], objects["weight"] = "population", 0.05, 0.01
        objects["a_km"], objects["i_deg"] = 7200.0, 98.0
        self.tables = {"streaks": Table(t), "frames": Table(frames), "objects": Table(objects)}

    def perfect_streaks(self) -> Table:
        """Products that repeat the truth, direction and tracklets included."""
        t = self.tables["streaks"]
        out = Table({name: np.asarray(t[name]) for name in ("frame", "row0", "col0", "row1", "col1", "length_px", "snr", "mag")})
        n = len(t)
        middle = PATH_NODES // 2
        out["row_mid"], out["col_mid"] = t["path_row"][:, middle], t["path_col"][:, middle]
        out["streak_id"] = np.arange(n)
        out["tracklet_id"] = np.asarray(t["object_id"])
        out["ra_mid_deg"], out["dec_mid_deg"] = t["path_ra_deg"][:, middle], t["path_dec_deg"][:, middle]
        out["t_mid_tai_ns"] = t["path_t_tai_ns"][:, middle]
        out["sigma_cross_px"], out["sigma_cross_arcsec"], out["sigma_along_arcsec"] = 0.1, 0.5, 2.0
        out["mag_err"], out["sagitta_px"] = 0.05, 0.0
        out["flags"] = np.full(n, int(StreakFlag.DIRECTION_RESOLVED))
        return out

    def rois(self, shift_px: float = 0.0, flags: StreakFlag = StreakFlag(0)) -> list[DownlinkFrame]:  # noqa: B008 - immutable
        """Downlinked frames whose strips follow the true trails, moved across by `shift_px`; `flags` as set on board."""
        out = []
        t = self.tables["streaks"]
        for frame in range(self.n_frames):
            header = FrameHeader(
                frame=frame, t_start_tai_ns=START_NS, exposure_ns=200_000_000, line_time_ns=0, rows=SHAPE[0], cols=SHAPE[1]
            )
            groups = []
            for k, s in enumerate(t[np.asarray(t["frame"]) == frame]):
                slope = (s["row1"] - s["row0"]) / (s["col1"] - s["col0"])
                major0, n = int(s["col0"]) - 8, 98
                minor0 = s["row0"] + (major0 - s["col0"]) * slope - 7 + shift_px
                strip = Strip(
                    axis=1, major0=major0, minor0_fp=round(minor0 * 65536), slope_fp=round(slope * 65536), level_adu=0,
                    values_adu=np.zeros((n, 15), np.int32),
                )  # fmt: skip
                detection = Detection(row0=s["row0"], col0=s["col0"], row1=s["row1"], col1=s["col1"], snr=s["snr"], flags=flags)
                groups.append(RoiGroup(roi_id=k, detection=detection, strips=(strip,), n_strips=1))
            out.append(bare_frame(header, rois=tuple(groups)))
        return out

    def evaluation(self, streaks: Table, frames: list[DownlinkFrame] | None = None) -> Evaluation:
        """Everything matched; frame solutions and orbits are absent."""
        products = {
            "streaks": streaks,
            "frames": Table(names=["frame", "rows", "cols", "flags", "zero_point_mag"], dtype=[int, int, int, int, float]),
            "orbits": Table(),
            "tracklets": Table(),
        }
        tables = self.tables
        return assemble(truth_streaks(tables["streaks"]), tables, products, b"", frames or [], SHAPE, {"frame_rate_hz": 4.0})


@pytest.fixture
def synthetic() -> Callable[..., Synthetic]:
    """Factory of synthetic runs."""
    return Synthetic
