"""The halves of the chain as functions of one array: detect, measure, solve.

::

    from sboc_e2e.api import detect, measure, solve

    found = detect(image)                      # what the on-board detector sees
    trails = measure(image, found.detections)  # ends, errors, light and probability of each
    sky = solve(found.stars)                   # an astropy WCS (extra `solve`)
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from astropy.table import Column, Table
from astropy.wcs import WCS
from numpy.typing import ArrayLike, NDArray

from ground.astrometry import lost_in_space
from ground.products import tables
from onboard.chain import OnboardChain, OnboardResult, OnboardSteps
from sboc_e2e import scenario as scenarios
from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.icd.errors import PluginError, UserError
from sboc_e2e.icd.frame import GAINS_E_ADU, LARGEST_ADU, Frame, FrameHeader, NominalCamera
from sboc_e2e.icd.results import LARGEST_SNR, OUTSIDE_TOLERANCE_PX
from sboc_e2e.icd.signals import Detection, DetectorView, StarList
from sboc_e2e.icd.tai import NS_PER_S
from sboc_e2e.icd.work import UNLIMITED, Work, WorkMeter
from sboc_e2e.outside.fits_frames import MAX_SIDE_PX, MIN_SIDE_PX, pixels_of
from sboc_e2e.outside.frame_source import SourcedFrame
from sboc_e2e.outside.given_numbers import columns, number, plain
from sboc_e2e.outside.guessed_camera import camera_of_frame
from sboc_e2e.outside.header_times import FIRST_ASSUMED_TAI_NS
from sboc_e2e.outside.limits import MOST_DETECTIONS, work_meter
from sboc_e2e.outside.pixel_unit import LEAST_NOISE, in_unit, noise_adu, usable_unit
from sboc_e2e.outside.process import base_document
from sboc_e2e.outside.star_width import star_sigma_px
from sboc_e2e.registry import Registry
from sboc_e2e.run.ground_stage import ground_chain
from sboc_e2e.scenario import Scenario

RUN_ID: Final = 0  # Number in the packets of the only run there is; any number serves.
ENDS: Final = ("row0", "col0", "row1", "col1")
"""Columns of a table that hold the ends of detections."""
UNKNOWN_SNR: Final = 10.0
"""S/N of a detection that comes without one: the fit measures its own. Chosen."""
NAMED: Final = 5
"""So many detections are named in an error."""


@dataclass(frozen=True, kw_only=True)
class Found:
    """What one frame shows.

    detections : table of row0, col0, row1, col1 (px, 0-based, pixel centres at whole numbers), snr (matched filter) and flags.
    stars : table of row, col (px), flux_e (electrons), snr and flags, by falling flux; its meta
    holds ``rows`` and ``cols`` of the image, ``psf_sigma_px`` (NaN: no star tells it) and ``gain_e_adu`` of the image as given.
    """

    detections: Table
    stars: Table


@dataclass(frozen=True, kw_only=True)
class GivenDetections:
    """A detector that finds what it was given."""

    found: tuple[Detection, ...] = field(default=())
    history_frames: int = 0

    def detect(self, view: DetectorView) -> tuple[Detection, ...]:
        """All of them."""
        return self.found


def detect(
    image: ArrayLike,
    *,
    gain_e_adu: float | None = None,
    read_noise_e: float | None = None,
    saturation_adu: float | None = None,
    exposure_s: float = 0.0,
    detector: str | None = None,
) -> Found:
    """Trails and stars of one image.

    Parameters
    ----------
    image : (rows, cols) of any number type, ADU; NaN is a masked pixel, as is what the mask of a masked array or CCDData hides.
        Sides of 16 to 16384 px.
    gain_e_adu : e-/ADU; None: a guess from the noise, which `Found.stars.meta` has. read_noise_e : e-.
    saturation_adu : level from which pixels are full; None: by number type.
    exposure_s : seconds, 0 when unknown.
    detector : a name of seam ``onboard.detector``, by default the one of `sboc process`.

    Raises
    ------
    UserError
        One line: what is wrong with the image or an option.
    """
    frame, unit = _frame(image, gain_e_adu, read_noise_e, saturation_adu, exposure_s)
    scenario = _scenario(detector)
    with _computable() if detector is None else nullcontext():
        result, (camera, _) = _on_board(frame, scenario, scenario.step("onboard.detector"))
    return Found(detections=_detection_table(result.detections), stars=_star_table(result.stars, camera, unit))


def measure(
    image: ArrayLike,
    detections: Table | Iterable[tuple[float, float, float, float]],
    *,
    gain_e_adu: float | None = None,
    read_noise_e: float | None = None,
    saturation_adu: float | None = None,
    exposure_s: float = 0.0,
) -> Table:
    """Fitted trails of given detections, in the columns of ``products/streaks.ecsv``: ends with covariance and 68 % intervals
    (px), width, light (e-), S/N, probability of a real object, flags. One row for each detection, in their order, and its index
    (from 0) in a first column ``detection``.

    Where the pixels allow no fit, a row has the detection's own ends and `StreakFlag.FIT_FAILED`.

    Parameters
    ----------
    image, gain_e_adu, read_noise_e, saturation_adu, exposure_s : as for `detect`.
    detections : a table with columns row0, col0, row1, col1 (px) and, if it has one, snr (masked: unknown); or such rows as
        tuples. From `detect` or from any program. At most 1,000. Ends lie in the image or up to 2 px outside it.

    Raises
    ------
    UserError
        One line: what is wrong with the image, an option or which detections; an image without light cannot be measured in.
    """
    frame, _ = _frame(image, gain_e_adu, read_noise_e, saturation_adu, exposure_s)
    given = _detections(detections, frame.pixels.shape)
    scenario = _scenario(None)
    with _computable():
        result, (camera, packets) = _on_board(frame, scenario, GivenDetections(found=given), meter=_meter_of_all)
        chain = ground_chain(scenario, calibration=None, camera=camera, catalogue=StarCatalogue.embedded(), run_id=RUN_ID)
        frames, report = chain.ingest(packets)
        _, products = chain.process_frame(chain.initial_state(), frames[0])
        (table,) = tables.streaks_tables(chain.finish(frames, [products], report))
    return _by_detection(table, given, result)


def solve(stars: Table, *, width_deg: float | None = None) -> WCS:
    """The sky behind a list of stars: an astropy TAN WCS (ICRS) without distortion, good to about a tenth of a pixel of
    the star patterns' scatter in mid-field; `sboc process --wcs solve` fits the camera as well.

    Parameters
    ----------
    stars : as `detect` gives them: row, col (px), flux_e (any unit) and ``meta["rows"]``, ``meta["cols"]`` of the image.
        Rows with a number that is masked or not finite are left out.
    width_deg : of the image's columns, to 15 %, from 1.6 deg; None searches 1.6 to 60 deg.

    Raises
    ------
    UserError
        When no pattern fits, the table lacks something, or the extra `solve` is not installed.
    """
    if not isinstance(stars, Table):
        raise UserError(f"solve: expected a table of stars as `detect` gives it, got {type(stars).__name__}")
    size = [stars.meta.get(name) for name in ("rows", "cols")]
    if None in size:
        raise UserError('solve: the table of stars needs meta["rows"] and meta["cols"] of its image')
    rows, cols = (number(f'solve: meta["{name}"]', value) for name, value in zip(("rows", "cols"), size, strict=True))
    if not (1.0 <= rows < np.inf and 1.0 <= cols < np.inf):
        raise UserError(f'solve: expected meta["rows"] and meta["cols"] of 1 px or more, got {rows:g} and {cols:g}')
    values, hidden = columns(stars, ("row", "col", "flux_e"), "solve: the table of stars")
    hints: tuple[float, ...] = ()
    if width_deg is not None:
        width_deg = number("width_deg", width_deg)
        if not lost_in_space.NARROWEST_DEG <= width_deg < 180.0:
            allowed = f"{lost_in_space.NARROWEST_DEG:g} or more and less than 180 deg"
            raise UserError(
                f"width_deg: expected {allowed}, got {width_deg:g}; the catalogue has too few stars for narrower fields"
            )
        hints = (0.5 * int(cols) / np.tan(np.radians(0.5 * width_deg)),)
    lost_in_space.required_solver()
    row, col, flux = values[:, np.isfinite(values).all(axis=0) & ~hidden.any(axis=0)]
    order = np.argsort(-flux, kind="stable")
    seen = lost_in_space.StarField(row=row[order], col=col[order], flux=flux[order], rows=int(rows), cols=int(cols))
    match = lost_in_space.find_scale([seen], hints, StarCatalogue.embedded())
    if match is None:
        give = "give width_deg, or more stars" if width_deg is None else f"none {width_deg:g} deg wide, and none of other widths"
        raise UserError(f"solve: {len(flux)} stars fit no field of the catalogue; {give}")
    return _wcs(match, int(rows), int(cols))


@contextmanager
def _computable() -> Iterator[None]:
    """Numbers that no computation can end with are the image's, and the user is told so."""
    try:
        yield
    except (ArithmeticError, np.linalg.LinAlgError, PluginError) as error:
        cause = error.__cause__ if isinstance(error, PluginError) else error
        if not isinstance(cause, ArithmeticError | np.linalg.LinAlgError):
            raise
        raise UserError(f"image: its numbers, with this gain, cannot be computed with ({cause})") from error


