"""Places of a sensor from its ephemeris, against closed forms."""

from pathlib import Path

import numpy as np
import pytest

from ground.determination.forces import propagator
from ground.sky.orientation_data import covered_mjd
from sboc_e2e.icd.errors import UserError
from sboc_e2e.objects.places import place_of_ephemeris, place_of_site
from sboc_e2e.score.published.axes import gcrs_from
from sboc_e2e.score.published.epochs import tai_ns

RADIUS_KM = 7_078.0
RATE_RAD_S = float(np.sqrt(398_600.4418 / RADIUS_KM**3))
"""Of a circular orbit at 700 km."""
START_TAI_NS = int(tai_ns(["2027-01-29T00:00:00"], "TAI")[0])


def circle_km(t_s: np.ndarray) -> np.ndarray:
    """Places (n, 3) on EME2000 axes."""
    turn = RATE_RAD_S * t_s
    return RADIUS_KM * np.stack([np.cos(turn), np.sin(turn) * np.cos(1.7), np.sin(turn) * np.sin(1.7)], axis=-1)


def message(path: Path, step_s: float, method: str, *, rows: int = 20, centre: str = "EARTH", again: bool = False) -> Path:
    """States of the circle with 1 mm and 1 um/s of rounding."""
    t_s = step_s * np.arange(rows)
    position = circle_km(t_s)
    velocity = RATE_RAD_S * circle_km(t_s + 0.5 * np.pi / RATE_RAD_S)
    lines = [
        "CCSDS_OEM_VERS = 2.0", "CREATION_DATE = 2027-01-29T00:00:00", "ORIGINATOR = HAND", "META_START", "OBJECT_NAME = EYE",
        "OBJECT_ID = 2027-000A", f"CENTER_NAME = {centre}", "REF_FRAME = EME2000", "TIME_SYSTEM = TAI",
        "START_TIME = 2027-01-29T00:00:00", "STOP_TIME = 2027-01-29T12:00:00", *method.splitlines(), "META_STOP",
    ]  # fmt: skip
    for second, x, v in zip(t_s, position, velocity, strict=True):
        hour, rest = divmod(int(second), 3600)
        epoch = f"2027-01-29T{hour:02d}:{rest // 60:02d}:{rest % 60:02d}"
        lines.append(f"{epoch} " + " ".join([*(f"{value:.6f}" for value in x), *(f"{value:.9f}" for value in v)]))
    path.write_text("\n".join([*lines, *lines[-1:]] if again else lines) + "\n")
    return path


@pytest.mark.parametrize(
    ("step_s", "method", "largest_m"),
    [
        (300.0, "INTERPOLATION = HERMITE\nINTERPOLATION_DEGREE = 7", 0.02),
        (300.0, "INTERPOLATION = HERMITE\nINTERPOLATION_DEGREE = 3", 200.0),
        (60.0, "INTERPOLATION = LAGRANGE\nINTERPOLATION_DEGREE = 8", 0.01),
        (1.0, "INTERPOLATION = LINEAR", 1.2),
        (300.0, "", 0.02),
    ],
    ids=["degree 7", "degree 3", "Lagrange", "linear", "none stated"],
)
def test_ephemerides_are_interpolated_as_they_say(tmp_path: Path, step_s: float, method: str, largest_m: float) -> None:
    """Errors near the ends of the table apart; those of polynomials of degree 3 and 1 are h^4 a / 384 and h^2 a / 8."""
    place = place_of_ephemeris(message(tmp_path / "eye.oem", step_s, method))
    t_s = np.linspace(5.0 * step_s, 14.0 * step_s, 200)
    found = place(START_TAI_NS + np.rint(t_s * 1e9).astype(np.int64))
    error_m = 1e3 * np.linalg.norm(found - circle_km(t_s) @ gcrs_from("EME2000").T, axis=1)
    assert error_m.max() < largest_m
    if "= 3" in method:
        assert error_m.max() == pytest.approx(1e3 * (step_s * RATE_RAD_S) ** 4 * RADIUS_KM / 384.0, rel=0.02)
    if "LINEAR" in method:
        assert error_m.max() == pytest.approx(1e3 * (step_s * RATE_RAD_S) ** 2 * RADIUS_KM / 8.0, rel=0.02)


@pytest.mark.parametrize("years", [-60, 80])
def test_a_site_has_no_place_outside_the_earth_orientation_data(years: int) -> None:
    """Before 1973 UT1 would be UTC, and after the last prediction (2027 and later) what it was then: 0.5 s are 0.2 km."""
    pytest.importorskip("satkit", reason="satkit turns Earth-fixed axes (extra `objects`)")
    place = place_of_site("38.2,-6.6,570")
    now = START_TAI_NS - 365 * 86_400 * 10**9
    assert np.linalg.norm(place(np.array([now]))) == pytest.approx(6370.0, abs=5.0)
    late = now + round(years * 365.25 * 86400) * 10**9
    with pytest.raises(UserError, match=r"--site: [0-9-]* lies outside the installed Earth-orientation data") as caught:
        place(np.array([now, late]))
    assert "\n" not in str(caught.value)


def test_the_propagator_reads_the_same_earth_orientation_data() -> None:
    pytest.importorskip("satkit", reason="satkit turns Earth-fixed axes (extra `objects`)")
    first, _, last = propagator().frametransform.eop_coverage()
    assert covered_mjd() == (first.to_mjd(), last.to_mjd())


def test_no_place_is_told_outside_an_ephemeris(tmp_path: Path) -> None:
    place = place_of_ephemeris(message(tmp_path / "eye.oem", 60.0, "", rows=2))
    found = place(START_TAI_NS + np.array([-1, 0, 30_000_000_000, 60_000_000_000, 60_000_000_001]))
    assert np.isfinite(found).all(axis=1).tolist() == [False, True, True, True, False]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"centre": "SUN"}, "eye.oem, segment 1: expected CENTER_NAME = EARTH, got 'SUN'"),
        ({"rows": 0}, "expected two or more states, one at each epoch, got 0"),
        ({"rows": 1}, "expected two or more states, one at each epoch, got 1"),
        ({"again": True}, "expected two or more states, one at each epoch, got 21"),
        ({"method": "INTERPOLATION = SPLINE"}, "HERMITE, LAGRANGE or LINEAR is read, not 'SPLINE'"),
        ({"method": "INTERPOLATION = LAGRANGE\nINTERPOLATION_DEGREE = 99"}, "INTERPOLATION_DEGREE from 1 to 27, got 99"),
        ({"method": "INTERPOLATION = LAGRANGE\nINTERPOLATION_DEGREE = many"}, "as a whole number, got 'many'"),
    ],
)
def test_ephemerides_that_tell_no_place_are_refused(tmp_path: Path, changes: dict, words: str) -> None:
    with pytest.raises(UserError, match=words):
        place_of_ephemeris(message(tmp_path / "eye.oem", 60.0, **{"method": "", **changes}))
