"""A run made by hand: circular orbits in closed form, messages written line by line, tables of truth; no code of the chain."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import erfa
import numpy as np
import pytest
from astropy.table import Table
from astropy.time import Time, TimeDelta
from numpy.typing import NDArray

from sboc_e2e.score.published import published_products
from sboc_e2e.truth import PATH_NODES, empty

Array = NDArray[np.float64]

GM = 398_600.4418
LIGHT_KM_S = 299_792.458
EXPOSURE_S, PERIOD_S = 0.2, 0.25
EPOCH = Time("2027-01-29T00:00:00", scale="utc")
EPOCH_TAI_NS = round((EPOCH.tai.mjd - 36204.0) * 86_400) * 10**9
"""MJD 36204 is 1958-01-01."""

TO_EME2000 = np.asarray(erfa.bp06(2451545.0, 0.0)[0])


@dataclass(frozen=True)
class Circle:
    """A circular orbit in the plane of two unit vectors."""

    radius_km: float
    first: Array
    second: Array

    def at(self, t_s: Array) -> tuple[Array, Array]:
        """Positions and velocities (n, 3)."""
        rate = np.sqrt(GM / self.radius_km**3)
        angle = rate * np.asarray(t_s, float)[..., None]
        position = self.radius_km * (np.cos(angle) * self.first + np.sin(angle) * self.second)
        return position, self.radius_km * rate * (np.cos(angle) * self.second - np.sin(angle) * self.first)


def circle(position: Array, heading: Array) -> Circle:
    """The circular orbit through a position that moves about towards `heading`."""
    radius = float(np.linalg.norm(position))
    up = position / radius
    ahead = heading - (heading @ up) * up
    return Circle(radius, up, ahead / np.linalg.norm(ahead))


OBSERVER = circle(np.array([7078.0, 0.0, 0.0]), np.array([0.0, 0.1, 1.0]))


def text_of(tai_ns: int) -> str:
    """UTC to the microsecond by astropy."""
    time = (EPOCH + TimeDelta((tai_ns - EPOCH_TAI_NS) * 1e-9, format="sec")).utc
    time.precision = 6
    return str(time.isot)


def angles(unit: Array) -> tuple[Array, Array]:
    return np.degrees(np.arctan2(unit[..., 1], unit[..., 0])) % 360.0, np.degrees(np.arcsin(unit[..., 2]))


@dataclass
class HandMade:
    """Truth of `n_objects` over `n_frames`; messages with chosen errors.

    The truth's nodes lie in time as a global shutter at 4 Hz makes them; every object is seen in every frame.
    """

    folder: Path
    n_objects: int = 5
    n_frames: int = 8
    orbits: list[Circle] = field(default_factory=list)

    def __post_init__(self) -> None:
        rng = np.random.default_rng(11)
        place = OBSERVER.at(np.array([1.0]))[0][0]
        for _ in range(self.n_objects):
            # ahead of the camera, which looks outwards and across its orbit
            target = place + rng.uniform(300.0, 900.0) * np.array([0.6, 0.8, 0.0]) + rng.uniform(-20.0, 20.0, 3)
            self.orbits.append(circle(target, rng.normal(size=3)))
        (self.folder / "products").mkdir(parents=True)
        node_s = np.linspace(0.0, EXPOSURE_S, PATH_NODES)
        streaks, frames, objects = empty("streaks", self.n_objects * self.n_frames), empty("frames", self.n_frames), None
        objects = empty("objects", self.n_objects)
        for k in range(self.n_frames):
            start_ns = EPOCH_TAI_NS + round(k * PERIOD_S * 1e9)
            middle = OBSERVER.at(np.array([k * PERIOD_S + EXPOSURE_S / 2]))
            frames[k]["frame"], frames[k]["t_start_true_tai_ns"], frames[k]["exposure_ns"] = k, start_ns, EXPOSURE_S * 1e9
            frames[k]["position_m"], frames[k]["velocity_m_s"] = middle[0][0] * 1e3, middle[1][0] * 1e3
            for number in range(self.n_objects):
                row = streaks[k * self.n_objects + number]
                unit, distance = self.direction(number, k * PERIOD_S + node_s)
                row["frame"], row["object_id"], row["mag"] = k, number, 11.0 + 0.1 * number
                row["path_t_tai_ns"] = start_ns + np.rint(node_s * 1e9).astype(np.int64)
                row["t0_tai_ns"], row["t1_tai_ns"] = row["path_t_tai_ns"][0], row["path_t_tai_ns"][-1]
                row["path_ra_deg"], row["path_dec_deg"] = angles(unit)
                row["range_km"] = distance[PATH_NODES // 2]
        for number, orbit in enumerate(self.orbits):
            objects[number]["object_id"], objects[number]["a_km"] = number, orbit.radius_km
        self.truth = {"streaks": Table(streaks), "frames": Table(frames), "objects": Table(objects)}
        self.truth_mag = {row: float(mag) for row, mag in enumerate(streaks["mag"])}
        self.owner = {100 + number: number for number in range(self.n_objects)}
        self.streaks = self._streaks(streaks)
        self.tracklets = Table(
            {"tracklet_id": list(self.owner), "mag": objects["object_id"] * 0.1 + 11.0, "mag_err": np.full(self.n_objects, 0.02)}
        )

    def direction(self, number: int, t_s: Array) -> tuple[Array, Array]:
        """Published direction (n, 3) and distance (n,): light left the object earlier, no aberration."""
        place = OBSERVER.at(t_s)[0]
        delay = np.zeros(len(t_s))
        for _ in range(6):
            vector = self.orbits[number].at(t_s - delay)[0] - place
            delay = np.linalg.norm(vector, axis=1) / LIGHT_KM_S
        return vector / (delay * LIGHT_KM_S)[:, None], delay * LIGHT_KM_S

    def _streaks(self, truth: NDArray[np.void]) -> Table:
        """products/streaks.ecsv without error."""
        middle = PATH_NODES // 2
        out = Table({"tracklet_id": 100 + truth["object_id"], "mag_err": np.full(len(truth), 0.05)})
        for name, node in (("t0_tai_ns", 0), ("t_mid_tai_ns", middle), ("t1_tai_ns", -1)):
            out[name] = truth["path_t_tai_ns"][:, node]
        for name, node in (("0", 0), ("_mid", middle), ("1", -1)):
            out[f"ra{name}_deg"], out[f"dec{name}_deg"] = truth["path_ra_deg"][:, node], truth["path_dec_deg"][:, node]
        return out

    def write_tdm(
        self, *, along: float = 0.0, cross: float = 0.0, late_ms: float = 0.0, swapped: bool = False, mag: float = 0.0,
        frame: str = "EME2000", name: str = "tracklets.tdm",
    ) -> Path:  # fmt: skip
        """Both ends of every trail: errors in arcsec along the motion and across it, epochs late by so much."""
        lines = ["CCSDS_TDM_VERS = 2.0", "CREATION_DATE = 2027-01-29T00:00:02", "ORIGINATOR = HAND", ""]
        for tracklet, number in self.owner.items():
            lines += [
                "META_START", "COMMENT DATA_START = not here", f"TRACK_ID = HAND-T{tracklet:06d}", "TIME_SYSTEM = UTC",
                "PARTICIPANT_1 = EYE", f"PARTICIPANT_2 = UCT-{tracklet:06d}", "MODE = SEQUENTIAL", "PATH = 2,1",
                "TIMETAG_REF = RECEIVE", "ANGLE_TYPE = RADEC", f"REFERENCE_FRAME = {frame}", "META_STOP", "DATA_START",
            ]  # fmt: skip
            for k in range(self.n_frames):
                for t_s in (k * PERIOD_S, k * PERIOD_S + EXPOSURE_S):
                    unit, _ = self.direction(number, np.array([t_s - 1e-3, t_s, t_s + 1e-3]))
                    motion = (unit[2] - unit[0]) / np.linalg.norm(unit[2] - unit[0])
                    turned = unit[1] + np.radians(along / 3600) * motion + np.radians(cross / 3600) * np.cross(motion, unit[1])
                    if frame == "EME2000":
                        turned = TO_EME2000 @ turned
                    ra, dec = angles(turned / np.linalg.norm(turned))
                    if swapped:
                        ra, dec = dec % 360.0, ((ra + 90.0) % 180.0) - 90.0
                    epoch = text_of(EPOCH_TAI_NS + round(t_s * 1e9 + late_ms * 1e6))
                    lines += [f"ANGLE_1 = {epoch} {ra:.10f}", f"ANGLE_2 = {epoch} {dec:.10f}"]
                middle = text_of(EPOCH_TAI_NS + round((k * PERIOD_S + EXPOSURE_S / 2) * 1e9))
                lines.append(f"MAG = {middle} {11.0 + 0.1 * number + mag * (-1) ** k:.3f}")
            lines.append("DATA_STOP")
        path = self.folder / "products" / name
        path.write_text("\n".join(lines) + "\n")
        return path

    def write_oem(self, *, position_m: float = 0.0, velocity_m_s: float = 0.0, covariance: bool = False) -> Path:
        """States at 4 Hz, all with the same error along x."""
        lines = [
            "CCSDS_OEM_VERS = 2.0", "CREATION_DATE = 2027-01-29T00:00:02", "ORIGINATOR = HAND", "", "META_START",
            "OBJECT_NAME = EYE", "OBJECT_ID = 2027-000A", "CENTER_NAME = EARTH", "REF_FRAME = EME2000", "TIME_SYSTEM = UTC",
            "START_TIME = 2027-01-29T00:00:00", "STOP_TIME = 2027-01-29T00:00:02", "META_STOP", "",
        ]  # fmt: skip
        blocks = ["", "COVARIANCE_START"]
        for k in range(self.n_frames):
            t_s = k * PERIOD_S + 0.05
            position, velocity = (v[0] for v in OBSERVER.at(np.array([t_s])))
            x = TO_EME2000 @ position + [position_m * 1e-3, 0.0, 0.0]
            v = TO_EME2000 @ velocity + [velocity_m_s * 1e-3, 0.0, 0.0]
            epoch = text_of(EPOCH_TAI_NS + round(t_s * 1e9))
            lines.append(f"{epoch} " + " ".join(f"{value:.9f}" for value in (*x, *v)))
            # sigma 5 m and 0.05 m/s of each axis, in radial, transverse, normal components
            blocks += [f"EPOCH = {epoch}", "COV_REF_FRAME = RTN"]
            blocks += [" ".join(["0.0"] * i + ["2.5e-05" if i < 3 else "2.5e-09"]) for i in range(6)]
        blocks.append("COVARIANCE_STOP")
        path = self.folder / "products" / "observer.oem"
        path.write_text("\n".join(lines + (blocks if covariance else [])) + "\n")
        return path

    def write_opm(self, tracklet: int, error: Array, covariance: Array | None, *, t_s: float = 0.6) -> Path:
        """An object's state plus an error (6,) km, km/s, on EME2000 axes."""
        position, velocity = (TO_EME2000 @ v[0] for v in self.orbits[self.owner[tracklet]].at(np.array([t_s])))
        turn = np.kron(np.eye(2), TO_EME2000)
        state = np.concatenate([position, velocity]) + turn @ error
        lines = [
            "CCSDS_OPM_VERS = 2.0", "CREATION_DATE = 2027-01-29T00:00:02", "ORIGINATOR = HAND",
            f"OBJECT_NAME = UCT-{tracklet:06d}",
            "OBJECT_ID = UNKNOWN", "CENTER_NAME = EARTH", "REF_FRAME = EME2000", "TIME_SYSTEM = UTC",
            f"EPOCH = {text_of(EPOCH_TAI_NS + round(t_s * 1e9))}",
        ]  # fmt: skip
        names = ("X", "Y", "Z", "X_DOT", "Y_DOT", "Z_DOT")
        lines += [f"{n} = {v:.12f} [{'km' if k < 3 else 'km/s'}]" for k, (n, v) in enumerate(zip(names, state, strict=True))]
        if covariance is not None:
            c = turn @ covariance @ turn.T
            lines += [f"C{names[i]}_{names[j]} = {c[i, j]:.15e}" for i in range(6) for j in range(i + 1)]
        path = self.folder / "products" / f"orbit_{tracklet}.opm"
        path.write_text("\n".join(lines) + "\n")
        return path

    def score(self) -> dict[str, Any]:
        """The section, from what was written."""
        return published_products(self.folder / "products", self.streaks, self.tracklets, self.truth, self.owner, self.truth_mag)


@pytest.fixture
def hand_made(tmp_path: Path) -> HandMade:
    return HandMade(tmp_path / "run")
