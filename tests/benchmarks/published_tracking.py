"""The published orbit of W3B by our own filter, with Orekit's forces and measurement models as the model that it fits.

Our own forces and air delays differ from those of Orekit's test, so that a fit with them says little of the filter. Here Orekit
computes what is observed, and its partial derivatives; the estimation is that of `ground.determination.least_squares`. The
solution is held against the values and tolerances that Orekit's `NumericalOrbitDeterminationTest.testW3B` states. Data and set-up
are in Orekit's source (Apache licence 2.0). Run from the repository's root, with `pip install "sboc-e2e[orekit]"` and Java:

    python -m tests.benchmarks.published_tracking OREKIT/src/test/resources
"""

import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ground.determination.least_squares import Adjustment, adjusted
from tests.determination.test_tracking import (
    BIASES,
    LEAK,
    LEAK_RATE,
    POSITION_M,
    SPREAD,
    VELOCITY_M_S,
    stations,
    tracking,
)

Array = NDArray[np.float64]

ANGLE_DEG, DISTANCE_M, SPEED_M_S = 1e-5, 0.1, 1e-4
"""Tolerances of the published test."""
DRAG = -0.2154
VARIANCES = {"drag coefficient": (0.687998, 1e-4), "leak-X[0]": (2.0540e-12, 1e-16), "leak-Y[0]": (2.4930e-11, 1e-15),
             "leak-Z[0]": (7.6720e-11, 1e-15)}  # fmt: skip
EXTREMES = {"range_m": (-18.39149369, 12.54165259), "azimuth_deg": (-0.043033616, 0.025297558),
            "elevation_deg": (-0.025061971, 0.056294405)}  # fmt: skip
START_M = (-40517522.9, -10003079.9, 166792.8)
START_M_S = (762.559, -1474.468, 55.430)
MASS_KG, AREA_M2, COEFFICIENT = 1000.0, 13.12, 2.0
"""The set-up has no mass: Orekit's default."""
TRANSPONDER_M = 5969.0
DEGREE = 20
ANGLE_START_DEG, SIGMA_DEG, SIGMA_M = 0.01, 0.02, 20.0