def _frame(
    image: ArrayLike, gain_e_adu: float | None, read_noise_e: float | None, saturation_adu: float | None, exposure_s: float
) -> tuple[Frame, float]:
    """An array as a frame of the contract, and by what its pixels were multiplied; the frame's gain is that of its own pixels."""
    data, hidden = plain(image, "image: expected a two-dimensional array of numbers")
    if data.ndim != 2 or data.dtype.kind not in "uif":
        raise UserError(f"image: expected a two-dimensional array of numbers, got {data.ndim} dimensions of {data.dtype}")
    if not MIN_SIDE_PX <= min(data.shape) <= max(data.shape) <= MAX_SIDE_PX:
        raise UserError(f"image: expected sides of {MIN_SIDE_PX} to {MAX_SIDE_PX} px, got {data.shape[0]} x {data.shape[1]}")
    exposure_s = number("exposure_s", exposure_s)
    if not 0.0 <= exposure_s <= 1e6:
        raise UserError(f"exposure_s: expected 0 to 1e6, got {exposure_s:g}")
    gain_e_adu, read_noise_e, saturation_adu = (
        None if value is None else number(name, value)
        for name, value in (("gain_e_adu", gain_e_adu), ("read_noise_e", read_noise_e), ("saturation_adu", saturation_adu))
    )
    if read_noise_e is not None and not 0.0 <= read_noise_e <= 1e6:
        raise UserError(f"read_noise_e: expected 0 to 1e6, got {read_noise_e:g}")
    # What is hidden may be a number of any size, which must not decide the type of the others.
    pixels, full_adu = pixels_of(np.where(hidden, data.dtype.type(0), data) if hidden.any() else data)
    if hidden.any():
        pixels = np.where(hidden, np.float32(np.nan), pixels.astype(np.float32))
    if pixels.dtype.kind == "f" and np.isnan(pixels).all():
        raise UserError("image: expected numbers, got none but masked pixels")
    unit = usable_unit(pixels)
    if unit > 1.0:
        pixels = in_unit(pixels, unit)
    if gain_e_adu is not None:
        gain_e_adu = _gain_of_unit(gain_e_adu, pixels, unit)
    if saturation_adu is not None and not 0.0 < saturation_adu <= LARGEST_ADU / unit:
        raise UserError(f"saturation_adu: expected more than 0 and at most {LARGEST_ADU / unit:g}, got {saturation_adu:g}")
    header = FrameHeader(
        frame=0,
        t_start_tai_ns=FIRST_ASSUMED_TAI_NS,
        exposure_ns=round(exposure_s * NS_PER_S),
        line_time_ns=0,
        rows=data.shape[0],
        cols=data.shape[1],
        gain_e_adu=gain_e_adu,
        read_noise_e=read_noise_e,
        saturation_adu=full_adu if saturation_adu is None else saturation_adu * unit,
    )
    return Frame(header=header, pixels=pixels), unit


