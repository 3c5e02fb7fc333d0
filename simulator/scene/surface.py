"""Surfaces of debris: how much light each piece returns, where to, in which colour, and how it changes while it turns.

Albedo: medians of 0.1 to 0.175 are used for debris (Mulrooney, Matney & Barker 2008, AMOS: 0.175); pieces scatter about it by
half of their value (assumed). Phase function: a diffuse and a mirror-like sphere mixed (Hejduk 2011, AMOS). Colour, periods,
facets and flashes: assumed; B-V lies between that of sunlight, 0.65, which bare metal returns, and copper-coloured foil's, 1.1.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SUN_B_V = 0.65
"""Rounded: `passband.SUN_B_V` is 0.653. The difference cancels between a piece's factor and the Sun's, but for curvature."""


@dataclass(frozen=True, kw_only=True)
class SurfaceOptions:
    """Scatter of surface properties between pieces. With all at zero, pieces are grey Lambert spheres of one albedo."""

    albedo_scatter: float = field(
        default=0.5, metadata={"doc": "log-normal scatter of the albedo about population.albedo", "min": 0.0, "max": 2.0}
    )
    specular_share: float = field(
        default=0.25,
        metadata={"doc": "mean share of the light that goes as from a mirror-like sphere; 0 to twice it", "min": 0.0, "max": 0.5},
    )
    reddening_mag: float = field(default=0.2, metadata={"doc": "mean B-V above that of the Sun", "min": -0.5, "max": 1.0})
    colour_scatter_mag: float = field(default=0.15, metadata={"doc": "scatter of B-V", "min": 0.0, "max": 0.5})
    facet_share: float = field(
        default=0.5, metadata={"doc": "share of tumbling pieces with two unequal maxima in a turn", "min": 0.0, "max": 1.0}
    )
    glint_share: float = field(
        default=0.2, metadata={"doc": "share of tumbling pieces that flash once in a turn", "min": 0.0, "max": 1.0}
    )
    glint_factor: float = field(
        default=5.0, metadata={"doc": "median peak of the flashes over the mean light", "min": 0.0, "max": 1000.0}
    )
    glint_turn_deg: float = field(
        default=1.0,
        metadata={
            "doc": "turn of the piece in one sigma of a flash: half of the facet's roughness; the Sun alone makes 0.07 deg",
            "min": 0.05,
            "max": 30.0,
        },
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Surfaces:
    """Of n pieces: Bond albedo, share of mirror-like light, electrons over those of sunlight of the same V."""

    albedo: Array
    specular: Array
    colour: Array

    def taken(self, which: NDArray[np.intp]) -> "Surfaces":
        """Those of some pieces."""
        return Surfaces(albedo=self.albedo[which], specular=self.specular[which], colour=self.colour[which])


def draw_surfaces(
    rng: np.random.Generator,
    n: int,
    median_albedo: float,
    options: SurfaceOptions,
    colour_factor: Callable[[Array], Array] | None,
) -> Surfaces:
    """Surfaces of n pieces. colour_factor : electrons of a B-V over those of the Sun's at equal V; None for a grey camera."""
    albedo = median_albedo * np.exp(options.albedo_scatter * rng.standard_normal(n))
    specular = 2.0 * options.specular_share * rng.random(n)
    b_v = np.clip(SUN_B_V + options.reddening_mag + options.colour_scatter_mag * rng.standard_normal(n), -0.2, 1.6)
    colour = np.ones(n)
    if colour_factor is not None and (options.reddening_mag != 0.0 or options.colour_scatter_mag > 0.0):
        colour = np.asarray(colour_factor(b_v) / colour_factor(np.array([SUN_B_V]))[0])
    return Surfaces(albedo=np.minimum(albedo, 1.0), specular=specular, colour=colour)