class OrekitModel:
    """Whitened residuals of W3B's tracking and their partials, as Orekit's batch estimator computes them."""

    def __init__(self, resources: Path) -> None:
        import orekit_jpype

        orekit_jpype.initVM()
        from java.io import File
        from java.util import ArrayList
        from org.hipparchus.linear import ArrayRealVector
        from org.hipparchus.util import Incrementor
        from org.orekit.data import DataContext, DirectoryCrawler
        from org.orekit.estimation.leastsquares import BatchLSModel, ModelObserver

        manager = DataContext.getDefault().getDataProvidersManager()
        self.root = resources / "orbit-determination" / "W3B"
        for folder in (self.root, resources / "potential" / "icgem-format"):
            manager.addProvider(DirectoryCrawler(File(str(folder))))
        builder, self.body = self._builder()
        measurements = ArrayList()
        for one in self._measurements():
            measurements.add(one)
        for drivers in (
            builder.getPropagationParametersDrivers().getDrivers(),
            *(m.getParametersDrivers() for m in measurements),
        ):
            for driver in drivers:
                driver.setReferenceDate(builder.getInitialOrbitDate())
        drivers = self._drivers_of(measurements)

        import jpype

        @jpype.JImplements(ModelObserver)  # type: ignore[misc]
        class Silent:
            @jpype.JOverride  # type: ignore[misc]
            def modelCalled(self, orbits: Any, evaluations: Any) -> None:
                pass

        self.vector, self.doubles = ArrayRealVector, jpype.JArray(jpype.JDouble)
        self.model = BatchLSModel([builder], measurements, drivers, Silent())
        for count in (self.model.setIterationsCounter, self.model.setEvaluationsCounter):
            count(Incrementor())
        self.kinds: list[str] = []
        for one in measurements:
            self.kinds += ["range_m"] if one.getDimension() == 1 else ["azimuth_deg", "elevation_deg"]
        selected = [
            *(d for d in builder.getOrbitalParametersDrivers().getDrivers()),
            *(d for d in self.model.getSelectedPropagationDriversForBuilder(0).getDrivers()),
            *(d for d in drivers.getDrivers()),
        ]
        self.names = [str(d.getName()) for d in selected]
        self.scale = np.array([float(d.getScale()) for d in selected])
        self.reference = np.array([float(d.getReferenceValue()) for d in selected])
        self.start = np.array([float(d.getNormalizedValue()) for d in selected])

    def _builder(self) -> tuple[Any, Any]:
        """The propagator with all forces of the set-up, and the Earth's ellipsoid."""
        from org.hipparchus.geometry.euclidean.threed import Vector3D
        from org.orekit.bodies import CelestialBodyFactory, OneAxisEllipsoid
        from org.orekit.forces.drag import DragForce, IsotropicDrag
        from org.orekit.forces.empirical import ParametricAcceleration, PolynomialAccelerationModel
        from org.orekit.forces.gravity import HolmesFeatherstoneAttractionModel, ThirdBodyAttraction
        from org.orekit.forces.gravity.potential import GravityFieldFactory, ICGEMFormatReader
        from org.orekit.forces.radiation import IsotropicRadiationSingleCoefficient, SolarRadiationPressure
        from org.orekit.frames import FramesFactory
        from org.orekit.models.earth.atmosphere import DTM2000
        from org.orekit.models.earth.atmosphere.data import MarshallSolarActivityFutureEstimation as Activity
        from org.orekit.orbits import CartesianOrbit, PositionAngleType
        from org.orekit.propagation.conversion import DormandPrince853IntegratorBuilder, NumericalPropagatorBuilder
        from org.orekit.time import AbsoluteDate, TimeScalesFactory
        from org.orekit.utils import IERSConventions, PVCoordinates

        GravityFieldFactory.addPotentialCoefficientsReader(ICGEMFormatReader("eigen-6s-truncated", True))
        field = GravityFieldFactory.getNormalizedProvider(DEGREE, DEGREE)
        earth = OneAxisEllipsoid(6378137.0, 1.0 / 298.257223563, FramesFactory.getITRF(IERSConventions.IERS_2010, True))
        when = AbsoluteDate("2010-11-02T02:56:15.690", TimeScalesFactory.getUTC())
        orbit = CartesianOrbit(
            PVCoordinates(Vector3D(*START_M), Vector3D(*START_M_S)), FramesFactory.getEME2000(), when, field.getMu()
        )
        builder = NumericalPropagatorBuilder(
            orbit, DormandPrince853IntegratorBuilder(0.001, 300.0, 10.0), PositionAngleType.MEAN, 10.0
        )
        builder.setMass(MASS_KG)
        sun, moon = CelestialBodyFactory.getSun(), CelestialBodyFactory.getMoon()
        air = DTM2000(Activity(Activity.DEFAULT_SUPPORTED_NAMES, Activity.StrengthLevel.AVERAGE), sun, earth)
        drag = DragForce(air, IsotropicDrag(AREA_M2, COEFFICIENT))
        light = SolarRadiationPressure(sun, earth, IsotropicRadiationSingleCoefficient(AREA_M2, COEFFICIENT))
        leaks = [
            ParametricAcceleration(axis, True, PolynomialAccelerationModel(f"leak-{name}", None, 1))
            for name, axis in (("X", Vector3D.PLUS_I), ("Y", Vector3D.PLUS_J), ("Z", Vector3D.PLUS_K))
        ]
        gravity = HolmesFeatherstoneAttractionModel(earth.getBodyFrame(), field)
        for force in (gravity, ThirdBodyAttraction(sun), ThirdBodyAttraction(moon), drag, light, *leaks):
            builder.addForceModel(force)
        for driver in (d for force in (drag, *leaks) for d in force.getParametersDrivers()):
            driver.setSelected(str(driver.getName()) == "drag coefficient" or str(driver.getName()).startswith("leak"))
        return builder, earth

    def _measurements(self) -> list[Any]:
        """Azimuths with elevations, and two-way ranges, with their delays and offsets."""
        from org.orekit.bodies import GeodeticPoint
        from org.orekit.estimation.measurements import AngularAzEl, GroundStation, ObservableSatellite, Range
        from org.orekit.estimation.measurements.modifiers import (
            AngularRadioRefractionModifier,
            Bias,
            RangeTroposphericDelayModifier,
        )
        from org.orekit.frames import FramesFactory, TopocentricFrame
        from org.orekit.models.earth import ITURP834AtmosphericRefraction
        from org.orekit.models.earth.troposphere import ModifiedSaastamoinenModel, TroposphericModelUtils
        from org.orekit.time import AbsoluteDate, TimeScalesFactory

        utc, history = TimeScalesFactory.getUTC(), FramesFactory.findEOP(self.body.getBodyFrame())
        seen, satellite = tracking(self.root / "W3B.aer"), ObservableSatellite(0)
        transponder = Bias(["transponder delay bias"], [TRANSPONDER_M], [1.0], [-5e4], [5e4])
        air = RangeTroposphericDelayModifier(ModifiedSaastamoinenModel(TroposphericModelUtils.STANDARD_ATMOSPHERE_PROVIDER))
        start, sigma, limit = (np.radians([x, x]).tolist() for x in (ANGLE_START_DEG, SIGMA_DEG, 0.5))
        out = []
        for name, (place, range_start_km) in stations((self.root / "od_test_W3.in").read_text()).items():
            point = GeodeticPoint(place.latitude_rad, place.longitude_rad, 1e3 * place.height_km)
            station = GroundStation(TopocentricFrame(self.body, point, name), history)
            refraction = AngularRadioRefractionModifier(ITURP834AtmosphericRefraction(1e3 * place.height_km))
            angles = Bias([f"{name}/az bias", f"{name}/el bias"], start, sigma, [-x for x in limit], limit)
            distance = Bias([f"{name}/range bias"], [1e3 * range_start_km], [SIGMA_M], [-5e4], [5e4])
            for driver in (*angles.getParametersDrivers(), *distance.getParametersDrivers()):
                driver.setSelected(True)
            for words in seen[name].get("AZ_EL", []):
                pair = np.radians([float(words[3]), float(words[4])]).tolist()
                one = AngularAzEl(station, AbsoluteDate(words[0], utc), pair, sigma, [1.0, 1.0], satellite)
                one.addModifier(refraction)
                one.addModifier(angles)
                out.append(one)
            for words in seen[name].get("RANGE", []):
                one = Range(station, True, AbsoluteDate(words[0], utc), 1e3 * float(words[3]), SIGMA_M, 1.0, satellite)
                for modifier in (distance, transponder, air):
                    one.addModifier(modifier)
                out.append(one)
        return out

    @staticmethod
    def _drivers_of(measurements: Any) -> Any:
        from org.orekit.utils import ParameterDriversList

        drivers = ParameterDriversList()
        for one in measurements:
            for driver in one.getParametersDrivers():
                if driver.isSelected():
                    drivers.add(driver)
        drivers.sort()
        return drivers

    def linear(self, x: Array) -> tuple[Array, Array]:
        """Residuals (m,), observed minus computed over sigma, and partials (m, k), at normalised unknowns (k,)."""
        pair = self.model.value(self.vector(self.doubles(x.tolist())))
        value, slope = (np.array(part) for part in (pair.getFirst().toArray(), pair.getSecond().getData()))
        return -value, -slope