def _gain_of_unit(gain_e_adu: float, pixels: NDArray[Any], unit: float) -> float:
    """A gain for pixels that were multiplied by a unit. Raises `UserError` where it leaves them no noise to compute with.

    Real cameras have more (`pixel_unit.is_denied`), but simulated images need not.
    """
    gain, noise = gain_e_adu / unit, noise_adu(pixels)
    least_gain, largest_gain = GAINS_E_ADU
    if not least_gain <= gain <= largest_gain:
        allowed = f"{least_gain * unit:g} to {largest_gain * unit:g} e-/ADU"
        raise UserError(f"gain_e_adu: expected {allowed} for pixels with this noise, got {gain_e_adu:g}")
    if 0.0 < gain * noise < LEAST_NOISE:
        least = LEAST_NOISE / (noise / unit)
        raise UserError(
            f"gain_e_adu: {gain_e_adu:g} leaves pixels a noise of {gain * noise:.1g} e-; expected {least:.2g} or more"
        )
    return gain


def _scenario(detector: str | None) -> Scenario:
    use = {} if detector is None else {"onboard.detector": detector}
    return scenarios.bare("one_step", base_document("none"), registry=Registry(), use=use)


def _meter_of_all(n_pixels: int) -> WorkMeter:
    """The meter of a frame in which every region is sent, however many there are: the user asked for them."""
    usual = work_meter(n_pixels)
    return replace(usual, limits=usual.limits | {Work.REGIONS: UNLIMITED})


