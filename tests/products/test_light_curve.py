"""Light curves of tracklets: a period where there is one, none where there is none, and the picture that shows them."""

import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import numpy as np
import pytest

from ground.link import MotionLinker, apply_links
from ground.products.light_curve import light_curve
from ground.products.tables import tracklets_table
from ground.records import GroundProducts
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import StreakMeasurement, Tracklet
from sboc_e2e.run.tracklet_plot import tracklet_svg
from tests.link.sky_scene import Camera, observe, pixel_mover

N_FRAMES = 40
PERIOD_S = 1.7


Linked = tuple[list[StreakMeasurement], Tracklet, tuple[FrameHeader, ...]]


@pytest.fixture(scope="module")
def linked() -> Linked:
    """One object in 40 frames at 4 Hz and its tracklet."""
    camera = Camera()
    mover = pixel_mover(camera, 2000.0, 500.0, 20.0, 250.0, t_s=0.0, range_km=500.0, range_rate_km_s=0.0)
    headers, streaks, _ = observe(camera, [mover], N_FRAMES, np.random.default_rng(1), p_seen=1.0, false_per_frame=0.0)
    (tracklet,) = MotionLinker().link(headers, streaks)
    return list(apply_links(streaks, (tracklet,), headers)), tracklet, headers


def bright(streaks: list[StreakMeasurement], amplitude: float, rng: np.random.Generator) -> list[StreakMeasurement]:
    """The same with magnitudes around 10 and errors of 0.05."""
    start = min(int(s.t_tai_ns[1]) for s in streaks)
    out = []
    for s in streaks:
        phase = 2.0 * np.pi * (int(s.t_tai_ns[1]) - start) * 1e-9 / PERIOD_S
        out.append(replace(s, mag=10.0 + amplitude * np.sin(phase) + 0.05 * rng.standard_normal(), mag_err=0.05))
    return out


def test_period_of_a_tumbling_object(linked: Linked) -> None:
    """Amplitude 0.2 mag, errors 0.05: the period within 3 %."""
    curve = light_curve(bright(linked[0], 0.2, np.random.default_rng(2)))
    assert curve.period_s == pytest.approx(PERIOD_S, rel=0.03)
    assert curve.false_alarm < 1e-4


def test_steady_objects_have_no_period(linked: Linked) -> None:
    """Of 100 steady ones at most five show a period at a false-alarm probability of 1 %."""
    rng = np.random.default_rng(3)
    found = [np.isfinite(light_curve(bright(linked[0], 0.0, rng)).period_s) for _ in range(100)]
    assert sum(found) <= 5


def test_few_frames_have_no_period(linked: Linked) -> None:
    curve = light_curve(bright(linked[0], 0.2, np.random.default_rng(2))[:7])
    assert len(curve.t_s) == 7
    assert np.isnan([curve.period_s, curve.false_alarm]).all()
    assert len(light_curve([]).t_s) == 0


def test_table_and_picture_show_the_period(linked: Linked) -> None:
    """The tracklets table has the period; the picture is a valid document, names it, and repeats byte for byte."""
    streaks, tracklet, headers = bright(linked[0], 0.2, np.random.default_rng(2)), linked[1], linked[2]
    products = GroundProducts(
        headers=headers, solutions=(), photometry=(), streaks=streaks, tracklets=(tracklet,), members=(streaks,), orbits=()
    )
    table = tracklets_table(products)
    assert table["period_s"][0] == pytest.approx(PERIOD_S, rel=0.03)
    text = tracklet_svg(tracklet, streaks)
    assert ElementTree.fromstring(text).tag.endswith("svg")  # noqa: S314 - the text was made a line above
    assert f"period {table['period_s'][0]:.3g} s" in text
    assert tracklet_svg(tracklet, streaks) == text
