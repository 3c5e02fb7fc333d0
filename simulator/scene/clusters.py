"""Globular clusters: crowds of stars that a catalogue of bright stars does not have.

Place, V and half-light radius of those brighter than V = 8 (Harris 1996, AJ 112, 1487, edition of 2010). Members are equal stars,
drawn by seed from Plummer's profile; their brightness stands for the red giants that give most of the light (ASSUMED). Open
clusters are those of the star catalogue.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from simulator.optics.instrument import InstrumentOptions
from simulator.randomness import Effect, generator
from simulator.scene.stars import StarField, unit_vectors

Array = NDArray[np.float64]

MEMBERS: Final = 3000  # of equal light, ASSUMED: fewer make brighter grains
_FARTHEST: Final = 8.0
"""Half-light radii within which members stand in projection; 98.5 % of Plummer's light does."""
_B_V: Final = 0.7  # one for all clusters, ASSUMED; it acts on the light in a wide band only
FIRST_CLUSTER_ID: Final = -(1 << 61) - (1 << 59)
"""Identity of members in the truth of stars, downwards by 10,000 for each cluster: apart from bodies (-2^62) and galaxies."""
CLUSTERS: Final = (
    # NGC, right ascension and declination (deg, J2000), V, half-light radius (arcmin)
    (104, 6.024, -72.081, 3.95, 3.17),
    (362, 15.809, -70.849, 6.40, 0.82),
    (1851, 78.528, -40.047, 7.14, 0.51),
    (1904, 81.046, -24.525, 7.73, 0.65),
    (2808, 138.013, -64.864, 6.20, 0.80),
    (3201, 154.403, -46.412, 6.75, 3.10),
    (4590, 189.867, -26.744, 7.84, 1.51),
    (5024, 198.230, 18.168, 7.61, 1.31),
    (5139, 201.697, -47.480, 3.68, 5.00),
    (5272, 205.548, 28.377, 6.19, 2.31),
    (5904, 229.638, 2.081, 5.65, 1.77),
    (6093, 244.260, -22.976, 7.33, 0.61),
    (6121, 245.897, -26.526, 5.63, 4.33),
    (6171, 248.133, -13.054, 7.93, 1.73),
    (6205, 250.422, 36.460, 5.78, 1.69),
    (6218, 251.809, -1.949, 6.70, 1.77),
    (6254, 254.288, -4.100, 6.60, 1.95),
    (6266, 255.303, -30.114, 6.45, 0.92),
    (6273, 255.657, -26.268, 6.77, 1.32),
    (6333, 259.797, -18.516, 7.72, 0.96),
    (6341, 259.281, 43.136, 6.44, 1.02),
    (6388, 264.072, -44.736, 6.72, 0.52),
    (6397, 265.175, -53.674, 5.73, 2.90),
    (6402, 264.400, -3.246, 7.59, 1.30),
    (6441, 267.554, -37.051, 7.15, 0.57),
    (6541, 272.010, -43.715, 6.30, 1.06),
    (6626, 276.137, -24.870, 6.79, 1.97),
    (6637, 277.846, -32.348, 7.64, 0.84),
    (6656, 279.100, -23.905, 5.10, 3.36),
    (6681, 280.803, -32.292, 7.87, 0.71),
    (6715, 283.764, -30.480, 7.60, 0.82),
    (6752, 287.717, -59.985, 5.40, 1.91),
    (6809, 294.999, -30.965, 6.32, 2.83),
    (7078, 322.493, 12.167, 6.20, 1.00),
    (7089, 323.363, -0.823, 6.47, 1.06),
    (7099, 325.092, -23.180, 7.19, 1.03),
)


def members(number: int, direction: Array, half_light_rad: float, seed: int) -> Array:
    """Directions (n, 3) of a cluster's members.

    In projection Plummer's profile holds the share ``r^2 / (r^2 + h^2)`` of the light within r.
    """
    rng = generator(seed, Effect.CLUSTERS, block=number)
    share = rng.random(MEMBERS) * _FARTHEST**2 / (_FARTHEST**2 + 1.0)
    radius, turn = half_light_rad * np.sqrt(share / (1.0 - share)), 2.0 * np.pi * rng.random(MEMBERS)
    east = np.cross([0.0, 0.0, 1.0], direction)
    east /= np.linalg.norm(east)
    north = np.cross(direction, east)
    seen = direction + (radius * np.cos(turn))[:, None] * east + (radius * np.sin(turn))[:, None] * north
    return np.asarray(seen / np.linalg.norm(seen, axis=1, keepdims=True))


def clusters_around(direction: Array, radius_deg: float, instrument: InstrumentOptions, seed: int) -> list[StarField]:
    """Members of all globular clusters that reach within a radius of a direction (3,)."""
    fields = []
    for number, ra_deg, dec_deg, v_mag, half_light_arcmin in CLUSTERS:
        middle = unit_vectors(np.array([ra_deg]), np.array([dec_deg]))[0]
        reach_deg = radius_deg + _FARTHEST * half_light_arcmin / 60.0
        if middle @ direction < np.cos(np.radians(reach_deg)):
            continue
        colour = float(instrument.colour_factor(np.array([_B_V]))[0])
        each_e_s = instrument.true_zero_point_e_s * 10.0 ** (-0.4 * v_mag) * colour / MEMBERS
        fields.append(
            StarField(
                direction=members(number, middle, np.radians(half_light_arcmin / 60.0), seed),
                flux_e_s=np.full(MEMBERS, each_e_s),
                star_id=FIRST_CLUSTER_ID - (number * 10_000 + np.arange(MEMBERS, dtype=np.int64)),
                v_mag=np.full(MEMBERS, v_mag + 2.5 * np.log10(MEMBERS), dtype=np.float32),
                b_v=np.full(MEMBERS, _B_V, dtype=np.float32),
            )
        )
    return fields
