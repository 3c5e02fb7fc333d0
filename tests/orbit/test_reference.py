"""Known objects: frames of SGP4 against astropy, catalogue match on element sets, biases put in and found again."""

from dataclasses import replace
from pathlib import Path

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import GCRS, TEME, CartesianRepresentation
from astropy.time import Time
from sgp4.api import WGS72, Satrec
from sgp4.exporter import export_tle

from ground.options import GroundOptions
from ground.orbit.bias import estimate_bias
from ground.orbit.catalogue_match import chance_probability, local_density, match_catalogue, read_elements
from ground.orbit.ephemerides import bias_of_run, read_oem
from ground.orbit.reference import PreciseOrbit, teme_to_gcrs, utc_jd
from ground.products.epochs import utc_text
from sboc_e2e.icd import tai
from sboc_e2e.icd.errors import UserError
from sboc_e2e.icd.frame import FrameHeader
from sboc_e2e.icd.products import Tracklet
from sboc_e2e.run.known_objects import known_objects
from tests.orbit.encounters import LIGHT_KM_S, T0_NS, Encounter, observed, sun_and_observer, trajectory


def test_teme_to_gcrs_matches_astropy() -> None:
    """Rotation of SGP4's frame: astropy by way of the rotating Earth agrees to 0.1 arcsec (sidereal times of 1982 and 2006)."""
    day, fraction = tai.to_jd_parts(T0_NS)
    time = Time(day, fraction, format="jd", scale="tai")
    vector = np.array([7000.0, -1200.0, 3000.0])
    teme = TEME(CartesianRepresentation(vector * u.km), obstime=time)
    expected = teme.transform_to(GCRS(obstime=time)).cartesian.xyz.to_value(u.km)
    got = teme_to_gcrs(T0_NS) @ vector
    assert np.linalg.norm(got - expected) / np.linalg.norm(vector) < 0.1 / 206265


def test_utc_of_tai() -> None:
    """37 leap seconds since 2017."""
    day, fraction = utc_jd([T0_NS])
    tai_day, tai_fraction = tai.to_jd_parts(T0_NS)
    assert (tai_day - day[0] + tai_fraction - fraction[0]) * 86400.0 == pytest.approx(37.0, abs=1e-5)


def element_sets(n: int, rng: np.random.Generator) -> tuple[str, list[Satrec]]:
    """A three-line catalogue of n low orbits at T0."""
    lines, satellites = [], []
    epoch = sum(part[0] for part in utc_jd([T0_NS])) - 2433281.5
    for k in range(n):
        satellite = Satrec()
        satellite.sgp4init(
            WGS72, "i", 10_000 + k, epoch, 1e-4, 0.0, 0.0, rng.uniform(1e-4, 0.02), rng.random() * 6.28, rng.uniform(0.9, 1.8),
            rng.random() * 6.28, rng.uniform(0.058, 0.066), rng.random() * 6.28,
        )  # fmt: skip
        satellite.intldesg = "20001A"
        lines += [f"0 OBJECT {k}", *export_tle(satellite)]
        satellites.append(satellite)
    return "\n".join(lines), satellites


def state_of(satellite: Satrec, t_ns: int) -> np.ndarray:
    """GCRS state of an SGP4 object, km and km/s."""
    day, fraction = utc_jd([t_ns])
    _, r, v = satellite.sgp4(day[0], fraction[0])
    turn = teme_to_gcrs(t_ns)
    return np.concatenate([turn @ r, turn @ v])


def seen(state: np.ndarray, rng: np.random.Generator) -> tuple[Tracklet, tuple]:
    """Tracklet and headers of an object, wherever it is in the sky."""
    _, observer = sun_and_observer()
    relative = state - observer
    rho = float(np.linalg.norm(relative[:3]))
    line = relative[:3] / rho
    rate = float(np.degrees(np.linalg.norm(relative[3:] - (relative[3:] @ line) * line) / rho))
    retarded = trajectory(state, np.array([-rho / LIGHT_KM_S]))[0]
    one = Encounter(state=state, elements=np.zeros(3), range_km=rho, rate_deg_s=rate, size_m=0.1, mag=9.0, snr=50.0)
    assert np.isfinite(retarded).all()
    return observed(one, rng, error_px=0.2)


def test_known_and_unknown_objects() -> None:
    """Of 400 element sets the right one is found for tracklets of some; an object in none of them is unknown."""
    rng = np.random.default_rng(8)
    text, satellites = element_sets(400, rng)
    known = read_elements(text)
    assert known.names[17] == "OBJECT 17"
    assert len(known.satellites) == 400
    for k in (3, 50, 333):
        tracklet, headers = seen(state_of(satellites[k], T0_NS), rng)
        (match,) = match_catalogue([tracklet], headers, known)
        assert match.known
        assert match.number == 10_000 + k
        # the printed element set differs from the drawn one by its last digits, tens of metres
        assert abs(match.cross_arcsec) * match.range_km / 206265 < 0.1
    strange = state_of(satellites[3], T0_NS)
    strange[:3] *= 1.05
    tracklet, headers = seen(strange, rng)
    assert not match_catalogue([tracklet], headers, known)[0].known
    assert match_catalogue([tracklet], headers, read_elements("")) == ()


