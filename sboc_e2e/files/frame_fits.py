"""Frames of a run as FITS: an image that any viewer opens, and a one-row table that gives the frame header back exactly."""

import io
from pathlib import Path
from typing import Any, Final

import numpy as np
from astropy.io import fits
from astropy.time import Time

from sboc_e2e.files.atomic import write_bytes
from sboc_e2e.icd.errors import UserError
from sboc_e2e.icd.frame import AttitudeEstimate, Frame, FrameHeader, ObserverState
from sboc_e2e.icd.tai import to_jd_parts

TELEMETRY: Final = "TELEMETRY"
_INTEGERS: Final = (
    "frame",
    "t_start_tai_ns",
    "exposure_ns",
    "line_time_ns",
    "bin_rows",
    "bin_cols",
    "window_row0",
    "window_col0",
)
_FLOATS: Final = ("gain_e_adu", "read_noise_e", "saturation_adu", "temperature_k")


def utc_text(tai_ns: int, precision: int = 6) -> str:
    """UTC as ISO 8601 of integer TAI."""
    return str(Time(*to_jd_parts(tai_ns), format="jd", scale="tai", precision=precision).utc.isot)


def write(path: Path, frame: Frame) -> None:
    """Write a frame atomically."""
    write_bytes(path, to_bytes(frame))


def read(path: Path) -> Frame:
    """A frame that `write` made. Raises `UserError` for anything else."""
    try:
        with fits.open(path, memmap=False) as hdus:
            pixels = np.ascontiguousarray(hdus[0].data)
            row = hdus[TELEMETRY].data[0]
            header = _header(row, pixels.shape)
    except (OSError, KeyError, IndexError, ValueError, TypeError) as error:
        raise UserError(f"{path}: not a frame of a run ({type(error).__name__}); run the simulate stage again") from error
    if pixels.dtype.kind == "f":
        return Frame(header=header, pixels=pixels.astype(np.float32))
    return Frame(header=header, pixels=pixels.astype(np.uint16))


def to_bytes(frame: Frame) -> bytes:
    """FITS bytes of a frame."""
    header = frame.header
    image = fits.PrimaryHDU(np.asarray(frame.pixels))
    cards: list[tuple[str, Any, str]] = [
        ("DATE-OBS", utc_text(header.t_start_tai_ns), "start of row 0, on-board clock"),
        ("TIMESYS", "UTC", "scale of DATE-OBS"),
        ("EXPTIME", header.exposure_ns * 1e-9, "[s] exposure of each row"),
        ("LINETIME", header.line_time_ns * 1e-9, "[s] row r starts r times this later"),
        ("FRAMENO", header.frame, "frame number"),
        ("XBINNING", header.bin_cols, "detector columns per column"),
        ("YBINNING", header.bin_rows, "detector rows per row"),
    ]
    for key, value, text in (
        ("GAIN", header.gain_e_adu, "[e-/ADU]"),
        ("RDNOISE", header.read_noise_e, "[e-]"),
        ("SATURATE", header.saturation_adu, "[ADU]"),
        ("CCD-TEMP", header.temperature_k, "[K]"),
    ):
        if value is not None:
            cards.append((key, value, text))
    for card in cards:
        image.header.append(card)
    stream = io.BytesIO()
    fits.HDUList([image, fits.BinTableHDU(_row(header), name=TELEMETRY)]).writeto(stream)
    return stream.getvalue()


def _row(header: FrameHeader) -> np.ndarray[Any, Any]:
    """One-row table with every field of the header; what is unknown is NaN."""
    attitude, observer = header.attitude, header.observer
    nan = np.nan
    values: list[tuple[str, Any, Any]] = [(name, "i8", getattr(header, name)) for name in _INTEGERS]
    values += [(name, "f8", nan if getattr(header, name) is None else getattr(header, name)) for name in _FLOATS]
    values += [
        ("has_attitude", "i2", attitude is not None),
        ("quaternion", ("f8", (4,)), attitude.quaternion if attitude else np.full(4, nan)),
        ("rate_rad_s", ("f8", (3,)), attitude.rate_rad_s if attitude else np.full(3, nan)),
        ("covariance_rad2", ("f8", (9,)), attitude.covariance_rad2.ravel() if attitude else np.full(9, nan)),
        ("has_observer", "i2", observer is not None),
        ("observer_tai_ns", "i8", observer.tai_ns if observer else 0),
        ("position_m", ("f8", (3,)), observer.position_m if observer else np.full(3, nan)),
        ("velocity_m_s", ("f8", (3,)), observer.velocity_m_s if observer else np.full(3, nan)),
        ("sigma_position_m", "f8", observer.sigma_position_m if observer else nan),
        ("sigma_velocity_m_s", "f8", observer.sigma_velocity_m_s if observer else nan),
    ]
    dtype = np.dtype([(name, *kind) if isinstance(kind, tuple) else (name, kind) for name, kind, _ in values])
    return np.array([tuple(value for _, _, value in values)], dtype=dtype)


def _header(row: Any, shape: tuple[int, ...]) -> FrameHeader:
    """Frame header of a telemetry row."""
    known: dict[str, Any] = {name: int(row[name]) for name in _INTEGERS}
    known |= {name: float(row[name]) for name in _FLOATS if not np.isnan(row[name])}
    if row["has_attitude"]:
        known["attitude"] = AttitudeEstimate(
            quaternion=np.array(row["quaternion"], dtype=np.float64),
            rate_rad_s=np.array(row["rate_rad_s"], dtype=np.float64),
            covariance_rad2=np.array(row["covariance_rad2"], dtype=np.float64).reshape(3, 3),
        )
    if row["has_observer"]:
        known["observer"] = ObserverState(
            tai_ns=int(row["observer_tai_ns"]),
            position_m=np.array(row["position_m"], dtype=np.float64),
            velocity_m_s=np.array(row["velocity_m_s"], dtype=np.float64),
            sigma_position_m=float(row["sigma_position_m"]),
            sigma_velocity_m_s=float(row["sigma_velocity_m_s"]),
        )
    return FrameHeader(rows=int(shape[0]), cols=int(shape[1]), **known)
