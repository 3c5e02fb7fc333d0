"""Bytes of the downlink: CCSDS Space Packets (133.0-B), big endian; struct formats, APIDs, codec numbers, limits.

Encoders live in `onboard.downlink.packets`, decoders in `ground.ingest`; `ICD.md` gives the same tables with byte offsets.

A packet is: primary header (6) | secondary header: CUC time code of the frame's t_start (10) | item header (28) |
payload | CRC-16-CCITT of everything before it (2). At most `MAX_PACKET_BYTES` in all; each decodes alone.
"""

import struct
from enum import IntEnum
from typing import Final

import numpy as np

MAX_PACKET_BYTES: Final = 4096
"""Header and CRC are 1.1 % of it (46 bytes); what one lost packet takes with it stays small (docs/decisions/03). CCSDS allows
65,542."""

PRIMARY = struct.Struct(">HHH")
"""Version 0, type 0 (telemetry), secondary header flag 1, APID | sequence flags 3, count per APID | data length - 1."""

CUC_PREAMBLE: Final = bytes((0b1_001_11_11, 0b0_00_001_00))
"""P-field: extended; level 1 epoch (1958 TAI); 4 octets of seconds, 3 + 1 octets of binary fraction."""

CUC_TIME = struct.Struct(">II")
"""Seconds since 1958-01-01 TAI, and 2**-32 s (0.23 ns: rounding to ns gives `t_start_tai_ns` back exactly)."""

ITEM = struct.Struct(">BBIIQiHHH")
"""Contract major, minor | run id | frame | exposure_ns | line_time_ns | item | segment | number of segments."""

CRC = struct.Struct(">H")
CRC_START: Final = 0xFFFF
"""CRC-16-CCITT (polynomial 0x1021), as `binascii.crc_hqx(data, CRC_START)`."""

HEADER_BYTES: Final = PRIMARY.size + len(CUC_PREAMBLE) + CUC_TIME.size + ITEM.size
MAX_PAYLOAD_BYTES: Final = MAX_PACKET_BYTES - HEADER_BYTES - CRC.size


class Apid(IntEnum):
    """Application process identifier of each kind of packet."""

    HEADER = 0x100
    STARS = 0x101
    ROI = 0x102
    BACKGROUND = 0x103
    THUMBNAIL = 0x104
    FRAME = 0x105
    TRACK = 0x106


class CodecNumber(IntEnum):
    """Numbers of the shipped codecs; plug-ins use 128-255."""

    RAW = 0
    PLANES = 1
    CCSDS121 = 2
    SQRT_PLANES = 3
    RANS = 4


STAR_DTYPE = np.dtype(
    [("row_hi", "u1"), ("row_lo", ">u2"), ("col_hi", "u1"), ("col_lo", ">u2"), ("flux", ">u2"), ("snr", "u1"), ("flags", "u1")]
)
"""One star, 10 bytes. Positions: 24-bit units of `STAR_POSITION_UNIT_PX` offset by `STAR_POSITION_OFFSET_PX`;
flux_e = 2**(flux / `STAR_FLUX_CODES_PER_OCTAVE`) - 1; snr = 2**(snr / `STAR_SNR_CODES_PER_OCTAVE`) - 1."""

STAR_POSITION_UNIT_PX: Final = 1.0 / 512.0  # Rounding adds 5.6e-4 px rms (unit / sqrt(12)); 24 bits of it reach over 32,768 px.
STAR_POSITION_OFFSET_PX: Final = -64.0  # Least position: centres of trailed stars at the edge lie outside the frame.
STAR_FLUX_CODES_PER_OCTAVE: Final = 2048.0  # Steps of 0.03 %; 16 bits reach over 32 octaves, to 4e9 e-.
STAR_SNR_CODES_PER_OCTAVE: Final = 16.0  # Steps of 4.4 %; 8 bits reach over 16 octaves, to 63,000.

