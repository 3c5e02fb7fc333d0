"""Options of the ground segment that belong to no swappable step."""

from dataclasses import dataclass, field


@dataclass(frozen=True, kw_only=True)
class PhotometryOptions:
    """Light of streaks."""

    star_model_error: float = field(
        default=0.05,
        metadata={"doc": "relative error of the PSF with which stars are taken out of streak pixels", "min": 0.0, "max": 1.0},
    )


@dataclass(frozen=True, kw_only=True)
class ProductOptions:
    """Names in messages, and optional output besides the tables."""

    originator: str = field(default="SBOC", metadata={"doc": "ORIGINATOR of CCSDS messages"})
    observer_name: str = field(default="SBOC-1", metadata={"doc": "name of the observing spacecraft"})
    observer_id: str = field(default="2027-000A", metadata={"doc": "international designator of the spacecraft"})
    images: str = field(
        default="frames",
        metadata={
            "doc": "pixels written as FITS with a WCS: frames that came down whole, or thumbnails and regions of all frames too",
            "choices": ("none", "frames", "all"),
        },
    )
    tracklet_plots: bool = field(
        default=False, metadata={"doc": "whether a picture of each tracklet is drawn (path, residuals, light curve)"}
    )


@dataclass(frozen=True, kw_only=True)
class GroundOptions:
    """Options of the ground chain."""

    veto_below: float = field(
        default=0.1, metadata={"doc": "streaks less probable than this are not linked", "min": 0.0, "max": 1.0}
    )
    veto_unlinked_below: float = field(
        default=0.5,
        metadata={"doc": "streaks that no other frame supports need at least this probability", "min": 0.0, "max": 1.0},
    )
    orbits: bool = field(default=True, metadata={"doc": "whether coarse orbits are determined"})
    joint_refit: bool = field(default=True, metadata={"doc": "whether all frames of a tracklet are fitted together"})
    catalogue_file: str = field(
        default="",
        metadata={
            "doc": "star catalogue made by `sboc catalogue build`; empty for that of the simulated sky (`stars.catalogue_file`)"
        },
    )
    known_objects_file: str = field(
        default="", metadata={"doc": "element sets (TLE, 3LE) that tracklets are matched against; empty for none"}
    )
    precise_orbits_file: str = field(
        default="", metadata={"doc": "ephemeris message (OEM) of objects for clock and pointing biases; empty for none"}
    )
    streak_photometry: PhotometryOptions = field(default_factory=PhotometryOptions, metadata={"doc": "light of streaks"})
    products: ProductOptions = field(default_factory=ProductOptions, metadata={"doc": "names in messages, pictures"})
