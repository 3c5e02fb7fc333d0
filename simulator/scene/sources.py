"""Where a run's objects come from: options of each source, and the objects made from them."""

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.errors import UserError
from simulator.platform import all_forces
from simulator.platform.earth import DAY_S, EARTH_RADIUS_KM, tai_ns_of_utc
from simulator.platform.earth_orientation import ARCSEC_RAD
from simulator.platform.kepler import Elements, elements_in, elements_of, state_of, velocity_through
from simulator.randomness import Effect, generator
from simulator.scene.breakup import BreakupOptions
from simulator.scene.encounters import Drawn, PopulationOptions
from simulator.scene.objects import Identity, OrbitingObject, PixelPathObject, SkyPathObject, orbit_positions
from simulator.scene.reflection import STEADY, LightCurve
from simulator.scene.satellites import SatelliteOptions
from simulator.scene.stars import unit_vectors
from simulator.scene.walker import WalkerOptions

Array = NDArray[np.float64]

FORCES: Final = ("oblate", "all")
LONGEST_DAYS: Final = 60.0
"""Between the epoch of an orbit under all forces and the run: each of them is integrated minute by minute."""


@dataclass(frozen=True, kw_only=True)
class LightCurveOptions:
    """Variation of one object's brightness."""

    period_s: float = field(default=10.0, metadata={"doc": "period of tumbling", "min": 1e-3, "max": 1e6})
    amplitude: float = field(
        default=0.0, metadata={"doc": "half of the peak-to-peak change over the mean", "min": 0.0, "max": 1.0}
    )
    phase_deg: float = field(default=0.0, metadata={"doc": "phase at the epoch", "min": -360.0, "max": 360.0})
    glint_factor: float = field(default=0.0, metadata={"doc": "peak of the flash over the mean", "min": 0.0, "max": 1e6})
    glint_width_s: float = field(default=0.01, metadata={"doc": "sigma of the flash", "min": 1e-6, "max": 1e4})

    def curve(self) -> LightCurve:
        """The light curve."""
        return LightCurve(
            period_s=self.period_s,
            amplitude=self.amplitude,
            phase_rad=float(np.radians(self.phase_deg)),
            glint_factor=self.glint_factor,
            glint_width_s=self.glint_width_s,
        )


@dataclass(frozen=True, kw_only=True)
class OrbitOptions:
    """A sphere on an orbit, osculating elements, GCRS axes.

    With an epoch of its own and all forces the same object is met in runs of other hours and days.
    """

    name: str = field(default="orbit", metadata={"doc": "name"})
    size_m: float = field(default=1.0, metadata={"doc": "diameter", "min": 1e-5, "max": 1000.0})
    albedo: float = field(default=0.175, metadata={"doc": "Bond albedo", "min": 0.001, "max": 1.0})
    semi_major_axis_km: float = field(default=7178.0, metadata={"doc": "semi-major axis", "min": 6400.0, "max": 1e6})
    eccentricity: float = field(default=0.001, metadata={"doc": "eccentricity", "min": 0.0, "max": 0.98})
    inclination_deg: float = field(default=98.0, metadata={"doc": "inclination", "min": 0.0, "max": 180.0})
    node_deg: float = field(default=0.0, metadata={"doc": "right ascension of the ascending node", "min": -360.0, "max": 360.0})
    perigee_deg: float = field(default=0.0, metadata={"doc": "argument of perigee", "min": -360.0, "max": 360.0})
    mean_anomaly_deg: float = field(default=0.0, metadata={"doc": "mean anomaly", "min": -360.0, "max": 360.0})
    epoch_utc: str = field(default="", metadata={"doc": "epoch of the elements; default is the epoch of the run"})
    forces: str = field(
        default="oblate",
        metadata={
            "doc": "`oblate`: the Earth's mass and oblateness; `all`: degree 4, Sun, Moon, radiation pressure, no drag",
            "choices": FORCES,
        },
    )
    area_to_mass_m2_kg: float = field(
        default=0.02,
        metadata={"doc": "radiation coefficient times area over mass, for `all` forces", "min": 0.0, "max": 100.0},
    )
    light_curve: LightCurveOptions = field(default_factory=LightCurveOptions, metadata={"doc": "variation"})


