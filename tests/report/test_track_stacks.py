"""Pictures of tracklets that no single frame shows: strips lie on each other, and their sum shows the object."""

from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table
from numpy.typing import NDArray

from sboc_e2e.report import track_stacks
from sboc_e2e.report.track_stacks import ACROSS_PX, ALONG_PX, MARGIN

N, LENGTH_PX, SNR, SIGMA = 7, 60.0, 4.0, 0.85
SIDE = 300


def ends_of(frame: int) -> NDArray[np.float64]:
    """A trail of LENGTH_PX at 30 degrees that moves on, and two px of jitter."""
    u = np.array([0.5, np.sqrt(0.75)])
    start = np.array([60.0, 30.0]) + 22.0 * frame * u + np.array([2.0 * (frame % 2), -1.0])
    return np.array([start, start + LENGTH_PX * u])


def frames(folder: Path, seed: int, snr: float) -> dict[int, Path]:
    """Noise of 3 ADU, the trail at the given S/N in each, and a fixed pattern that the dark holds."""
    rng = np.random.default_rng(seed)
    row, col = np.indices((SIDE, SIDE), dtype=float)
    out = {}
    for k in range(N):
        (r0, c0), (r1, c1) = ends_of(k)
        u = np.array([r1 - r0, c1 - c0]) / LENGTH_PX
        along, across = (row - r0) * u[0] + (col - c0) * u[1], (col - c0) * u[0] - (row - r0) * u[1]
        profile = np.exp(-0.5 * (across / SIGMA) ** 2) * ((along > 0.0) & (along < LENGTH_PX))
        light = 3.0 * snr * profile / np.sqrt((profile**2).sum())
        pixels = np.rint(500.0 + rng.normal(0.0, 3.0, (SIDE, SIDE)) + light)
        out[k] = folder / f"{k:06d}.fits"
        fits.writeto(out[k], pixels.astype(np.uint16))
    return out


def streaks(snr: float) -> Table:
    """Members of one tracklet, ends of every other one named the other way round, and one bright tracklet."""
    t = Table(names=("frame", "row0", "col0", "row1", "col1", "snr", "tracklet_id", "t0_tai_ns", "t1_tai_ns"),
              dtype=(int, float, float, float, float, float, int, int, int))  # fmt: skip
    for k in range(N):
        ends = ends_of(k)[:: -1 if k % 2 else 1]
        t.add_row((k, *ends[0], *ends[1], snr, 3, 5 + 2 * (k % 2), 6))
        t.add_row((k, 200.0, 20.0, 220.0, 40.0, 30.0, 4, 0, 1))
    return t


def shown(folder: Path, seed: int) -> tuple[list[NDArray[np.float32]], NDArray[np.float32]]:
    """Strips and their sum."""
    kept, table = frames(folder, seed, SNR), streaks(SNR)
    (rows,) = track_stacks.faint_tracks(table, set(kept))
    strips = [
        track_stacks.strip(fits.getdata(kept[int(table["frame"][row])]).astype(np.float32), track_stacks.in_time(table, int(row)))
        for row in rows
    ]
    return strips, track_stacks.stacked(strips)


def on_trail(values: NDArray[np.float32]) -> float:
    """S/N of the sum along the middle line between the trail's ends, noise from lines beside it."""
    first = round(ALONG_PX * MARGIN / (1.0 + 2.0 * MARGIN))
    sums = values[:, first : ALONG_PX - first].sum(axis=1)
    beside = np.concatenate([sums[: ACROSS_PX // 2 - 3], sums[ACROSS_PX // 2 + 4 :]])
    return float((sums[ACROSS_PX // 2] - np.median(beside)) / beside.std(ddof=1))


def test_the_sum_shows_what_its_strips_do_not(tmp_path: Path) -> None:
    """S/N 4 in each of seven frames is 10.6 in all: the line stands out of those beside it as root 7 more than in a strip."""
    ratios = []
    for seed in range(4):
        (folder := tmp_path / str(seed)).mkdir()
        strips, total = shown(folder, seed)
        assert all(each.shape == (ACROSS_PX, ALONG_PX) for each in (*strips, total))
        middle = ALONG_PX // 2
        assert total.mean(axis=1).argmax() == ACROSS_PX // 2
        # the trail covers the middle of the strip and ends there
        light = total[ACROSS_PX // 2 - 1 : ACROSS_PX // 2 + 2].mean(axis=0)
        assert light[middle - 30 : middle + 30].mean() > 1.0 + abs(light[:25].mean())
        ratios.append(on_trail(total) / np.mean([on_trail(each) for each in strips]))
    assert np.mean(ratios) == pytest.approx(np.sqrt(N), rel=0.3)


def test_a_trail_that_leaves_the_frame_is_drawn_as_far_as_it_goes() -> None:
    rng = np.random.default_rng(1)
    image = rng.normal(100.0, 3.0, (80, 80)).astype(np.float32)
    part = track_stacks.strip(image, np.array([[40.0, 60.0], [40.0, 160.0]]))
    assert np.isfinite(part).all()
    assert part[:, :20].std() == pytest.approx(1.0, abs=0.6)


def test_bright_tracklets_and_lone_members_have_no_picture(tmp_path: Path) -> None:
    kept = frames(tmp_path, 9, SNR)
    (only,) = track_stacks.track_stacks(streaks(SNR), kept, None)
    assert (only.tracklet, only.frames, only.joint_snr) == (3, tuple(range(N)), round(SNR * N**0.5, 1))
    assert only.picture.startswith("data:image/png;base64,")
    assert only.length_px == LENGTH_PX
    assert track_stacks.track_stacks(streaks(8.0), kept, None) == []
    assert track_stacks.track_stacks(streaks(SNR), {0: kept[0]}, None) == []
