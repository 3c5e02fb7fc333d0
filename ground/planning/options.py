"""What a plan asks for."""

from dataclasses import dataclass, field

from sboc_e2e.icd.errors import UserError


@dataclass(frozen=True, kw_only=True)
class ConstraintOptions:
    """What forbids a direction. Angles are between the boresight and the body's centre, the Earth's limb excepted."""

    sun_deg: float = field(default=90.0, metadata={"doc": "least angle from the Sun, in orbit", "min": 0.0, "max": 180.0})
    moon_deg: float = field(default=15.0, metadata={"doc": "least angle from the Moon", "min": 0.0, "max": 180.0})
    limb_deg: float = field(
        default=10.0, metadata={"doc": "least angle from the Earth's limb, in orbit", "min": 0.0, "max": 120.0}
    )
    elevation_deg: float = field(default=20.0, metadata={"doc": "least elevation, at a site", "min": 0.0, "max": 90.0})
    darkness_deg: float = field(
        default=-12.0,
        metadata={"doc": "highest elevation of the Sun, at a site; -18 deg is full night", "min": -90.0, "max": 0.0},
    )
    max_rate_deg_s: float = field(
        default=0.5, metadata={"doc": "fastest motion of a target against the stars", "min": 1e-6, "max": 10.0}
    )


@dataclass(frozen=True, kw_only=True)
class SlewOptions:
    """How the camera gets from one field to the next."""

    rate_deg_s: float = field(default=0.5, metadata={"doc": "rate of a slew", "min": 1e-3, "max": 100.0})
    settling_s: float = field(default=20.0, metadata={"doc": "rest after a slew", "min": 0.0, "max": 3600.0})


@dataclass(frozen=True, kw_only=True)
class KnowledgeOptions:
    """How well orbits are known when the plan begins, one sigma."""

    across_km: float = field(default=1.0, metadata={"doc": "of a position, radially and out of plane", "min": 1e-6, "max": 1e5})
    along_km: float = field(default=10.0, metadata={"doc": "of a position, along the orbit", "min": 1e-6, "max": 1e5})
    drift_km_day: float = field(default=1.0, metadata={"doc": "growth of the error along the orbit", "min": 1e-9, "max": 1e5})


@dataclass(frozen=True, kw_only=True)
class PlanOptions:
    """Horizon, visits and what they are worth."""

    days: float = field(default=7.0, metadata={"doc": "length of the plan", "min": 0.001, "max": 60.0})
    visit_s: float = field(
        default=120.0, metadata={"doc": "length of a visit, slew and settling included", "min": 1.0, "max": 86400.0}
    )
    exposures: int = field(default=8, metadata={"doc": "exposures of a visit that are measured", "min": 1, "max": 100_000})
    size_m: float = field(default=1.0, metadata={"doc": "diameter of targets of unknown size", "min": 1e-3, "max": 1e3})
    albedo: float = field(default=0.15, metadata={"doc": "Bond albedo of diffuse spheres", "min": 1e-3, "max": 1.0})
    faintest_snr: float = field(default=7.0, metadata={"doc": "least S/N of a target in one exposure", "min": 0.1, "max": 1e4})
    daily_visits: int = field(
        default=0, metadata={"doc": "visits that the downlink carries in a day, 0: any number", "min": 0, "max": 100_000}
    )
    sky_mag_arcsec2: float = field(default=21.8, metadata={"doc": "V brightness of the sky", "min": 10.0, "max": 30.0})
    look_ahead: int = field(
        default=8,
        metadata={"doc": "schedules kept side by side; 1 is greedy, and nothing is searched again", "min": 1, "max": 64},
    )
    choices: int = field(default=6, metadata={"doc": "fields tried for each visit of each schedule", "min": 1, "max": 64})
    constraints: ConstraintOptions = field(default_factory=ConstraintOptions, metadata={"doc": "what forbids a direction"})
    slew: SlewOptions = field(default_factory=SlewOptions, metadata={"doc": "slews"})
    knowledge: KnowledgeOptions = field(default_factory=KnowledgeOptions, metadata={"doc": "what is known at the start"})

    def __post_init__(self) -> None:
        if self.slew.settling_s >= self.visit_s:
            raise UserError(
                f"plan.slew.settling: {self.slew.settling_s:g} s leaves nothing of a visit of {self.visit_s:g} s; allowed is less"
            )
        if self.days * 86400.0 < self.visit_s:
            span_s = self.days * 86400.0
            raise UserError(f"plan.days: {span_s:g} s are shorter than a visit of {self.visit_s:g} s; allowed is more")
