"""Light of bodies made of flat faces, in passes of high orbits seen from low ones: the truth of the characterisation tests.

Boxes with or without a panel. Each face reflects by a Lambert term and a lobe about the mirror direction (Phong); the body turns
about one axis of its own that is fixed in space, or holds its attitude. Nothing here is shared with the simulator or the ground.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Body:
    """Faces: normals (f, 3) in the body, areas (f,) m^2, diffuse and mirror-like reflectance (f,), sharpness of the lobe (f,)."""

    normal: Array
    area: Array
    diffuse: Array
    mirror: Array
    sharpness: Array


def box(rng: np.random.Generator) -> Body:
    """A box whose faces differ: painted, bare or insulated; half of them have a panel of two faces."""
    a, b, c = rng.uniform(0.5, 4.0, 3)
    normal = np.vstack([np.eye(3), -np.eye(3)])
    area = np.array([b * c, a * c, a * b] * 2)
    if rng.random() < 0.5:
        tilt = rng.standard_normal(3)
        tilt /= np.linalg.norm(tilt)
        normal = np.vstack([normal, tilt, -tilt])
        area = np.concatenate([area, np.full(2, rng.uniform(1.0, 10.0))])
    n = len(area)
    return Body(
        normal=normal, area=area, diffuse=rng.uniform(0.05, 0.5, n), mirror=rng.uniform(0.0, 0.3, n),
        sharpness=10.0 ** rng.uniform(1.0, 2.5, n),
    )  # fmt: skip


def rotation(rng: np.random.Generator) -> Array:
    """A random rotation (3, 3)."""
    q = rng.standard_normal(4)
    w, x, y, z = q / np.linalg.norm(q)
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


def about(axis: Array, angle: Array) -> Array:
    """Rotations (n, 3, 3) about a unit axis (Rodrigues)."""
    k = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.asarray(np.eye(3) + np.sin(angle)[:, None, None] * k + (1.0 - np.cos(angle))[:, None, None] * (k @ k))


def light(body: Body, attitude: Array, to_sun: Array, to_observer: Array) -> Array:
    """Light (n,) in m^2 sr^-1 for attitudes (n, 3, 3) and unit vectors (n, 3)."""
    normal = np.einsum("nij,fj->nfi", attitude, body.normal)
    sun, view = np.einsum("nfi,ni->nf", normal, to_sun), np.einsum("nfi,ni->nf", normal, to_observer)
    seen = (sun > 0.0) & (view > 0.0)
    mirrored = 2.0 * sun[:, :, None] * normal - to_sun[:, None, :]
    near = np.clip(np.einsum("nfi,ni->nf", mirrored, to_observer), 0.0, None)
    lobe = body.mirror * (body.sharpness + 2.0) / (2.0 * math.pi) * near**body.sharpness
    return np.asarray((seen * body.area * sun * view * (body.diffuse / math.pi + lobe)).sum(axis=1))


@dataclass(frozen=True, kw_only=True, eq=False)
class Seen:
    """One pass: times (n,) s, magnitudes and errors (n,), range (n,) km, phase (n,) deg."""

    t_s: Array
    mag: Array
    mag_err: Array
    range_km: Array
    phase_deg: Array


def passes(
    rng: np.random.Generator, *, period_s: float | None, count: int = 3, minutes: float = 7.0, every_s: float = 2.0,
    exposure_s: float = 1.0, bins: int = 1, noise_mag: float = 0.1,
) -> list[Seen]:  # fmt: skip
    """Passes of one object over days. period_s : of the turn; None: half of them look at the Earth's centre, half do not turn.

    bins : samples of each exposure (a trail); 1 is a point, the light of which the exposure averages. noise_mag : at mean light.
    """
    body, frame = box(rng), rotation(rng)
    axis = rotation(rng)[0]
    radius = rng.choice([26_560.0, 42_164.0])
    rate = math.sqrt(398600.44 / radius**3)
    plane = rotation(rng)
    sun_plane = rotation(rng)
    to_earth = rng.random() < 0.5
    out = []
    for _ in range(200):
        start = rng.uniform(0.0, 5 * 86400.0)
        n = int(60.0 * minutes / every_s)
        frames = start + every_s * np.arange(n) + rng.uniform(0.0, 0.1 * every_s, n)
        fine = 16 if bins == 1 else 4
        inside = (np.arange(bins * fine) + 0.5) / (bins * fine) * exposure_s
        t = (frames[:, None] + inside).reshape(-1)
        place = radius * (np.cos(rate * t)[:, None] * plane[0] + np.sin(rate * t)[:, None] * plane[1])
        watch = 7078.0 * (np.cos(0.00106 * t)[:, None] * sun_plane[0] + np.sin(0.00106 * t)[:, None] * sun_plane[1])
        sun = np.tile([1.0, 0.0, 0.0], (len(t), 1))
        line = watch - place
        range_km = np.linalg.norm(line, axis=1)
        to_observer = line / range_km[:, None]
        phase = np.degrees(np.arccos(np.clip((to_observer * sun).sum(axis=1), -1.0, 1.0)))
        along = (watch * line).sum(axis=1) / range_km
        hidden = np.linalg.norm(watch - along[:, None] * to_observer, axis=1).min() < 6500.0 and along.min() > 0.0
        if phase.max() > 110.0 or hidden:
            continue
        if period_s is None and not to_earth:
            attitude = np.tile(frame, (len(t), 1, 1))
        elif period_s is None:
            # held to the Earth: nadir and orbit normal
            down = -place / radius
            normal = np.tile(np.cross(plane[0], plane[1]), (len(t), 1))
            attitude = np.stack([np.cross(normal, down), normal, down], axis=2) @ frame
        else:
            attitude = about(axis, 2.0 * math.pi * t / period_s) @ frame
        flux = light(body, attitude, sun, to_observer)
        mean = flux.reshape(len(frames) * bins, fine).mean(axis=1) * 1e6 / range_km.reshape(-1, fine).mean(axis=1) ** 2
        if mean.mean() <= 0.0:
            continue
        sigma = noise_mag / 1.0857 * mean.mean() * math.sqrt(bins)
        noisy = mean + sigma * rng.standard_normal(len(mean))
        # what is not found has no magnitude
        good = noisy > 3.0 * sigma
        if good.sum() < 0.5 * len(good):
            continue
        middle = t.reshape(-1, fine).mean(axis=1)[good]
        out.append(
            Seen(
                t_s=middle - middle[0], mag=-2.5 * np.log10(noisy[good]), mag_err=1.0857 * sigma / noisy[good],
                range_km=range_km.reshape(-1, fine).mean(axis=1)[good], phase_deg=phase.reshape(-1, fine).mean(axis=1)[good],
            )
        )  # fmt: skip
        if len(out) == count:
            return out
    return []