@dataclass(frozen=True, kw_only=True)
class PassingOptions:
    """A sphere on an orbit of given size, shape and inclination that passes a given point of the field at a given time."""

    name: str = field(default="passing", metadata={"doc": "name"})
    size_m: float = field(default=1.0, metadata={"doc": "diameter", "min": 1e-5, "max": 1000.0})
    albedo: float = field(default=0.175, metadata={"doc": "Bond albedo", "min": 0.001, "max": 1.0})
    range_km: float = field(default=20000.0, metadata={"doc": "distance from the camera when it passes", "min": 0.01, "max": 1e6})
    field_row: float = field(
        default=0.0, metadata={"doc": "place along rows: -1 first row, 0 centre, 1 last row", "min": -1.0, "max": 1.0}
    )
    field_col: float = field(
        default=0.0, metadata={"doc": "place along cols: -1 first column, 0 centre, 1 last column", "min": -1.0, "max": 1.0}
    )
    when: float = field(default=0.5, metadata={"doc": "time of passing, as a share of the run", "min": 0.0, "max": 1.0})
    semi_major_axis_km: float = field(default=26560.0, metadata={"doc": "semi-major axis", "min": 6400.0, "max": 1e6})
    eccentricity: float = field(default=0.7, metadata={"doc": "eccentricity", "min": 0.0, "max": 0.98})
    inclination_deg: float = field(default=63.4, metadata={"doc": "inclination", "min": 0.0, "max": 180.0})
    ascending: bool = field(default=True, metadata={"doc": "it moves northwards"})
    outbound: bool = field(default=True, metadata={"doc": "it moves away from the Earth"})
    light_curve: LightCurveOptions = field(default_factory=LightCurveOptions, metadata={"doc": "variation"})


@dataclass(frozen=True, kw_only=True)
class EncounterOptions:
    """A sphere given by its motion relative to the camera at one instant; it then follows its own orbit."""

    name: str = field(default="encounter", metadata={"doc": "name"})
    size_m: float = field(default=0.01, metadata={"doc": "diameter", "min": 1e-5, "max": 1000.0})
    albedo: float = field(default=0.1, metadata={"doc": "Bond albedo", "min": 0.001, "max": 1.0})
    range_km: float = field(default=10.0, metadata={"doc": "distance at that instant", "min": 0.01, "max": 1e6})
    field_row: float = field(
        default=0.0, metadata={"doc": "place along rows: -1 first row, 0 centre, 1 last row", "min": -1.0, "max": 1.0}
    )
    field_col: float = field(
        default=0.0, metadata={"doc": "place along cols: -1 first column, 0 centre, 1 last column", "min": -1.0, "max": 1.0}
    )
    when: float = field(default=0.5, metadata={"doc": "the instant, as a share of the run", "min": 0.0, "max": 1.0})
    closing_km_s: float = field(
        default=0.0, metadata={"doc": "approach speed along the line of sight", "min": -20.0, "max": 20.0}
    )
    across_km_s: float = field(default=5.0, metadata={"doc": "speed across the line of sight", "min": 0.0, "max": 20.0})
    heading_deg: float = field(
        default=0.0, metadata={"doc": "its direction from growing cols to growing rows", "min": -360.0, "max": 360.0}
    )
    light_curve: LightCurveOptions = field(default_factory=LightCurveOptions, metadata={"doc": "variation"})


@dataclass(frozen=True, kw_only=True)
class SkyPathOptions:
    """A point on a great circle of the sky (published directions) at a constant rate."""

    name: str = field(default="sky path", metadata={"doc": "name"})
    v_mag: float = field(default=10.0, metadata={"doc": "V at the epoch", "min": -15.0, "max": 30.0})
    brightening_per_s: float = field(
        default=0.0, metadata={"doc": "relative change of flux per second (exponential)", "min": -1e3, "max": 1e3}
    )
    ra_deg: float = field(default=0.0, metadata={"doc": "right ascension at the epoch", "min": -360.0, "max": 360.0})
    dec_deg: float = field(default=0.0, metadata={"doc": "declination at the epoch", "min": -90.0, "max": 90.0})
    east_arcsec_s: float = field(default=100.0, metadata={"doc": "rate towards the east", "min": -3.6e6, "max": 3.6e6})
    north_arcsec_s: float = field(default=0.0, metadata={"doc": "rate towards the north", "min": -3.6e6, "max": 3.6e6})
    range_km: float = field(default=1000.0, metadata={"doc": "distance, for defocus", "min": 1e-3, "max": 1e9})
    light_curve: LightCurveOptions = field(default_factory=LightCurveOptions, metadata={"doc": "variation"})


