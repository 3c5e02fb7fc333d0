"""Screening finds what trying every pair finds, and says what it cannot do."""

import gzip
from pathlib import Path

import numpy as np
import pytest
from sgp4.api import Satrec, SatrecArray

from ground.conjunctions.screening import screen
from sboc_e2e.cli.main import run
from sboc_e2e.icd.errors import UserError
from sboc_e2e.objects.conjunctions import screen_elements
from tests.conjunctions.reference import folder

DAY = 2459601.5


def crowd(shared: Path, n: int) -> list[tuple[str, str, str]]:
    """Element sets of low orbits near 86 deg and 99 deg at 700 to 900 km, where most approaches are, and a few others."""
    lines = gzip.decompress((shared.parent / "tle" / "catalogue_2022-01.3le.gz").read_bytes()).decode().splitlines()
    sets = [tuple(lines[k : k + 3]) for k in range(0, len(lines) - 2, 3)]
    dense = [s for s in sets if 14.0 < float(s[2][52:63]) < 14.6 and float(s[2][26:33]) < 30000]
    others = [s for s in sets if float(s[2][52:63]) < 12.0]
    return dense[: n - n // 6] + others[:: max(1, len(others) // (n // 6))][: n // 6]


def states_of(sets: list[tuple[str, str, str]]):
    array = SatrecArray([Satrec.twoline2rv(one, two) for _, one, two in sets])

    def states(t_s: np.ndarray) -> np.ndarray:
        failed, place, velocity = array.sgp4(np.full(len(t_s), DAY), t_s / 86400.0)
        out = np.concatenate([place, velocity], axis=2)
        out[failed != 0] = np.nan
        return out

    return states


def brute_force(sets: list[tuple[str, str, str]], duration_s: float, limit_km: float) -> list[tuple[int, int, float, float]]:
    """Every pair on a grid of 20 s: where distance has a minimum, a parabola through exact states at a tenth of a second."""
    states = states_of(sets)
    t = np.arange(-20.0, duration_s + 40.0, 20.0)
    found = []
    table = states(t)
    for i in range(len(sets)):
        relative = table[i + 1 :] - table[i]
        opening = (relative[..., :3] * relative[..., 3:]).sum(axis=2)
        speed = np.linalg.norm(relative[..., 3:], axis=2)
        distance = np.linalg.norm(relative[..., :3], axis=2)
        turning = (opening[:, :-1] < 0) & (opening[:, 1:] >= 0) & (distance[:, :-1] < limit_km + 20.0 * speed[:, :-1] + 2.0)
        for j, k in zip(*np.nonzero(turning), strict=True):
            low, high = t[k], t[k + 1]
            pair = states_of([sets[i], sets[i + 1 + j]])
            for _ in range(4):
                fine = np.linspace(low, high, 41)
                two = pair(fine)
                gap = np.linalg.norm(two[1, :, :3] - two[0, :, :3], axis=1)
                best = int(np.argmin(gap))
                low, high = fine[max(best - 1, 0)], fine[min(best + 1, 40)]
            if gap[best] < limit_km and 0.0 <= fine[best] < duration_s:
                found.append((i, i + 1 + int(j), float(fine[best]), float(gap[best])))
    return found


def check_against_brute_force(n: int, duration_s: float, limit_km: float) -> int:
    sets = crowd(folder("cdm").parent, n)
    expected = brute_force(sets, duration_s, limit_km)
    found = screen(states_of(sets), duration_s, limit_km)
    rows = list(zip(found.first, found.second, found.time_s, found.distance_km, strict=True))
    for i, j, time, distance in expected:
        near = [row for row in rows if row[0] == i and row[1] == j and abs(row[2] - time) < 0.5]
        if distance < limit_km - 0.001:
            assert len(near) == 1, (i, j, time, distance)
            assert near[0][3] == pytest.approx(distance, abs=0.001)
    assert len(rows) <= len(expected) + sum(distance > limit_km - 0.001 for *_, distance in rows)
    return len(expected)


def test_nothing_is_missed_against_every_pair() -> None:
    assert check_against_brute_force(100, 3600.0, 90.0) > 20


@pytest.mark.slow
def test_nothing_is_missed_against_every_pair_of_a_day() -> None:
    assert check_against_brute_force(300, 86400.0, 15.0) > 100


def test_slow_neighbours_and_chunk_borders_are_counted_once() -> None:
    def states(t_s: np.ndarray) -> np.ndarray:
        """One object in a circle, one that swings about it once a revolution, 1 km away, one that passes at 1800 s."""
        n = 1.1e-3
        angle = n * t_s
        zero = np.zeros_like(t_s)
        circle = np.stack([7000 * np.cos(angle), 7000 * np.sin(angle), zero], axis=1)
        speed = 7000 * n * np.stack([-np.sin(angle), np.cos(angle), zero], axis=1)
        swing = np.stack([zero, zero, 1.0 + 0.5 * np.sin(2 * angle)], axis=1)
        swing_speed = np.stack([zero, zero, n * np.cos(2 * angle)], axis=1)
        passing = np.stack([zero, zero, 2.0 + zero], axis=1) + 0.5 * (t_s - 1800.0)[:, None] * np.array([0.0, 0.0, 1.0])
        offset = np.array([0.6, 0.0, 0.0]) + np.zeros((len(t_s), 3))
        rows = [
            (circle, speed),
            (circle + swing, speed + swing_speed),
            (circle + passing + offset, speed + np.array([0.0, 0.0, 0.5])),
        ]
        return np.stack([np.hstack(row) for row in rows])

    found = screen(states, 5400.0, 3.0)
    pairs = list(zip(found.first.tolist(), found.second.tolist(), found.time_s.tolist(), strict=True))
    # 1 + sin(2 n t)/2 is least where 2 n t = 3 pi/2 (+ 2 pi)
    assert [p[2] for p in pairs if p[:2] == (0, 1)] == pytest.approx([0.75 * np.pi / 1.1e-3, 1.75 * np.pi / 1.1e-3], abs=1.0)
    assert len([p for p in pairs if p[:2] == (0, 2)]) == 1


def test_limits_are_refused_and_lost_objects_named() -> None:
    def gone(t_s: np.ndarray) -> np.ndarray:
        out = np.ones((2, len(t_s), 6)) * 7000.0
        out[1] = np.nan
        return out

    assert screen(gone, 600.0, 5.0).lost.tolist() == [1]
    with pytest.raises(UserError, match="distance: expected more than 0 and at most 200 km"):
        screen(gone, 600.0, 0.0)
    with pytest.raises(UserError, match="duration"):
        screen(gone, -1.0, 5.0)


@pytest.mark.slow
def test_the_command_writes_a_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sets = crowd(folder("cdm").parent, 60)
    path = tmp_path / "some.3le"
    path.write_text("\n".join(line for one in sets for line in one) + "\n")
    labels, found, _ = screen_elements(path, "2022-01-22T00:00:00", 0.05, 60.0)
    assert len(labels) == len(sets)
    out = tmp_path / "table.csv"
    arguments = ["conjunctions", "screen", str(path), "--start", "2022-01-22T00:00:00", "--days", "0.05", "--distance", "60"]
    assert run([*arguments, "--out", str(out)]) == 0
    lines = out.read_text().splitlines()
    assert lines[0] == "tca_utc,first,second,distance_km,speed_km_s"
    assert len(lines) == 1 + len(found.first)
    assert run([*arguments[:4], "2022-01-22T00:00:00+02:00", *arguments[5:]]) == 2
    assert "has a time zone" in capsys.readouterr().err