def _on_board(
    frame: Frame, scenario: Scenario, detector: Any, *, meter: Callable[[int], WorkMeter] = work_meter
) -> tuple[OnboardResult, tuple[NominalCamera, bytes]]:
    """What the on-board chain makes of a frame; the camera guessed from it, and its packets."""
    sourced = SourcedFrame(frame=frame, file="image", hdu=0, wcs=None, notes=())
    camera = camera_of_frame(sourced, star_sigma_px(np.asarray(frame.pixels, dtype=np.float32)))
    steps = OnboardSteps(
        background=scenario.step("onboard.background"),
        star_extractor=scenario.step("onboard.star_extractor"),
        detector=detector,
        codec=scenario.step("onboard.codec"),
    )
    chain = OnboardChain(scenario.onboard, steps, calibration=None, camera=camera, run_id=RUN_ID, work_meter=meter)
    _, result = chain.process(chain.initial_state(), frame)
    return result, (camera, result.packets)


def _detection_table(found: Iterable[Detection]) -> Table:
    rows = [(d.row0, d.col0, d.row1, d.col1, d.snr, int(d.flags)) for d in found]
    names = ("row0", "col0", "row1", "col1", "snr", "flags")
    columns: list[NDArray[Any]] = [np.array([row[k] for row in rows], dtype="i8" if k == 5 else "f8") for k in range(6)]
    table = Table(dict(zip(names, columns, strict=True)))
    for name in names[:4]:
        table[name].unit = "pix"
    return table


def _star_table(stars: StarList, camera: NominalCamera, unit: float) -> Table:
    """Stars of an image whose pixels were multiplied by a unit, as its camera knows them."""
    table = Table({name: np.array(getattr(stars, name)) for name in ("row", "col", "flux_e", "snr", "flags")})
    table["row"].unit = table["col"].unit = "pix"
    table["flux_e"].unit = "electron"
    width = float("nan") if stars.psf_sigma_px is None else stars.psf_sigma_px
    table.meta = {"rows": camera.rows, "cols": camera.cols, "psf_sigma_px": width, "gain_e_adu": unit * camera.gain_e_adu}
    return table


