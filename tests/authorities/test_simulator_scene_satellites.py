"""SGP4's own verification set through our reader and propagator; the predictor against brute force."""

import gzip
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import sgp4
from astropy.time import Time
from sgp4.api import WGS72, Satrec

from sboc_e2e.icd import tai
from sboc_e2e.icd.errors import UserError
from simulator.optics.instrument import InstrumentOptions
from simulator.platform import earth
from simulator.platform.observer import PlatformOptions, make_observer
from simulator.platform.pointing import PointingOptions, commanded_attitude
from simulator.scene.prediction import Watch, predict_crossings
from simulator.scene.satellites import Satellite, gcrs_from_teme, propagate, read_satellites, with_sizes

FOLDER = Path(sgp4.__file__).parent


def verification_states():
    """Catalogue number -> rows of (minutes, x, y, z, vx, vy, vz) of tcppver.out."""
    states, number = {}, ""
    for line in (FOLDER / "tcppver.out").read_text().splitlines():
        words = line.split()
        if len(words) == 2 and words[1] == "xx":
            number = words[0]
            states[number] = []
        elif len(words) >= 7:
            states[number].append([float(w) for w in words[:7]])
    return {k: np.array(v) for k, v in states.items() if v}


def element_sets():
    lines = [x.rstrip() for x in (FOLDER / "SGP4-VER.TLE").read_text().splitlines()]
    for first, second in pairwise(lines):
        if first.startswith("1 ") and second.startswith("2 "):
            yield first[2:7].strip(), Satrec.twoline2rv(first[:69], second[:69], WGS72)


def test_verification_set_to_a_millimetre():
    states = verification_states()
    checked = 0
    for number, record in element_sets():
        wanted = states.get(str(int(number)))
        if wanted is None or record.jdsatepoch < Time("1973-01-03").jd:
            continue
        utc = Time(record.jdsatepoch, record.jdsatepochF, format="jd", scale="utc").tai
        tai_ns = tai.from_jd_parts(utc.jd1, utc.jd2)
        turn = gcrs_from_teme(tai_ns)
        # the set mixes near and deep space, and propagates some until they decay; look at the first day of each
        rows = wanted[(wanted[:, 0] >= 0.0) & (wanted[:, 0] <= 1440.0)][:6]
        for row in rows:
            position, velocity, error = propagate([Satellite(name=number, record=record)], tai_ns, np.array([row[0] * 60.0]))
            if error[0, 0]:
                continue
            near = gcrs_from_teme(tai_ns + round(row[0] * 60e9))
            assert np.abs(near.T @ position[0, 0] - row[1:4]).max() < 1e-4, number  # the epoch is kept to 1e-8 day only
            assert np.abs(near.T @ velocity[0, 0] - row[4:7]).max() < 1e-6, number
            checked += 1
        assert np.abs(turn @ turn.T - np.eye(3)).max() < 1e-12
    assert checked > 100


def test_predictor_finds_what_brute_force_finds(shared_data):
    satellites = read_satellites(shared_data / "tle" / "catalogue_2022-01.3le.gz")[::4]
    tai_ns = earth.tai_ns_of_utc("2022-01-22T06:00:00")
    observer = make_observer(PlatformOptions(), tai_ns)
    attitude = commanded_attitude(PointingOptions(), observer, tai_ns)
    projection, shape = InstrumentOptions().true_projection(), (4096, 4096)
    watch = Watch(
        observer=observer, attitude=attitude, projection=projection, shape=shape, epoch_tai_ns=tai_ns, from_s=0.0, to_s=90.0
    )
    predicted = predict_crossings(satellites, watch)
    time_s = np.arange(0.0, 90.0, 1.5)
    position, _, error = propagate(satellites, tai_ns, time_s)
    seen = np.zeros(len(satellites), dtype=bool)
    for k, t in enumerate(time_s):
        now = tai_ns + round(t * 1e9)
        row, col = projection.to_pixels((position[:, k] - observer.state(now)[0]) @ attitude(now).T)
        seen |= (row > -0.5) & (row < 4095.5) & (col > -0.5) & (col < 4095.5) & (error[:, k] == 0)
    brute = {id(satellites[k]) for k in np.flatnonzero(seen)}
    found = {id(c.satellite) for c in predicted.crossings}
    assert brute <= found  # brute force misses those that cross between its steps
    assert len(found) <= len(brute) + 3
    assert brute
    assert predicted.refused  # decayed and absurd sets are named, not dropped


def damaged(kind):
    """A gzipped text cut short, with a byte of its deflate block type overwritten, or not gzipped at all."""
    text = b"".join(b"%d a line of no element set\n" % k for k in range(500))
    packed = gzip.compress(text)
    return {"truncated": packed[: len(packed) // 2], "corrupt": packed[:10] + b"\xff" + packed[11:], "not gzipped": text}[kind]


@pytest.mark.parametrize("kind", ["truncated", "corrupt", "not gzipped"])
def test_damaged_files_are_refused_by_name(kind, tmp_path):
    file = tmp_path / "sets.3le.gz"
    file.write_bytes(damaged(kind))
    with pytest.raises(UserError, match=r"satellite file .*sets\.3le\.gz: cannot be read: "):
        read_satellites(file)
    with pytest.raises(UserError, match=r"objects\.satellites\.sizes_file: .*sets\.3le\.gz: cannot be read: "):
        with_sizes([], file)


def test_bad_files_are_refused_by_name(tmp_path):
    with pytest.raises(UserError, match="no such file"):
        read_satellites(tmp_path / "none.tle")
    first = "1 00005U 58002B   22022.55771106  .00000105  00000-0  15609-3 0  9990"
    second = "2 00005  34.2401 228.9165 1843365 100.8944 280.3452 10.84849428268693"
    good = tmp_path / "good.3le"
    good.write_text(f"0 VANGUARD 1\n{first}\n{second}\n")
    assert [s.name for s in read_satellites(good)] == ["VANGUARD 1"]
    with pytest.raises(UserError, match="ISS"):
        read_satellites(good, ("ISS",))
    bad = tmp_path / "bad.3le"
    bad.write_text(f"0 VANGUARD 1\n{first[:-1]}5\n{second}\n")
    with pytest.raises(UserError, match="line 2"):
        read_satellites(bad)
    half = tmp_path / "half.3le"
    half.write_text(f"0 VANGUARD 1\n{first}\n{second}\n0 OTHER\n{first}\n0 NEXT\n")
    with pytest.raises(UserError, match="line 5: half an element set"):
        read_satellites(half)
    empty = tmp_path / "empty.3le"
    empty.write_text("nothing\n")
    with pytest.raises(UserError, match="no element set"):
        read_satellites(empty)
