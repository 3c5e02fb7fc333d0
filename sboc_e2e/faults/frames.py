"""Damage to frames between the camera and the on-board software."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.faults.options import FaultOptions, HeaderFaults, PixelFaults
from sboc_e2e.faults.random import FaultStream, generator
from sboc_e2e.icd.errors import UserError
from sboc_e2e.icd.frame import AttitudeEstimate, Frame, FrameHeader
from sboc_e2e.icd.tai import NS_PER_S


def delivered_frames(n_frames: int, options: FaultOptions, seed: int) -> tuple[int, ...]:
    """Numbers of the frames that reach the on-board software, in order: dropped ones missing, repeated ones twice."""
    chance = generator(seed, FaultStream.FRAMES).random((2, n_frames))
    faults = options.frames
    result: list[int] = []
    for frame in range(n_frames):
        if chance[0, frame] < faults.dropped:
            continue
        result += [frame, frame] if chance[1, frame] < faults.repeated else [frame]
    return tuple(result)


def damaged_frame(frame: Frame, options: FaultOptions, seed: int) -> Frame:
    """The frame as the on-board software gets it."""
    header = _damaged_header(frame.header, options.header, seed)
    pixels = options.pixels
    untouched = pixels.stuck_column < 0 and not pixels.dead_quadrant and pixels.stray_light_adu == 0.0
    if untouched and header is frame.header:
        return frame
    return Frame(header=header, pixels=frame.pixels if untouched else _damaged_pixels(frame, pixels))


def _damaged_header(header: FrameHeader, options: HeaderFaults, seed: int) -> FrameHeader:
    if options.clock_jump_s != 0.0 and header.frame >= options.clock_jump_frame:
        header = dataclasses.replace(header, t_start_tai_ns=header.t_start_tai_ns + round(options.clock_jump_s * NS_PER_S))
    if options.attitude == "good" or header.attitude is None:
        return header
    if generator(seed, FaultStream.ATTITUDE, header.frame).random() >= options.attitude_frames:
        return header
    attitude = None if options.attitude == "missing" else _turned(header.attitude, options.attitude_error_deg)
    return dataclasses.replace(header, attitude=attitude)


def _turned(attitude: AttitudeEstimate, angle_deg: float) -> AttitudeEstimate:
    """The attitude turned about the camera's Y axis (Hamilton product with the turn on the left, scalar last)."""
    half = np.radians(angle_deg) / 2.0
    s, c = float(np.sin(half)), float(np.cos(half))
    x, y, z, w = attitude.quaternion
    turned = np.array([c * x + s * z, c * y + s * w, c * z - s * x, c * w - s * y])
    return dataclasses.replace(attitude, quaternion=turned / np.linalg.norm(turned))


def _damaged_pixels(frame: Frame, options: PixelFaults) -> NDArray[np.uint16] | NDArray[np.float32]:
    """Pixels after the detector's faults; integer frames stay integer."""
    rows, cols = frame.pixels.shape
    if options.stuck_column >= cols:
        raise UserError(
            f"faults.pixels.stuck_column: expected -1 to {cols - 1} in frames of {rows} x {cols} px, got {options.stuck_column}"
        )
    image = frame.pixels.astype(np.float32)
    if options.stray_light_adu > 0.0:
        image += (options.stray_light_adu * (1.0 - np.arange(cols) / max(cols - 1, 1))).astype(np.float32)
    if options.dead_quadrant:
        image[rows // 2 :, cols // 2 :] = options.dead_level_adu
    if options.stuck_column >= 0:
        image[:, options.stuck_column] = options.stuck_level_adu
    if frame.pixels.dtype == np.uint16:
        return np.clip(np.rint(image), 0, 65535).astype(np.uint16)
    return image
