"""Facts about the chain under skies that are not the simulator's: drawn by `sky_frames`."""

from dataclasses import replace

import numpy as np

from onboard.detect import whiten
from onboard.detect.line_integral import point_movers
from sboc_e2e.icd.flags import StreakFlag
from tests.benchmarks import sky_frames
from tests.benchmarks.bench_detection import score
from tests.benchmarks.bench_sky import second_of


def test_short_movers_under_a_sharper_psf_are_no_particle_tracks() -> None:
    """FWHM 1.2 px with a nominal 2 px: the width that the stars show tells light from tracks."""
    lengths = [(length, 25.0) for length in (14.0, 16.0, 18.0, 20.0, 24.0, 30.0)]
    found = light = 0
    for seed in range(2):
        drawn = sky_frames.scene(sky_frames.Row(name="sharp", fwhm_px=1.2), 1024, lengths, seed)
        result, _ = second_of(drawn.earlier, drawn.later)
        regardless = [replace(d, flags=d.flags & ~StreakFlag.COSMIC_LIKE) for d in result.detections]
        found += sum(d is not None for d in score(regardless, drawn.streaks)[0])
        light += sum(d is not None for d in score(result.detections, drawn.streaks)[0])
    assert found == light == 12


def test_a_short_trail_fitted_on_an_even_bright_area_does_not_grow_without_end() -> None:
    """Pixels at the clip on all sides: every longer trail has a higher S/N, and its price grows as the square of its length."""
    image = np.full((600, 1200), 8 * whiten.UNIT, np.int8)
    blocked = np.zeros(image.shape, np.uint8)
    *_, length = point_movers.fit_short_trail(image, blocked, 0, (50.0, 300.0, 600.0, 0.0, 40.0), 0.85)
    assert length <= point_movers.LONGEST_FIT_PX
