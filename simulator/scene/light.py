"""What happens to light between its source and the camera, each effect with a switch of its own.

All are on in nature. Off, an effect is missing from image and truth alike; ground software, which does not know, still
corrects for it, and its products show the size of the effect.
"""

from dataclasses import dataclass, field


@dataclass(frozen=True, kw_only=True)
class LightOptions:
    """Aberration, light time, shadow and phase; defocus is the PSF's, the atmosphere has its own table."""

    annual_aberration: bool = field(
        default=True, metadata={"doc": "the Earth's motion about the Sun shifts stars, by up to 20.5 arcsec"}
    )
    orbital_aberration: bool = field(
        default=True,
        metadata={
            "doc": "the camera's motion about the Earth's centre shifts all: 5.2 arcsec in low orbit, 0.3 at a site (diurnal)"
        },
    )
    light_time: bool = field(default=True, metadata={"doc": "objects are seen where they were when their light left"})
    earth_shadow: bool = field(default=True, metadata={"doc": "the Earth shades objects: umbra and penumbra"})
    phase_function: bool = field(
        default=True, metadata={"doc": "brightness of a sphere follows its phase angle; off: as at full phase"}
    )