@dataclass(frozen=True, kw_only=True)
class PixelPathOptions:
    """A point on the detector, in delivered pixels; straight, or bent by a constant acceleration."""

    name: str = field(default="pixel path", metadata={"doc": "name"})
    v_mag: float = field(default=9.0, metadata={"doc": "V at the start", "min": -15.0, "max": 30.0})
    brightening_per_s: float = field(
        default=0.0, metadata={"doc": "relative change of flux per second (exponential)", "min": -1e3, "max": 1e3}
    )
    row_px: float = field(default=0.0, metadata={"doc": "row at the start", "min": -1e6, "max": 1e6})
    col_px: float = field(default=0.0, metadata={"doc": "column at the start", "min": -1e6, "max": 1e6})
    row_rate_px_s: float = field(default=0.0, metadata={"doc": "motion along rows", "min": -1e7, "max": 1e7})
    col_rate_px_s: float = field(default=0.0, metadata={"doc": "motion along columns", "min": -1e7, "max": 1e7})
    row_bend_px: float = field(
        default=0.0, metadata={"doc": "displacement along rows by acceleration in the first second", "min": -1e8, "max": 1e8}
    )
    col_bend_px: float = field(
        default=0.0, metadata={"doc": "displacement along columns by acceleration in the first second", "min": -1e8, "max": 1e8}
    )
    restart: bool = field(default=True, metadata={"doc": "start anew when each frame's first row opens"})
    from_middle_row: bool = field(
        default=False, metadata={"doc": "times count from the opening of the frame's middle row instead of its first one"}
    )
    light_curve: LightCurveOptions = field(default_factory=LightCurveOptions, metadata={"doc": "variation"})


@dataclass(frozen=True, kw_only=True)
class ObjectOptions:
    """Objects beside the sampled population. The defaults are two far, slow ones, nearly star-like in one exposure."""

    orbit: tuple[OrbitOptions, ...] = field(default=(), metadata={"doc": "orbits by their osculating elements at the epoch"})
    passing: tuple[PassingOptions, ...] = field(
        default=(
            PassingOptions(name="far-1", size_m=2.5, range_km=24000.0, field_row=-0.45, field_col=0.35),
            PassingOptions(
                name="far-2",
                size_m=4.0,
                range_km=33000.0,
                field_row=0.3,
                field_col=0.6,
                semi_major_axis_km=38000.0,
                eccentricity=0.2,
                inclination_deg=42.0,
                outbound=False,
            ),
        ),
        metadata={"doc": "orbits that pass through the field"},
    )  # fmt: skip - one line for each object
    encounter: tuple[EncounterOptions, ...] = field(default=(), metadata={"doc": "objects given by their relative motion"})
    sky_path: tuple[SkyPathOptions, ...] = field(default=(), metadata={"doc": "paths on the sky"})
    pixel_path: tuple[PixelPathOptions, ...] = field(default=(), metadata={"doc": "paths on the detector"})
    satellites: SatelliteOptions = field(default_factory=SatelliteOptions, metadata={"doc": "catalogued satellites"})
    walker: tuple[WalkerOptions, ...] = field(default=(), metadata={"doc": "constellations"})
    breakup: tuple[BreakupOptions, ...] = field(default=(), metadata={"doc": "break-ups of satellites or orbits"})


def own_epoch_tai_ns(options: OrbitOptions, run_tai_ns: int) -> int:
    """Epoch of an orbit's elements; that of the run where it has none of its own.

    UserError when the orbit enters the Earth, and for an epoch that is none or too far from the run.
    """
    perigee_km = options.semi_major_axis_km * (1.0 - options.eccentricity) - EARTH_RADIUS_KM
    if perigee_km < 0.0:
        raise UserError(
            f"objects.orbit {options.name!r}: perigee height {perigee_km:.0f} km lies inside the Earth; allowed is above 0 km"
        )
    if not options.epoch_utc:
        return run_tai_ns
    epoch_ns = tai_ns_of_utc(options.epoch_utc)
    since_s = (epoch_ns - run_tai_ns) * 1e-9
    if abs(since_s) > LONGEST_DAYS * DAY_S:
        raise UserError(
            f"objects.orbit {options.name!r}: epoch_utc: {abs(since_s) / DAY_S:.0f} days from the run; "
            f"allowed are up to {LONGEST_DAYS:.0f}"
        )
    return epoch_ns