def test_a_companion_makes_a_match_ambiguous() -> None:
    """Two objects 1 km apart are two hypotheses, neither known; element sets of one object under one number are one candidate."""
    rng = np.random.default_rng(8)
    text, satellites = element_sets(40, rng)
    tracklet, headers = seen(state_of(satellites[3], T0_NS), rng)
    lines = text.splitlines()
    name, one, two = lines[9:12]
    twin = Satrec()
    twin.sgp4init(
        WGS72, "i", 20_000, satellites[3].jdsatepoch + satellites[3].jdsatepochF - 2433281.5, 1e-4, 0.0, 0.0, satellites[3].ecco,
        satellites[3].argpo, satellites[3].inclo, satellites[3].mo + 1e-4, satellites[3].no_kozai, satellites[3].nodeo,
    )  # fmt: skip
    twin.intldesg = "20001B"
    (match,) = match_catalogue([tracklet], headers, read_elements("\n".join([text, "0 TWIN", *export_tle(twin)])))
    assert not match.known
    assert {c.number for c in match.candidates} == {10_003, 20_000}
    assert match.number == match.candidates[0].number
    assert all(0.0 <= c.chance_probability <= 1.0 for c in match.candidates)
    (match,) = match_catalogue([tracklet], headers, read_elements("\n".join([text, name, one, two])))
    assert match.known
    assert match.n_candidates == 1


def test_chance_of_a_match_is_the_share_of_chance_matches() -> None:
    """Objects strewn at random around 4,000 places: matches within 4 sigma are as many as stated, to 4 sigma of their number."""
    rng = np.random.default_rng(4)
    reach, place, drift = 0.01, 4.5e-3, 1.2e-3
    stated, found = 0.0, 0
    for _ in range(4000):
        n = rng.poisson(400)
        angle = np.arccos(1.0 - rng.random(n) * 0.05)
        rate = 2.0 * reach * np.sqrt(rng.random(n))
        stated += chance_probability(local_density(angle, rate, reach), 4.0, (place * drift) ** 2)
        found += bool((np.hypot(angle / place, rate / drift) < 4.0).any())
    assert found == pytest.approx(stated, abs=4.0 * np.sqrt(stated) + 1.0)
    assert found > 30


def test_broken_element_sets_are_named() -> None:
    """A first line without a second, and one whose checksum is wrong, are errors with their line numbers."""
    text, _ = element_sets(2, np.random.default_rng(1))
    lines = text.splitlines()
    with pytest.raises(UserError, match="line 5: half an element set"):
        read_elements("\n".join(lines[:-1]))
    wrong = str((int(lines[4][68]) + 1) % 10)
    with pytest.raises(UserError, match="line 5: not an element line of 69 characters with a right checksum"):
        read_elements("\n".join([*lines[:4], lines[4][:68] + wrong, lines[5]]))


def tagged_late(headers: tuple[FrameHeader, ...], late_ns: int) -> list[FrameHeader]:
    """Headers whose clock is late: start of exposure and epoch of the state alike."""
    moved = []
    for h in headers:
        assert h.observer is not None
        state = replace(h.observer, tai_ns=h.observer.tai_ns + late_ns)
        moved.append(replace(h, t_start_tai_ns=h.t_start_tai_ns + late_ns, observer=state))
    return moved


def test_biases_are_found() -> None:
    """Tags 2 ms late and pointing off by 1.5 and -0.7 arcsec, from 12 tracklets: found within 4 sigma, these below 0.2 arcsec."""
    rng = np.random.default_rng(12)
    _, satellites = element_sets(12, rng)
    pairs, all_headers = [], []
    late_ns, east, north = 2_000_000, 1.5, -0.7
    for satellite in satellites:
        start = state_of(satellite, T0_NS)
        tracklet, headers = seen(start, rng)
        steps = np.arange(-60.0, 61.0, 20.0)
        states = trajectory(start, steps)
        orbit = PreciseOrbit(
            name="reference", t_tai_ns=T0_NS + np.round(steps * 1e9).astype(np.int64), position_km=states[:, :3],
            velocity_km_s=states[:, 3:],
        )  # fmt: skip
        moved = replace(
            tracklet, t_tai_ns=tracklet.t_tai_ns + late_ns, dec_deg=tracklet.dec_deg + north / 3600,
            ra_deg=tracklet.ra_deg + east / 3600 / np.cos(np.radians(tracklet.dec_deg)),
        )  # fmt: skip
        pairs.append((moved, orbit))
        all_headers += tagged_late(headers, late_ns)
    bias = estimate_bias(pairs, all_headers)
    assert bias is not None
    sigma = np.sqrt(np.diag(bias.covariance))
    assert abs(bias.time_s - late_ns * 1e-9) < 4 * sigma[0]
    assert abs(bias.east_arcsec - east) < 4 * sigma[1]
    assert abs(bias.north_arcsec - north) < 4 * sigma[2]
    assert (sigma[1:] < 0.2).all()
    assert sigma[0] < 3e-4
    assert bias.chi2_nu == pytest.approx(1.0, abs=0.3)
    assert estimate_bias([], all_headers) is None


