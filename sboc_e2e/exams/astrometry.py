"""The exam of astrometry: a solved frame whose camera goes there and back, keeps, travels and repeats."""

import dataclasses
from collections.abc import Iterator
from multiprocessing.reduction import ForkingPickler
from typing import Any, Final

import numpy as np

from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.exams.verdict import Verdict, asked, expect
from sboc_e2e.files import checkpoint
from sboc_e2e.icd.downlink import DownlinkFrame
from sboc_e2e.icd.flags import FrameFlag
from sboc_e2e.icd.frame import AttitudeEstimate, Calibration, FrameHeader, NominalCamera, ObserverState
from sboc_e2e.icd.products import FrameSolution
from sboc_e2e.icd.signals import StarList

SHAPE: Final = (256, 320)  # Rows and columns: unequal, so that exchanged axes show.
FOCAL_PX: Final = 5000.0  # Focal length: 41 arcsec/px, a field of 2.9 x 3.7 deg that holds catalogue stars enough to be solved.
ZERO_POINT_E_S: Final = 4.7e8
"""Electrons a second of a star of V 0 (mag 21.68): about that of `sboc_like`. Stars of all colours have it."""
ROUND_TRIP_PX: Final = 1e-3  # Chosen, not measured: far below the errors of measured positions, far above what rounding leaves.


def star_frame(catalogue: StarCatalogue) -> tuple[Calibration, DownlinkFrame]:
    """Catalogue stars through a camera without distortion; aberration, which moves all of them alike, is left out."""
    camera = NominalCamera(
        name="exam", rows=SHAPE[0], cols=SHAPE[1], focal_px=FOCAL_PX, center_row=0.5 * (SHAPE[0] - 1),
        center_col=0.5 * (SHAPE[1] - 1), psf_sigma_px=0.85, gain_e_adu=1.0, read_noise_e=2.3, saturation_adu=65535.0,
        full_well_e=39e3, zero_point_e_s=ZERO_POINT_E_S, aperture_m=0.2,
    )  # fmt: skip
    calibration = Calibration(
        camera=camera, dark_adu=np.zeros(SHAPE, np.float32), flat=np.ones(SHAPE, np.float32), defects=np.zeros(SHAPE, np.uint8)
    )
    stars = catalogue.cone(270.0, 0.0, 4.0, epoch_jyear=2027.0)
    # camera axes: boresight at right ascension 270 deg on the equator, columns to the east, rows to the north
    axes = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    ra, dec = np.radians(stars.ra_deg), np.radians(stars.dec_deg)
    seen = np.stack((np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)), axis=-1) @ axes.T
    row, col = camera.center_row + FOCAL_PX * seen[:, 1] / seen[:, 2], camera.center_col + FOCAL_PX * seen[:, 0] / seen[:, 2]
    inside = np.flatnonzero((row > 1.0) & (row < SHAPE[0] - 2.0) & (col > 1.0) & (col < SHAPE[1] - 2.0))
    inside = inside[np.argsort(stars.v_mag[inside], kind="stable")]
    flux = ZERO_POINT_E_S * 0.2 * 10.0 ** (-0.4 * stars.v_mag[inside].astype(np.float64))
    epoch_ns = 2_179_000_000 * 10**9
    header = FrameHeader(
        frame=7, t_start_tai_ns=epoch_ns, exposure_ns=200_000_000, line_time_ns=0, rows=SHAPE[0], cols=SHAPE[1],
        gain_e_adu=1.0, read_noise_e=2.3,
        attitude=AttitudeEstimate(
            quaternion=np.array([-np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]), rate_rad_s=np.zeros(3), covariance_rad2=np.eye(3) * 1e-7
        ),
        observer=ObserverState(
            tai_ns=epoch_ns, position_m=np.array([7.0e6, 0.0, 0.0]), velocity_m_s=np.zeros(3), sigma_position_m=10.0,
            sigma_velocity_m_s=0.1,
        ),
    )  # fmt: skip
    listed = StarList(
        row=row[inside],
        col=col[inside],
        flux_e=flux.astype(np.float32),
        snr=np.sqrt(flux).astype(np.float32),
        flags=np.zeros(len(inside), dtype=np.uint8),
    )
    frame = DownlinkFrame(
        header=header, flags=FrameFlag(0), housekeeping=None, stars=listed, rois=(), background=None, thumbnail_adu=None,
        whole_frame=None,
    )  # fmt: skip
    return calibration, frame


