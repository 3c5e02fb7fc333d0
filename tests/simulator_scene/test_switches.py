"""Every effect has a switch: the table of docs/physics.md, all lines off at once, and each one on alone."""

import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.registry import Registry
from sboc_e2e.scenario import document
from simulator.chain import Simulator
from simulator.platform.earth import jyear, tai_ns_of_utc
from simulator.scene.stars import unit_vectors

PHYSICS = Path(__file__).parents[2] / "docs" / "physics.md"
ROWS = [
    (m[1].strip(), tuple(s.strip() for s in m[2].split(";")), m[3])
    for m in re.finditer(r"^\| ([^|`]+) \| `([^`]+)` \| (orbit|site) \|$", PHYSICS.read_text(), re.MULTILINE)
]
EPOCH = "2027-01-29T00:00:00"
ENCOUNTERS = [
    # near and far ones
    'objects.encounter=[{name="near",size="30 cm",range="3 km",across="0.4 km/s",heading="60 deg",field_row=0.3},'
    '{name="far",size="20 m",range="1500 km",across="5 km/s",field_row=-0.4,heading="90 deg"}]',
    # behind the Earth, as seen from the Sun
    'objects.passing=[{name="shaded",size="30 m",range="24000 km",field_row=-0.4,field_col=0.4},'
    '{name="shaded too",size="30 m",range="24000 km",field_row=0.4,field_col=-0.6}]',
]
WORLD = {
    # Every effect is on, those of which the defaults have none with a value of their own.
    "orbit": [
        "frames=2", f'epoch_utc="{EPOCH}"', "instrument.rows=160", "instrument.cols=160", 'instrument.pixel="230 um"',
        'instrument.aperture="10 cm"', "sensor.prnu=0.05", 'sensor.dark.median="500 e-/s"', "sensor.telegraph.fraction=0.02",
        "sensor.dark.warm_fraction=0.01", "sensor.dark.hot_fraction=0.01", "sensor.dark.dead_fraction=0.01",
        'sensor.readout.row_noise="3 e-"', 'sensor.readout.column_offset="4 e-"',
        "sensor.readout.correlated_double_sampling=false", "population.tumbling_share=1.0",
        'sensor.readout.sense_node="5 fF"', 'sensor.type="ccd"', 'sensor.ccd.row_transfer="20 us"',
        "sensor.binning.rows=2", "sensor.binning.cols=2",
        "sensor.window.rows=120", 'instrument.stray_light="30 e-/(px s)"', 'clock.offset="5 us"', 'shutter.line_time="400 us"',
        'radiation.environment="saa"', "sensor.converter.nonlinearity=0.05", 'telemetry.velocity="1 m/s"',
        "instrument.distortion.sip_a=[{col_power=2,row_power=0,coefficient=1e-4}]", "population.candidates=1000",
        'population.classes=[{from="100 mm",to="3000 mm",count=2}]', "population.snr_min=0.5",
        'instrument.as_built.focal_drift="1000 ppm/s"', 'psf.wavefront.rms="300 nm"', "psf.aureole.share=0.02",
        "psf.spider.vanes=4", "psf.ghost.share=1e-3",
        "stars.companion_share=0.5", "stars.variable_share=0.5", 'sensor.structure.row_flicker="3 e-"',
        'sensor.structure.column_noise="3 e-"', 'sensor.structure.black_drift="20 e-"', "sensor.converter.gain_error=0.02",
        "sensor.converter.low_gain_error=0.02", "sensor.ccd.transfer_loss=1e-3", "sensor.dark.hot_growth_per_year=0.01",
        "sensor.calibration.age_years=3", "sky.moon=true", "sky.planets=true", "instrument.scatter.strength=0.1",
        "sensor.structure.lag=0.1", "sky.clusters=true", "sky.structure=1.0", "sky.galaxies.density=20",
        "sky.asteroids.density=30", 'sky.asteroids.faint_limit="13 mag"',
        "sensor.calibration.flat_error=0.02", "sensor.calibration.flat_change_per_year=0.01",
        "sensor.converter.nonlinearity_error=1.0", *ENCOUNTERS,
    ],
    "site": [
        "frames=1", f'epoch_utc="{EPOCH}"', "instrument.rows=160", "instrument.cols=160", 'instrument.pixel="20 um"',
        'instrument.aperture="20 cm"', 'platform.kind="site"', 'pointing.law="sidereal"', 'pointing.ra="131 deg"',
        'pointing.dec="18 deg"', "population.classes=[]", "objects.passing=[]", "atmosphere.cloud_transmission=0.6",
        "atmosphere.cloud_variation=0.2",
        "sensor.structure.coupling=0.02", "sensor.structure.blooming=0.8", "sensor.structure.brighter_fatter=0.1",
        'atmosphere.seeing="20 arcsec"', 'radiation.environment="ground"',
        'objects.pixel_path=[{v="5 mag",row="20 px",col="20 px",row_rate="400 px/s",col_rate="500 px/s"}]',
    ],
}  # fmt: skip