HEADER_FIXED = struct.Struct(">HHBBHHffffddIIIIIIIffffI")
"""Header packet: rows, cols, bin_rows, bin_cols, window_row0, window_col0, gain, read noise, saturation_adu, temperature
(NaN: unknown), adu_scale, adu_offset, then housekeeping: flags (low 16 bits), stars found, stars sent, detections,
ROIs sent, ROIs dropped, bytes dropped, threshold sigma, background ADU, sigma ADU, PSF sigma px as measured from stars
(NaN: not measured), masked pixels.
Then two telemetry blocks, this frame's and the previous frame's, and `HEADER_WORK`."""

HEADER_WORK = struct.Struct(">II6I")
"""End of the header packet, after the telemetry blocks, since 2.4: parameter set | operations of the frame in thousands | items
left undone: stars, halos, candidates, points, trails, regions."""

TELEMETRY = struct.Struct(">BI4d3d6dq3d3dff")
"""Presence bits (1 attitude, 2 observer) | frame number it belongs to | quaternion | rate rad/s |
covariance rad^2 (xx, xy, xz, yy, yz, zz) | observer tai_ns | position m | velocity m/s | sigma position m, velocity m/s.
Absent values are zero."""

HAS_ATTITUDE: Final = 1  # Bit 0 of the presence bits: quaternion, rate and covariance are given.
HAS_OBSERVER: Final = 2  # Bit 1 of the presence bits: time, place and velocity of the camera are given.

ROI_GROUP = struct.Struct(">fffffHf")
"""In each ROI packet: row0, col0, row1, col1, snr, flags (low 16 bits), sagitta_px of the detection.
The item number of the packet is the roi_id, its segment the strip's number."""

TRACK_MEMBER = struct.Struct(">IIqfiHH")
"""In each TRACK packet: number of the track in the run | frame, t_start_tai_ns of the member's frame, which is the packet's own
or an earlier one | joint S/N | roi_id of the member among that frame's ROI packets, `TRACK_STRIP_FOLLOWS` when its pixels were
not sent before and follow here as in a ROI packet, each segment of the item a strip (the first one may name a region that lacks
them) | members of the track so far | reserved."""

TRACK_STRIP_FOLLOWS: Final = -1  # In the place of a roi_id, which is never negative: the pixels follow in this packet.

STRIP = struct.Struct(">BBHHHiiifI")
"""Codec number | axis | major0 | n | width | minor0_fp | slope_fp | level ADU | sigma ADU | block length in bytes."""

MESH = struct.Struct(">HHHHHffiiI")
"""BACKGROUND: tile_px | mesh rows | mesh cols | first mesh row in this packet | number of mesh rows | level unit ADU |
sigma unit ADU | level centre code | sigma centre code | length of the level block in bytes; then the level and the
sigma codes as two `PLANES` blocks coded around their centre codes; level = unit * code."""

THUMBNAIL = struct.Struct(">HHHHHff")
"""rows | cols | pixels per cell | first row in this packet | number of rows | offset ADU | unit ADU; then zstd of uint8."""

CHUNK = struct.Struct(">BBHHHHifI")
"""FRAME: codec number | reserved | first row | rows | first col | cols | level ADU | sigma ADU | block length."""

BYTES_ESCAPED: Final = 0x10  # Layout of a `PLANES` block: a byte for each code, and escapes where it is 255 or more.
NIBBLES_ESCAPED: Final = 0x20
"""First byte of a `PLANES` block. 1-4: the number of byte planes. One of these constants | 1-4: bytes or nibbles, then escapes
of that number of byte planes."""

PLANES_ESCAPES = struct.Struct(">H")
"""Second field of a `PLANES` block with escapes: their number."""

SQRT_PLANES = struct.Struct(">ff")
"""Head of a `SQRT_PLANES` block: step in ADU, gain in e-/ADU; then the codes as a `PLANES` block around zero."""

MAX_STRIP_PIXELS: Final = 1 << 16
"""Largest number of pixels in one strip or chunk: decoders refuse more before they allocate."""

DECOMPRESSED_LIMIT_BYTES: Final = 1 << 20
"""Largest decompressed size of any block: decoders refuse more before they allocate."""