def test_directions_that_do_not_fit_are_counted_as_directions() -> None:
    """One of the directions is off by half a degree across the motion: its other coordinate may stay."""
    rng = np.random.default_rng(12)
    _, satellites = element_sets(4, rng)
    pairs, all_headers = [], []
    for k, satellite in enumerate(satellites):
        start = state_of(satellite, T0_NS)
        tracklet, headers = seen(start, rng)
        steps = np.arange(-60.0, 61.0, 20.0)
        states = trajectory(start, steps)
        t_ns = T0_NS + np.round(steps * 1e9).astype(np.int64)
        orbit = PreciseOrbit(name="reference", t_tai_ns=t_ns, position_km=states[:, :3], velocity_km_s=states[:, 3:])
        if k == 2:
            off = np.zeros(len(tracklet.dec_deg))
            off[1] = 0.5
            tracklet = replace(tracklet, dec_deg=tracklet.dec_deg + off)
        pairs.append((tracklet, orbit))
        all_headers += headers
    bias = estimate_bias(pairs, all_headers)
    assert bias is not None
    assert bias.n_clipped == 1
    assert bias.n_used == sum(len(tracklet.t_tai_ns) for tracklet, _ in pairs) - 1


VANGUARD = """0 VANGUARD 1
1 00005U 58002B   00179.78495062  .00000023  00000-0  28098-4 0  4753
2 00005  34.2682 348.7242 1859667 331.7664  19.3264 10.82419157413667
"""


def test_ephemeris_message_gives_the_bias() -> None:
    """Own OEM text of objects, one tracklet each, tags 2 ms late: states to 1 mm, delay found; errors name lines."""
    rng = np.random.default_rng(21)
    _, satellites = element_sets(6, rng)
    segments, tracklets, all_headers, starts = ["CCSDS_OEM_VERS = 2.0"], [], [], []
    for k, satellite in enumerate(satellites):
        start = state_of(satellite, T0_NS)
        starts.append(start)
        steps = np.arange(-60.0, 61.0, 20.0)
        segments += [
            "META_START", f"OBJECT_NAME = OBJECT {k}", "CENTER_NAME = EARTH", "REF_FRAME = GCRF",
            "TIME_SYSTEM = UTC", "META_STOP",
        ]  # fmt: skip
        t_ns = [T0_NS + round(s * 1e9) for s in steps]
        for epoch, state in zip(utc_text(t_ns, 9), trajectory(start, steps), strict=True):
            segments.append(f"{epoch} " + " ".join(f"{x:.9f}" for x in state))
        tracklet, headers = seen(start, rng)
        tracklets.append(replace(tracklet, t_tai_ns=tracklet.t_tai_ns + 2_000_000))
        all_headers += tagged_late(headers, 2_000_000)
    text = "\n".join(segments)
    orbits = read_oem(text)
    assert [orbit.name for orbit in orbits] == [f"OBJECT {k}" for k in range(6)]
    assert np.allclose(orbits[2].states(np.array([T0_NS]))[0, :3], starts[2][:3], atol=1e-3)
    bias = bias_of_run(tracklets, all_headers, orbits)
    assert bias is not None
    sigma = np.sqrt(np.diag(bias.covariance))
    assert abs(bias.time_s - 2e-3) < 4 * sigma[0] < 2e-3
    assert bias_of_run(tracklets, all_headers, orbits[:0]) is None
    with pytest.raises(UserError, match="REF_FRAME"):
        read_oem(text.replace("GCRF", "MOON"))
    with pytest.raises(UserError, match="line 8"):
        read_oem("\n".join([*segments[:7], "nonsense"]))
    with pytest.raises(UserError, match=r"line 7: expected META_STOP before states, got '2027"):
        read_oem(text.replace("META_STOP\n", ""))
    with pytest.raises(UserError, match=r"line 1: expected META_STOP before states, got '2027"):
        read_oem("\n".join(segments[7:]))
    with pytest.raises(UserError, match="line 8: expected an epoch and six numbers"):
        read_oem("\n".join([*segments[:7], "2027-01-29T00:00:9000 1 2 3 4 5 6"]))


def test_files_of_known_objects(tmp_path: Path) -> None:
    """A published element set (SGP4 verification, 5) is read from its file; missing and empty files are one-line errors."""
    path = tmp_path / "known.tle"
    path.write_text(VANGUARD)
    known = known_objects(GroundOptions(known_objects_file=str(path)))
    assert known is not None
    assert (known.names, known.numbers.tolist()) == (("VANGUARD 1",), [5])
    assert known_objects(GroundOptions()) is None
    with pytest.raises(UserError, match="known_objects_file"):
        known_objects(GroundOptions(known_objects_file=str(tmp_path / "none.tle")))
    path.write_text("")
    with pytest.raises(UserError, match="found none"):
        known_objects(GroundOptions(known_objects_file=str(path)))