def orbiting(options: OrbitOptions, run_tai_ns: int) -> OrbitingObject:
    """An object on the orbit of its options. run_tai_ns : epoch of the run. UserError as `own_epoch_tai_ns`."""
    epoch_ns = own_epoch_tai_ns(options, run_tai_ns)
    elements, since_s = elements_in(options), (epoch_ns - run_tai_ns) * 1e-9
    made = kepler_object(
        options.name, "orbit", options.size_m, options.albedo, elements, since_s, curve=options.light_curve.curve()
    )
    if options.forces == "oblate":
        return made
    position_km = all_forces.motion(np.concatenate(state_of(elements)), epoch_ns, options.area_to_mass_m2_kg)
    return replace(made, positions_km=lambda time_s: position_km(np.asarray(time_s) - since_s))


def passing(options: PassingOptions, observer_km: Array, direction: Array, time_s: float) -> OrbitingObject:
    """An object that is in a given (published) direction at a time after the epoch.

    UserError, by name, when the point lies inside the Earth or no such orbit passes through it.
    """
    elements = passing_elements(options, observer_km, direction)
    return kepler_object(
        options.name, "orbit", options.size_m, options.albedo, elements, time_s, curve=options.light_curve.curve()
    )


def lasting(options: PassingOptions, elements: Elements, epoch_utc: str) -> OrbitOptions:
    """The same object as an orbit under all forces, to be met again in other runs."""
    return OrbitOptions(
        name=options.name,
        size_m=options.size_m,
        albedo=options.albedo,
        semi_major_axis_km=float(elements.a_km),
        eccentricity=float(elements.e),
        inclination_deg=float(np.degrees(elements.i_rad)),
        node_deg=float(np.degrees(elements.node_rad)) % 360.0,
        perigee_deg=float(np.degrees(elements.argp_rad)) % 360.0,
        mean_anomaly_deg=float(np.degrees(elements.mean_anomaly_rad)) % 360.0,
        epoch_utc=epoch_utc,
        forces="all",
        light_curve=options.light_curve,
    )


def passing_elements(options: PassingOptions, observer_km: Array, direction: Array) -> Elements:
    """Elements, at the time of passing, of the orbit through a point of the field. UserError as for `passing`."""
    position = observer_km + options.range_km * direction
    radius = float(np.linalg.norm(position))
    if radius < EARTH_RADIUS_KM:
        raise UserError(
            f"objects.passing {options.name!r}: at {options.range_km:g} km it would be inside the Earth; allowed are other ranges"
        )
    velocity = velocity_through(
        position[None],
        np.array([options.semi_major_axis_km]),
        np.array([options.eccentricity]),
        np.radians([options.inclination_deg]),
        np.array([options.ascending]),
        np.array([options.outbound]),
    )
    if not np.isfinite(velocity).all():
        low = options.semi_major_axis_km * (1 - options.eccentricity)
        high = options.semi_major_axis_km * (1 + options.eccentricity)
        latitude = float(np.degrees(np.arcsin(position[2] / radius)))
        raise UserError(
            f"objects.passing {options.name!r}: no such orbit passes radius {radius:.0f} km, latitude {latitude:.1f} deg; "
            f"allowed are radii of {low:.0f} to {high:.0f} km and latitudes up to the inclination"
        )
    elements = elements_of(position, velocity)
    return Elements(**{name: getattr(elements, name)[0] for name in elements.__dataclass_fields__})


def encounter(
    options: EncounterOptions, observer_km: Array, observer_km_s: Array, attitude: Array, camera: Array, time_s: float
) -> OrbitingObject:
    """An object that is in a given direction of the camera frame at a time after the epoch, with a given relative motion.

    UserError, by name, when it would be inside the Earth or on no closed orbit.
    """
    position = observer_km + options.range_km * (attitude.T @ camera)
    turn = np.radians(options.heading_deg)
    heading = np.array([np.cos(turn), np.sin(turn), 0.0])
    heading -= (heading @ camera) * camera
    relative = options.across_km_s * heading / np.linalg.norm(heading) - options.closing_km_s * camera
    elements = elements_of(position, observer_km_s + attitude.T @ relative)
    if np.linalg.norm(position) < EARTH_RADIUS_KM:
        raise UserError(f"objects.encounter {options.name!r}: at {options.range_km:g} km it would be inside the Earth")
    if not 0.0 < float(elements.a_km) < 1e7:
        speed = float(np.linalg.norm(observer_km_s + attitude.T @ relative))
        raise UserError(f"objects.encounter {options.name!r}: {speed:.1f} km/s is beyond escape speed; allowed are closed orbits")
    return kepler_object(
        options.name, "orbit", options.size_m, options.albedo, elements, time_s, curve=options.light_curve.curve()
    )