NEEDS = {
    "image motion along a trail": ("seeing",),
    "tumbling of sampled debris": ("sampled debris",),
    "albedo that differs from piece to piece": ("sampled debris",),
    "mirror-like light of debris": ("sampled debris",),
    "colour of debris": ("sampled debris",),
    "facets and flashes of tumbling debris": ("sampled debris", "tumbling of sampled debris"),
    "structure of the unresolved background": ("unresolved background",),
    "frame-transfer smear": ("bleeding",),
    "charge left behind in transfers (CTI)": ("bleeding",),
    "pixels that became hot in flight": ("dark current",),
    "what the linearity curve misses": ("non-linearity",),
    "veil of bodies outside the field": ("the Moon",),
}
"""Effects that show only where others are on."""
WHEN = {
    "the Moon": ('epoch_utc="2027-01-22T12:00:00"',),  # 1.4 deg from the anti-Sun point
    "planets": ('epoch_utc="2027-02-10T23:00:00"',),  # Jupiter stands against the Sun
    "the Earth in the field": ('pointing.law="nadir"', 'pointing.tilt="62 deg"'),
    "globular clusters": ('pointing.law="inertial"', 'pointing.ra="250.42 deg"', 'pointing.dec="36.46 deg"'),
    "veil of bodies outside the field": ('epoch_utc="2027-01-22T12:00:00"',),
}
"""When and where an effect is to be seen."""
AFTER = ("image lag",)
"""Effects that show from the second frame on."""
IN_FLATS = ("unevenness of the flat's lamp", "responses that changed since the flats")
"""Effects of the calibration alone."""


@cache
def made(where, *on, when=()):
    """The world of a place with all effects of the table off but some."""
    off = [re.sub(" = ", "=", s, count=1) for name, settings, _ in ROWS if name not in on for s in settings]
    if where == "site":
        off = [s for s in off if not s.startswith("population.")]
    scenario = document.bare("switches", {"seed": 7}, registry=Registry(), overrides=[*WORLD[where], *off, *when])
    return Simulator(scenario.simulator, seed=7, catalogue=StarCatalogue.embedded())


@cache
def frame(where, *on, when=(), index=0):
    return made(where, *on, when=when).frame(index)


def test_the_table_is_read():
    assert len(ROWS) > 45
    assert len({name for name, _, _ in ROWS}) == len(ROWS)


@pytest.mark.parametrize(("name", "where"), [(name, where) for name, _, where in ROWS])
@pytest.mark.slow
def test_an_effect_turned_on_alone_changes_the_frame(name, where):
    beside = NEEDS.get(name, ())
    when = WHEN.get(name, ())
    if name in IN_FLATS:
        flats = [made(where, *on).calibration().flat for on in (beside, (name, *beside))]
        assert not np.array_equal(*flats)
        return
    index = int(name in AFTER)
    plain, _ = frame(where, *beside, when=when, index=index)
    changed, _ = frame(where, name, *beside, when=when, index=index)
    same = plain.pixels.shape == changed.pixels.shape and np.array_equal(plain.pixels, changed.pixels)
    assert not same or repr(plain.header) != repr(changed.header)
    if "telemetered" in name or "time tags" in name:
        assert same
        assert repr(plain.header) != repr(changed.header)


@pytest.mark.parametrize("where", ["orbit", "site"])
def test_all_off_is_a_noise_free_gnomonic_picture_of_the_catalogue(where):
    """Stars at the plain projection of their catalogue places (1e-6 px), units that are the rounded mean, dark elsewhere."""
    shot, truth = frame(where)
    simulator = made(where)
    camera, attitude = simulator.camera(), shot.header.attitude
    x, y, z, w = attitude.quaternion
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    stars = truth.stars[truth.stars["star_id"] > 0]
    assert len(stars) >= 5
    found = StarCatalogue.embedded().cone(131.0, 18.0, 8.0, epoch_jyear=jyear(tai_ns_of_utc(EPOCH)))
    place = {int(k): n for n, k in enumerate(found.source_id)}
    index = [place[int(s)] for s in stars["star_id"]]
    seen = unit_vectors(found.ra_deg[index], found.dec_deg[index]) @ turn.T
    col = camera.center_col + camera.focal_px * seen[:, 0] / seen[:, 2]
    row = camera.center_row + camera.focal_px * seen[:, 1] / seen[:, 2]
    assert np.abs(row - stars["row"]).max() < 1e-6
    assert np.abs(col - stars["col"]).max() < 1e-6
    mean_e = simulator.mean_electrons(0).astype(np.float64)
    expected = np.minimum(np.floor(np.minimum(mean_e, 39000.0) / 1.2 + 100.5), 4095.0)
    assert np.abs(shot.pixels.astype(float) - expected).max() <= 1.0
    assert (shot.pixels == expected).mean() > 0.999
    assert mean_e.min() < 0.02  # glow of 30 mag/arcsec2, the faintest there is
