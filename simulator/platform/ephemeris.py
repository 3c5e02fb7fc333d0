"""Moon and planets: ERFA's analytical theories, GCRS axes, kilometres.

The Moon is ERFA's `moon98` (Meeus 1998, after Chapront's ELP-2000/82), good to about 10 arcsec and 20 km; planets are `plan94`
(Simon et al. 1994, A&A 282, 663), good to 71 arcsec (Jupiter) and 86 arcsec (Saturn) from the Sun, less for the others.
"""

from typing import Final

import erfa
import numpy as np
from numpy.typing import NDArray

from simulator.platform.earth import AU_KM, DAY_S, LIGHT_KM_S, earth_velocity_km_s, sun_position_km, tt_parts

Array = NDArray[np.float64]

PLANETS: Final = ("Mercury", "Venus", "Mars", "Jupiter", "Saturn", "Uranus", "Neptune")
_NUMBER: Final = dict(zip(PLANETS, (1, 2, 4, 5, 6, 7, 8), strict=True))


def moon_position_km(tai_ns: int) -> Array:
    """Geocentric position (3,) of the Moon as light shows it: where it stood when the light left, against the Earth of now."""
    day, fraction = tt_parts(tai_ns)
    now = np.asarray(erfa.moon98(day, fraction)["p"]) * AU_KM
    delay_s = float(np.linalg.norm(now)) / LIGHT_KM_S
    moon_km = np.asarray(erfa.moon98(day, fraction - delay_s / DAY_S)["p"]) * AU_KM
    return np.asarray(moon_km - delay_s * earth_velocity_km_s(tai_ns))


def planet_position_km(name: str, tai_ns: int) -> tuple[Array, Array]:
    """Geocentric and heliocentric position (3,) of a planet when the light left that arrives now."""
    day, fraction = tt_parts(tai_ns)
    sun_km, delay_s = sun_position_km(tai_ns), 0.0
    for _ in range(3):
        heliocentric = np.asarray(erfa.plan94(day, fraction - delay_s / DAY_S, _NUMBER[name])["p"]) * AU_KM
        geocentric = heliocentric + sun_km
        delay_s = float(np.linalg.norm(geocentric)) / LIGHT_KM_S
    return geocentric, heliocentric
