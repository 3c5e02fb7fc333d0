"""Options of the particle environment and of the response of silicon."""

from dataclasses import dataclass, field


@dataclass(frozen=True, kw_only=True)
class RadiationOptions:
    """Particles through the sensor: rates, shield, and charge in the sensitive layer."""

    enabled: bool = field(default=True, metadata={"doc": "particle hits happen"})
    environment: str = field(
        default="orbit",
        metadata={
            "doc": "orbit: the position decides; quiet, polar, saa, horn (of the electron belt at 700 km): the same everywhere; "
            "ground: muons at sea level",
            "choices": ("orbit", "quiet", "polar", "saa", "horn", "ground"),
        },
    )
    quiet_rate_cm2_s: float = field(
        default=1.2,
        metadata={"doc": "cosmic rays through each cm2 of the sensor per second near the equator", "min": 0.0, "max": 1e6},
    )
    polar_factor: float = field(
        default=3.0, metadata={"doc": "polar over equatorial rate at a modulation of 650 MV", "min": 1.0, "max": 100.0}
    )
    saa_factor: float = field(default=1.0, metadata={"doc": "trapped protons over AP8 MAX", "min": 0.0, "max": 100.0})
    electron_factor: float = field(default=1.0, metadata={"doc": "trapped electrons over AE8 MAX", "min": 0.0, "max": 100.0})
    saa_peak_omni_cm2_s: float = field(
        default=3750.0,
        metadata={"doc": "omnidirectional flux above 50 MeV of environment saa (its peak at 700 km)", "min": 0.0, "max": 1e6},
    )
    saa_drift_deg_yr: float = field(
        default=0.3, metadata={"doc": "westward drift of the belts since the map's epoch, 2015.0", "min": -2.0, "max": 2.0}
    )
    modulation_mv: float = field(
        default=650.0, metadata={"doc": "solar modulation potential in megavolt of cosmic rays", "min": 100.0, "max": 2000.0}
    )
    shield_material: str = field(
        default="aluminium", metadata={"doc": "material of the shield", "choices": ("aluminium", "copper")}
    )
    shield_mm: float = field(
        default=10.0,
        metadata={
            "doc": "thickness of the shield in all directions; assumed, near the 11 mm of aluminium of the spectra that the "
            "detector simulator Pyxel ships",
            "min": 0.0,
            "max": 300.0,
        },
    )
    nuclei: bool = field(default=True, metadata={"doc": "cosmic rays hold nuclei from helium to iron; off: protons only"})
    depletion_um: float = field(
        default=10.0, metadata={"doc": "thickness of the charge-collecting layer", "min": 0.5, "max": 1000.0}
    )
    diffusion_um: float = field(
        default=1.5, metadata={"doc": "rms sideways spread of charge from the far face of the layer", "min": 0.0, "max": 50.0}
    )
    anisotropy: bool = field(
        default=True,
        metadata={"doc": "trapped protons arrive across the field's lines and more of them from the west; off: from everywhere"},
    )
    pitch_width_deg: float = field(
        default=15.0,
        metadata={
            "doc": "rms of the protons' pitch angles about 90 deg (Heckman & Nakano 1969, J. Geophys. Res. 74, 3575)",
            "min": 1.0,
            "max": 90.0,
        },
    )
    scattering: bool = field(
        default=True, metadata={"doc": "electrons scatter and curl in the layer; off: straight until they stop"}
    )
    delta_rays: bool = field(
        default=True, metadata={"doc": "electrons knocked out with more than 30 keV leave tracks of their own"}
    )
    straggling: bool = field(
        default=True, metadata={"doc": "energy loss fluctuates (Landau, with Gaussian width in thin layers)"}
    )