def questions(step: Any) -> Iterator[Verdict]:
    """Questions to an astrometry step with default options."""
    catalogue = StarCatalogue.embedded()
    calibration, frame = star_frame(catalogue)
    shared = {"catalogue": catalogue}
    solutions: list[FrameSolution] = []

    def solved(given: DownlinkFrame) -> tuple[Any, FrameSolution]:
        state, solution = step.solve(step.initial_state(calibration, catalogue), given)
        expect(isinstance(solution, FrameSolution), f"returned a {type(solution).__name__}, expected a FrameSolution")
        solutions.append(solution)
        return state, solution

    def without_stars() -> None:
        _, solution = solved(dataclasses.replace(frame, stars=StarList.empty()))
        expect(bool(solution.flags & FrameFlag.NO_SOLUTION), "gave a solution without a star; expected the flag NO_SOLUTION")

    def round_trip() -> None:
        _, solution = solved(frame)
        line = np.linspace(0.0, 1.0, 9)
        row, col = (a.ravel() for a in np.meshgrid(line * (SHAPE[0] - 1), line * (SHAPE[1] - 1), indexing="ij"))
        vectors = solution.camera.unproject(row, col)
        expect(np.shape(vectors) == (81, 3), f"unproject returned shape {np.shape(vectors)}, expected (81, 3)")
        expect(bool(np.allclose(np.linalg.norm(vectors, axis=1), 1.0, atol=1e-9)), "unproject returned vectors not of length 1")
        back = solution.camera.project(vectors)
        off = float(np.hypot(back[0] - row, back[1] - col).max())
        expect(off <= ROUND_TRIP_PX, f"pixel to direction to pixel is off by {off:.3g} px, allowed are {ROUND_TRIP_PX:g}")

    def behind() -> None:
        row, col = solved(frame)[1].camera.project(np.array([[0.0, 0.0, -1.0]]))
        expect(
            bool(np.isnan(row).all() and np.isnan(col).all()), "project gave a pixel for what is behind the camera; expected NaN"
        )

    def kept() -> None:
        state, solution = solved(frame)
        checkpoint.from_bytes(checkpoint.to_bytes(state, shared), shared)
        again = checkpoint.from_bytes(checkpoint.to_bytes(solution))
        place = np.array([3.0]), np.array([5.0])
        same = np.array_equal(again.camera.unproject(*place), solution.camera.unproject(*place))
        expect(same, "a camera that was written to a file and read gives other directions")

    def travels() -> None:
        ForkingPickler.dumps(solved(frame)[1])

    def named() -> None:
        lists = [tuple(p.name for p in solution.camera.parameters()) for solution in solutions]
        bad = [name for name in lists[0] if not name.isidentifier() or name != name.lower()]
        expect(not bad, f"parameters {bad}: names are small letters, digits and underscores")
        expect(len(set(lists)) == 1, "the names of the parameters differ between frames")

    def same_twice() -> None:
        expect(checkpoint.to_bytes(solved(frame)[1]) == checkpoint.to_bytes(solved(frame)[1]), "two calls gave different results")

    yield asked("survives a frame without stars", without_stars)
    yield asked("pixel to direction to pixel comes back", round_trip)
    yield asked("what is behind the camera has no pixel", behind)
    yield asked("state and solution can be kept in a file", kept)
    yield asked("a solution can travel to another process", travels)
    yield asked("the camera's parameters have names", named)
    yield asked("gives the same twice", same_twice)