def kepler_object(
    name: str,
    kind: str,
    size_m: float,
    albedo: float,
    elements: Elements,
    epoch_s: float,
    *,
    weight: float = 1.0,
    curve: LightCurve = STEADY,
    specular: float = 0.0,
    colour: float = 1.0,
) -> OrbitingObject:
    """An object whose elements hold `epoch_s` seconds after the epoch of the run."""
    at_epoch = orbit_positions(elements)
    return OrbitingObject(
        identity=Identity(
            name=name,
            kind=kind,
            size_m=size_m,
            albedo=albedo,
            weight=weight,
            a_km=float(elements.a_km),
            e=float(elements.e),
            i_deg=float(np.degrees(elements.i_rad)),
        ),
        positions_km=lambda time_s: at_epoch(time_s - epoch_s),
        light_curve=curve,
        specular=specular,
        colour=colour,
    )


def sky_path(options: SkyPathOptions) -> SkyPathObject:
    """An object on a path of the sky."""
    start = unit_vectors(np.array(options.ra_deg), np.array(options.dec_deg))
    ra = np.radians(options.ra_deg)
    east = np.array([-np.sin(ra), np.cos(ra), 0.0])
    north = np.cross(start, east)
    return SkyPathObject(
        identity=Identity(name=options.name, kind="sky_path"),
        start=start,
        rate_rad_s=(options.east_arcsec_s * east + options.north_arcsec_s * north) * ARCSEC_RAD,
        range_km=options.range_km,
        v_mag=options.v_mag,
        brightening_per_s=options.brightening_per_s,
        light_curve=options.light_curve.curve(),
    )


def pixel_path(options: PixelPathOptions) -> PixelPathObject:
    """An object on a path of the detector."""
    return PixelPathObject(
        identity=Identity(name=options.name, kind="pixel_path"),
        row_px=options.row_px,
        col_px=options.col_px,
        row_rate_px_s=options.row_rate_px_s,
        col_rate_px_s=options.col_rate_px_s,
        row_bend_px=options.row_bend_px,
        col_bend_px=options.col_bend_px,
        v_mag=options.v_mag,
        brightening_per_s=options.brightening_per_s,
        restart=options.restart,
        from_middle_row=options.from_middle_row,
        light_curve=options.light_curve.curve(),
    )


def population_objects(drawn: Drawn, options: PopulationOptions, middle_s: float, seed: int) -> list[OrbitingObject]:
    """The sampled debris; some of it tumbles."""
    objects = []
    surfaces = drawn.surfaces
    curves = light_curves(generator(seed, Effect.LIGHT_CURVE), len(drawn.size_m), options)
    for k, curve in enumerate(curves):
        one = Elements(**{name: getattr(drawn.elements, name)[k] for name in drawn.elements.__dataclass_fields__})
        objects.append(
            kepler_object(
                f"debris-{k:03d}",
                "population",
                float(drawn.size_m[k]),
                float(surfaces.albedo[k]),
                one,
                middle_s + float(drawn.time_s[k]),
                weight=float(drawn.weight[k]),
                curve=curve,
                specular=float(surfaces.specular[k]),
                colour=float(surfaces.colour[k]),
            )  # fmt: skip - one line for what it is, one for the rest
        )
    return objects


def light_curves(rng: np.random.Generator, n: int, options: PopulationOptions) -> list[LightCurve]:
    """Light curves of n pieces. A share tumbles: log-normal periods around 2 s, random phases and amplitudes, facets, flashes."""
    surface = options.surface
    draws = [
        (rng.random(), rng.lognormal(np.log(2.0), 1.0), rng.uniform(0.1, 0.7), rng.uniform(0.0, 2 * np.pi)) for _ in range(n)
    ]
    faces, flashes = rng.random((n, 3)), rng.random((n, 2))
    peaks = surface.glint_factor * np.exp(0.7 * rng.standard_normal(n))
    curves = []
    for k, (tumbles, period, amplitude, phase) in enumerate(draws):
        if tumbles >= options.tumbling_share:
            curves.append(STEADY)
            continue
        faceted, flashing = faces[k, 0] < surface.facet_share, flashes[k, 0] < surface.glint_share
        curves.append(
            LightCurve(
                period_s=period,
                amplitude=amplitude,
                phase_rad=phase,
                facets=0.5 + 0.5 * faces[k, 1] if faceted else 0.0,
                facet_phase_rad=2.0 * np.pi * faces[k, 2] if faceted else 0.0,
                glint_factor=float(peaks[k]) if flashing else 0.0,
                glint_width_s=period * surface.glint_turn_deg / 360.0,
            )
        )
    return curves