def _detections(given: Table | Iterable[tuple[float, float, float, float]], shape: tuple[int, ...]) -> tuple[Detection, ...]:
    """Detections of the contract in an image of a shape, from a table or tuples."""
    if isinstance(given, Table):
        values, masked = columns(given, ENDS, "detections: the table")
        ends, hidden = values.T, masked.any(axis=0)
    else:
        ends, hidden = _ends_of_rows(given)
    snr = np.full(len(ends), UNKNOWN_SNR)
    if isinstance(given, Table) and "snr" in given.colnames:
        (told,), (unknown,) = columns(given, ("snr",), "detections: the table")
        snr = np.where(unknown, snr, told)
    if len(ends) > MOST_DETECTIONS:
        raise UserError(f"detections: expected {MOST_DETECTIONS} at most, got {len(ends)}")
    least, most = -OUTSIDE_TOLERANCE_PX, np.tile(shape, 2) - 1.0 + OUTSIDE_TOLERANCE_PX
    inside = f"ends in the image of {shape[0]} x {shape[1]} px or up to {OUTSIDE_TOLERANCE_PX:g} px outside it"
    _require(~hidden, "ends that are not masked")
    _require(np.isfinite(ends).all(axis=1), "finite ends")
    _require(((ends >= least) & (ends <= most)).all(axis=1), inside)
    _require((snr >= 0.0) & (snr <= LARGEST_SNR), f"S/N from 0 to {LARGEST_SNR:g}")
    return tuple(
        Detection(row0=float(e[0]), col0=float(e[1]), row1=float(e[2]), col1=float(e[3]), snr=float(s))
        for e, s in zip(ends, snr, strict=True)
    )


def _ends_of_rows(given: Iterable[Any]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Ends (n, 4) of rows of four numbers or more, and in which rows (n,) a mask hides one of them."""
    try:
        rows = [tuple(row)[:4] for row in given]
        if any(len(row) != len(ENDS) for row in rows):
            raise ValueError(rows)
        hidden = [any(bool(getattr(value, "mask", False)) for value in row) for row in rows]
        # a masked number becomes a float with a warning of numpy
        shown = [(0.0,) * len(ENDS) if masked else row for row, masked in zip(rows, hidden, strict=True)]
        return np.array(shown, dtype=np.float64).reshape(-1, len(ENDS)), np.array(hidden, dtype=np.bool_)
    except (TypeError, ValueError, OverflowError) as error:
        raise UserError("detections: expected four numbers each, row0, col0, row1, col1") from error


def _require(holds: ArrayLike, expected: str) -> None:
    """Raise a `UserError` that names the detections (n,) of which something does not hold, a few at most."""
    not_so = np.flatnonzero(np.logical_not(holds)).tolist()
    if not_so:
        named = ", ".join(str(k) for k in not_so[:NAMED])
        more = f" and {len(not_so) - NAMED} more" if len(not_so) > NAMED else ""
        raise UserError(f"detections: expected {expected}; detection {named}{more} (counted from 0) is not so")


def _by_detection(table: Table, given: Sequence[Detection], result: OnboardResult) -> Table:
    """Rows in the order of the detections that were given, with their index."""
    place = {id(each): k for k, each in enumerate(given)}
    of_roi = {group.roi_id: place[id(group.detection)] for group in result.rois}
    measured = np.array([of_roi[roi_id] for roi_id in table["roi_id"].tolist()], dtype=np.int64)
    _require(np.isin(np.arange(len(given)), measured), "pixels that differ, and a tenth of them usable")
    table.add_column(Column(measured, name="detection", description="index of the detection that was given, from 0"), index=0)
    return table[np.argsort(measured, kind="stable")]


def _wcs(match: lost_in_space.PatternMatch, rows: int, cols: int) -> WCS:
    """A TAN projection about the image's middle."""
    sky = match.matrix.T  # columns: camera axes (+col, +row, boresight) in celestial axes
    boresight = sky[:, 2]
    ra, dec = np.arctan2(boresight[1], boresight[0]), np.arcsin(np.clip(boresight[2], -1.0, 1.0))
    east = np.array([-np.sin(ra), np.cos(ra), 0.0])
    north = np.cross(boresight, east)
    axes = np.stack((-sky[:, 0] if match.mirrored else sky[:, 0], sky[:, 1]), axis=1)
    wcs = WCS(naxis=2)
    wcs.wcs.ctype = ["RA---TAN", "DEC--TAN"]
    wcs.wcs.crval = [float(np.degrees(ra) % 360.0), float(np.degrees(dec))]
    wcs.wcs.crpix = [0.5 * (cols + 1), 0.5 * (rows + 1)]
    wcs.wcs.cd = np.degrees(np.stack((east @ axes, north @ axes)) / match.focal_px)
    wcs.wcs.set()
    return wcs
