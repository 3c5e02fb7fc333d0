"""Star list: unbiased, at the Cramer-Rao bound, with measured shapes; nothing invented on empty sky."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from onboard.image.background import MeshBackground, continued
from onboard.image.calibrate import residual_pass
from onboard.image.dark_map import DarkMap
from onboard.stars.fits import fit_stars
from onboard.stars.matched import MatchedStars, best_spread, falling
from onboard.stars.trail_vectors import fitted_vectors
from sboc_e2e.icd.flags import MaskBit, StarFlag
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.signals import DetectorView, StarList, StarMotion
from tests.onboard.star_fields import (
    GAIN_E_ADU,
    PEDESTAL_ADU,
    SKY_E,
    StarField,
    axis_weights,
    centroid_bound_px,
    matched_snr,
    star_grid,
)

SIGMA_PX = 0.849


def view_of(pixels: NDArray[np.uint16], *, psf_sigma_px: float = SIGMA_PX, saturation_adu: float = 60000.0) -> DetectorView:
    """The view that an extractor gets."""
    shape = pixels.shape
    dark = DarkMap.of(np.full(shape, PEDESTAL_ADU, np.float32))
    mask, residual = np.zeros(shape, np.uint8), np.empty(shape, np.float32)
    background = MeshBackground().estimate(pixels, dark.whole_adu(), mask)
    nodes = continued(background.level_adu, 2.4)
    sums = [np.empty((2, n), np.float32) for n in shape]
    residual_pass(pixels, dark.codes, mask, nodes, background.tile_px, int(saturation_adu), 1.0, 10.0, residual, *sums)
    header = FrameHeader(
        frame=0, t_start_tai_ns=0, exposure_ns=1, line_time_ns=0, rows=shape[0], cols=shape[1],
        gain_e_adu=GAIN_E_ADU, saturation_adu=saturation_adu,
    )  # fmt: skip
    return DetectorView(
        header=header,
        residual_adu=residual,
        background=background,
        mask=mask,
        stars=StarList.empty(),
        psf_sigma_px=psf_sigma_px,
    )


def matched(field: StarField, stars: StarList) -> tuple[NDArray[np.float64], NDArray[np.intp], NDArray[np.bool_]]:
    """Residuals (n, 2) of the nearest listed star, its index, and whether it is near enough."""
    distance, index = cKDTree(np.column_stack((stars.row, stars.col))).query(np.column_stack((field.row, field.col)))
    residual = np.column_stack((stars.row[index] - field.row, stars.col[index] - field.col))
    return residual, index, distance < 1.5


@pytest.fixture(scope="module")
def measured() -> dict[str, NDArray[np.float64]]:
    """Residuals of some 5,000 isolated stars of S/N 10 to 2,000 with their bounds."""
    columns: dict[str, list[NDArray[np.float64]]] = {"row": [], "col": [], "flux": [], "bound": [], "snr": [], "listed_snr": []}
    for seed in range(3):
        rng = np.random.default_rng(seed)
        field = star_grid(rng, side=1024, pitch=24, flux_e=(95.0, 20000.0), sigma_px=SIGMA_PX)
        stars = MatchedStars().extract(view_of(field.exposed(rng)))
        residual, index, found = matched(field, stars)
        assert found.mean() > 0.995
        columns["row"].append(residual[found, 0])
        columns["col"].append(residual[found, 1])
        columns["flux"].append(stars.flux_e[index][found] / field.flux_e[found])
        columns["bound"].append(np.array([centroid_bound_px(f, SIGMA_PX) for f in field.flux_e[found]]))
        columns["snr"].append(np.array([matched_snr(f, SIGMA_PX) for f in field.flux_e[found]]))
        columns["listed_snr"].append(stars.snr[index][found])
    return {name: np.concatenate(parts) for name, parts in columns.items()}


@pytest.mark.parametrize("axis", ["row", "col"])
def test_centroids_reach_the_cramer_rao_bound(measured: dict[str, NDArray[np.float64]], axis: str) -> None:
    """rms <= 1.1 x the bound for S/N >= 10, over all stars and within each decade of S/N."""
    pull = measured[axis] / measured["bound"]
    assert np.sqrt(np.mean(pull**2)) < 1.1
    for low, high in ((10.0, 30.0), (30.0, 300.0), (300.0, 3000.0)):
        part = pull[(measured["snr"] >= low) & (measured["snr"] < high)]
        assert len(part) > 500
        assert np.sqrt(np.mean(part**2)) < 1.1


@pytest.mark.parametrize("axis", ["row", "col"])
def test_centroids_are_unbiased(measured: dict[str, NDArray[np.float64]], axis: str) -> None:
    """Mean residual below 0.01 px; 0.002 px for bright stars, where it can be seen."""
    assert abs(measured[axis].mean()) < 0.01
    assert abs(measured[axis][measured["snr"] > 100].mean()) < 0.002


def test_flux_is_unbiased(measured: dict[str, NDArray[np.float64]]) -> None:
    """Bright stars to 0.3 %, faint ones to 2 % (those near the threshold are found when noise lifts them)."""
    bright = measured["snr"] > 50
    assert measured["flux"][bright].mean() == pytest.approx(1.0, abs=0.003)
    assert measured["flux"][~bright].mean() == pytest.approx(1.0, abs=0.02)


def test_listed_snr_is_the_matched_filter_snr(measured: dict[str, NDArray[np.float64]]) -> None:
    """The list's S/N is the contract's, to 3 %."""
    ratio = measured["listed_snr"] / measured["snr"]
    assert np.median(ratio) == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize("nominal_px", [0.7, 1.0])
def test_width_is_measured_not_believed(nominal_px: float) -> None:
    """A nominal PSF that is 18 % wrong costs nothing in flux: the width comes from the stars."""
    rng = np.random.default_rng(5)
    field = star_grid(rng, side=768, pitch=24, flux_e=(2000.0, 20000.0), sigma_px=SIGMA_PX)
    stars = MatchedStars().extract(view_of(field.exposed(rng), psf_sigma_px=nominal_px))
    _, index, found = matched(field, stars)
    assert np.mean(stars.flux_e[index][found] / field.flux_e[found]) == pytest.approx(1.0, abs=0.01)
    assert stars.psf_sigma_px == pytest.approx(SIGMA_PX, rel=0.01)


def test_short_trails_are_flagged_and_centred() -> None:
    """Stars trailed by 3 px keep unbiased centroids (bound: that of a round star, times the smear along the trail)."""
    rng = np.random.default_rng(6)
    field = star_grid(rng, side=768, pitch=24, flux_e=(2000.0, 20000.0), sigma_px=SIGMA_PX, trail_px=3.0)
    stars = MatchedStars().extract(view_of(field.exposed(rng)))
    residual, index, found = matched(field, stars)
    assert found.mean() > 0.99
    assert ((stars.flags[index][found] & StarFlag.TRAILED) != 0).all()
    assert abs(residual[found].mean(axis=0)).max() < 0.01
    assert residual[found, 0].std() < 0.05


def test_empty_sky_gives_next_to_no_stars() -> None:
    """A million pixels of noise hold less than one 5-sigma peak in two thousand independent PSFs."""
    rng = np.random.default_rng(7)
    noise = StarField(electrons=np.full((1024, 1024), SKY_E), row=np.zeros(0), col=np.zeros(0), flux_e=np.zeros(0))
    assert len(MatchedStars().extract(view_of(noise.exposed(rng)))) <= 8


def test_saturated_star_is_one_entry() -> None:
    """A star with a saturated core is listed once, flagged, at its centre."""
    rng = np.random.default_rng(8)
    field = star_grid(rng, side=192, pitch=128, flux_e=(3e5, 3.0001e5), sigma_px=SIGMA_PX)
    pixels = np.minimum(field.exposed(rng), 20000)
    stars = MatchedStars().extract(view_of(pixels, saturation_adu=20000.0))
    flagged = (stars.flags & StarFlag.SATURATED) != 0
    assert flagged.sum() == 1
    near = np.hypot(stars.row - field.row[0], stars.col - field.col[0]) < 6.0
    assert near.sum() == 1
    assert np.hypot(stars.row[flagged] - field.row, stars.col[flagged] - field.col).max() < 0.7


@pytest.mark.parametrize("row", [1, 9, 30])
def test_pixels_that_spoil_a_window_are_told_at_the_edge_too(row: int) -> None:
    """A saturated and a defective pixel beside the peak, whether or not the window reaches beyond the frame."""
    residual, mask = np.zeros((32, 32), np.float32), np.zeros((32, 32), np.uint8)
    residual[row, 20] = 100.0
    mask[row - 1, 20], mask[row, 21] = MaskBit.SATURATED, MaskBit.HOT
    peaks = np.array([[row, 20, 60.0, 0.0, 0.0]], np.float32)
    fits, flags = np.empty((1, 6)), np.zeros(1, np.uint8)
    covariance = np.array([[0.8, 0.0, 0.8]])
    fit_stars(residual, mask, np.full((1, 1), 2.4, np.float32), 64, peaks, covariance, (2, 3), 1.2, fits, flags)
    edge = StarFlag(0) if row == 9 else StarFlag.EDGE
    assert StarFlag(int(flags[0])) & ~StarFlag.BLENDED == StarFlag.SATURATED | StarFlag.DEFECT | edge


def test_hot_pixel_is_called_sharp() -> None:
    """A single bright pixel is listed as COSMIC_LIKE, a star of the same light is not."""
    rng = np.random.default_rng(9)
    field = star_grid(rng, side=192, pitch=128, flux_e=(2000.0, 2000.1), sigma_px=SIGMA_PX)
    pixels = field.exposed(rng)
    pixels[20, 30] += 400
    stars = MatchedStars().extract(view_of(pixels))
    sharp = (stars.flags & StarFlag.COSMIC_LIKE) != 0
    assert sharp[np.hypot(stars.row - 20, stars.col - 30).argmin()]
    assert not sharp[np.hypot(stars.row - field.row[0], stars.col - field.col[0]).argmin()]


def test_chosen_stars_cover_the_frame() -> None:
    """With all bright stars in one corner, the chosen ones still come from every cell that has any."""
    rng = np.random.default_rng(10)
    n = 5000
    row, col = rng.uniform(0, 1000, n), rng.uniform(0, 1000, n)
    flux = np.where((row < 200) & (col < 200), 1e5, 1e2) * rng.uniform(1, 2, n)
    order = np.argsort(-flux)
    stars = StarList(row=row[order], col=col[order], flux_e=flux[order], snr=flux[order], flags=np.zeros(n, dtype=np.uint8))
    chosen = best_spread(stars, (1000, 1000), 256)
    assert len(chosen) == 256
    cells = (stars.row[chosen] // 125).astype(int) * 8 + (stars.col[chosen] // 125).astype(int)
    assert np.bincount(cells, minlength=64).min() >= 3


@pytest.mark.parametrize("vector", [(5.0, 0.0), (3.0, -4.0), (9.0, 4.5)])
def test_long_trails_are_found_and_centred(vector: tuple[float, float]) -> None:
    """Pointing that follows something else: every bright star once, TRAILED, unbiased, flux right to 2 %."""
    rng = np.random.default_rng(11)
    side, pitch, length = 512, 40, float(np.hypot(*vector))
    nodes = np.arange(pitch, side - pitch, pitch)
    row, col = (a.ravel() + rng.uniform(-0.5, 0.5, a.size) for a in np.meshgrid(nodes, nodes, indexing="ij"))
    flux = np.exp(rng.uniform(np.log(2000.0), np.log(40000.0), row.size))
    electrons = np.full((side, side), SKY_E)
    steps = (np.arange(40) + 0.5) / 40 - 0.5
    for r, c, f in zip(row, col, flux, strict=True):
        for step in steps:
            at_r, at_c = r + step * vector[0], c + step * vector[1]
            i, j = int(at_r) - 5, int(at_c) - 5
            spot = np.outer(axis_weights(at_r, i, 11, SIGMA_PX), axis_weights(at_c, j, 11, SIGMA_PX))
            electrons[i : i + 11, j : j + 11] += f / 40 * spot
    field = StarField(electrons=electrons, row=row, col=col, flux_e=flux)
    stars = MatchedStars().extract(view_of(field.exposed(rng)))
    residual, index, found = matched(field, stars)
    assert found.all()
    assert len(stars) <= len(row) + 2
    assert ((stars.flags[index] & StarFlag.TRAILED) != 0).all()
    along = residual @ np.array(vector) / length
    assert abs(along.mean()) < 0.02
    assert abs(residual.mean(axis=0)).max() < 0.02
    assert np.median(stars.flux_e[index] / flux) == pytest.approx(1.0, abs=0.02)


def test_particle_tracks_are_not_chosen_as_stars() -> None:
    """Bright tracks a pixel wide are flagged, and come after all stars in the choice for the camera solution."""
    rng = np.random.default_rng(12)
    field = star_grid(rng, side=512, pitch=32, flux_e=(1000.0, 5000.0), sigma_px=SIGMA_PX)
    pixels = field.exposed(rng)
    tracks = rng.uniform(40, 470, (40, 2))
    for r, c in tracks:
        angle, length = rng.uniform(0, np.pi), rng.uniform(1.0, 9.0)
        for step in np.linspace(0, length, 40):
            pixels[int(r + step * np.sin(angle)), int(c + step * np.cos(angle))] += 60
    stars = MatchedStars().extract(view_of(pixels))
    chosen = best_spread(stars, (512, 512), 100)
    distance, _ = cKDTree(np.column_stack((field.row, field.col))).query(np.column_stack((stars.row[chosen], stars.col[chosen])))
    assert (distance < 1.0).mean() >= 0.98


@pytest.mark.parametrize("n", [0, 1, 2, 7, 3000])
def test_falling_is_a_stable_sort(n: int) -> None:
    """Without equal values, with some, and with nothing else."""
    rng = np.random.default_rng(n)
    for values in (rng.random(n), rng.integers(0, n // 3 + 1, n).astype(float), np.zeros(n)):
        assert (falling(values) == np.argsort(-values, kind="stable")).all()


def test_a_peak_in_a_hole_of_the_background_is_no_star_to_learn_from() -> None:
    """Its light sums up to less than nothing; the fit ended the run with a ValueError."""
    residual = np.full((64, 64), -1.0, dtype=np.float32)
    residual[30:33, 30:33] = 5.0
    peaks = np.array([[31.0, 31.0, 9.0]], dtype=np.float32)
    guess = StarMotion(drow=4.0, dcol=1.0, turn_rad=0.0, middle_row=31.5, middle_col=31.5)
    places, _, _, _ = fitted_vectors(residual, np.zeros((64, 64), np.uint8), peaks[:, :2].astype(float), guess, 1.0)
    assert len(places) == 0