def rows_of(model: OrekitModel, found: Adjustment) -> list[tuple[str, float, float, float]]:
    """What the published test asserts: name, found, published, tolerance."""
    physical = dict(zip(model.names, model.reference + model.scale * found.unknowns, strict=True))
    variance = dict(zip(model.names, model.scale**2 * np.diag(found.covariance), strict=True))
    state = np.array([physical[name] for name in model.names[:6]])
    rows = [
        ("position away (m)", float(np.linalg.norm(state[:3] - POSITION_M)), 0.0, DISTANCE_M),
        ("velocity away (m/s)", float(np.linalg.norm(state[3:] - VELOCITY_M_S)), 0.0, SPEED_M_S),
        ("drag coefficient", physical["drag coefficient"], DRAG, 1e-3),
    ]
    for k, (expected, tolerance) in enumerate(((LEAK, 1e-8), (LEAK_RATE, 1e-12))):
        size = float(np.linalg.norm([physical[f"leak-{axis}[{k}]"] for axis in "XYZ"]))
        rows.append((f"leak[{k}] (m/s^{2 + k})", size, expected, tolerance))
    for name, (azimuth, elevation, distance) in BIASES.items():
        rows.append((f"{name} azimuth (deg)", float(np.degrees(physical[f"{name}/az bias"])), azimuth, ANGLE_DEG))
        rows.append((f"{name} elevation (deg)", float(np.degrees(physical[f"{name}/el bias"])), elevation, ANGLE_DEG))
        rows.append((f"{name} range (m)", physical[f"{name}/range bias"], distance, DISTANCE_M))
    kinds, scale = np.array(model.kinds), {"range_m": SIGMA_M, "azimuth_deg": SIGMA_DEG, "elevation_deg": SIGMA_DEG}
    for kind, spread in SPREAD.items():
        # Orekit's are computed minus observed
        left = -found.residuals[kinds == kind] * scale[kind]
        tolerance = DISTANCE_M if kind == "range_m" else ANGLE_DEG
        rows.append((f"residuals, {kind}: spread", float(left.std(ddof=1)), spread, tolerance))
        low, high = EXTREMES[kind]
        rows += [(f"residuals, {kind}: least", float(left.min()), low, tolerance),
                 (f"residuals, {kind}: largest", float(left.max()), high, tolerance)]  # fmt: skip
    rows += [(f"variance, {name}", float(variance[name]), *expected) for name, expected in VARIANCES.items()]
    return rows


def main(resources: str) -> bool:
    """Fit, and write each published number with ours; whether all are met."""
    model = OrekitModel(Path(resources))
    found = adjusted(model.linear, model.start, np.full(len(model.start), np.inf), huber_sigma=1e6, reject_sigma=1e7)
    met = []
    for name, value, expected, tolerance in rows_of(model, found):
        met.append(abs(value - expected) <= tolerance)
        words = "met" if met[-1] else "NOT met"
        sys.stdout.write(f"{name:34s} {value:+.9e}  published {expected:+.9e}  tolerance {tolerance:g}  {words}\n")
    sys.stdout.write(f"{sum(met)} of {len(met)} within the published tolerances, {found.iterations} iterations\n")
    return all(met)


if __name__ == "__main__":
    sys.exit(0 if main(*sys.argv[1:]) else 1)
