"""What the golden packets hold: fixed records, written by hand, one packet of each kind.

Run as a script it writes the packets and their tables anew (after a change of the contract, with a new version).
"""

import csv
import struct
from pathlib import Path
from typing import Any

import numpy as np

from onboard.downlink import packets
from onboard.downlink.codec import PlanesCodec, RansCodec, RawCodec
from sboc_e2e.icd.downlink import Housekeeping
from sboc_e2e.icd.flags import FrameFlag, StarFlag, StreakFlag
from sboc_e2e.icd.frame import AttitudeEstimate, FrameHeader, ObserverState
from sboc_e2e.icd.layout import Apid
from sboc_e2e.icd.signals import BackgroundModel, Detection, StarList, Strip, Track, TrackMember

FOLDER = Path(__file__).parent
RUN_ID = 0x5B0C_0001

PACKET_FIELDS = (
    ("primary.version_type_apid", ">H"), ("primary.sequence", ">H"), ("primary.data_length_minus_1", ">H"),
    ("time.preamble_1", ">B"), ("time.preamble_2", ">B"), ("time.seconds_1958_tai", ">I"), ("time.fraction_2^-32_s", ">I"),
    ("item.contract_major", ">B"), ("item.contract_minor", ">B"), ("item.run_id", ">I"), ("item.frame", ">I"),
    ("item.exposure_ns", ">Q"), ("item.line_time_ns", ">i"), ("item.item", ">H"), ("item.segment", ">H"),
    ("item.n_segments", ">H"),
)  # fmt: skip
"""Headers of every packet in order, with the formats of Python's `struct`; as ICD.md has them, not as the code does."""

TELEMETRY_FIELDS = (
    ("present", ">B"), ("frame", ">I"), ("q_x", ">d"), ("q_y", ">d"), ("q_z", ">d"), ("q_w", ">d"),
    ("rate_x_rad_s", ">d"), ("rate_y_rad_s", ">d"), ("rate_z_rad_s", ">d"),
    ("cov_xx_rad2", ">d"), ("cov_xy_rad2", ">d"), ("cov_xz_rad2", ">d"), ("cov_yy_rad2", ">d"), ("cov_yz_rad2", ">d"),
    ("cov_zz_rad2", ">d"), ("observer_tai_ns", ">q"), ("x_m", ">d"), ("y_m", ">d"), ("z_m", ">d"),
    ("vx_m_s", ">d"), ("vy_m_s", ">d"), ("vz_m_s", ">d"), ("sigma_position_m", ">f"), ("sigma_velocity_m_s", ">f"),
)  # fmt: skip

PAYLOAD_FIELDS: dict[str, tuple[tuple[str, str], ...]] = {
    "header": (
        ("rows", ">H"), ("cols", ">H"), ("bin_rows", ">B"), ("bin_cols", ">B"), ("window_row0", ">H"), ("window_col0", ">H"),
        ("gain_e_adu", ">f"), ("read_noise_e", ">f"), ("saturation_adu", ">f"), ("temperature_k", ">f"),
        ("adu_scale", ">d"), ("adu_offset", ">d"), ("flags", ">I"), ("n_stars_found", ">I"), ("n_stars_sent", ">I"),
        ("n_detections", ">I"), ("n_rois_sent", ">I"), ("n_rois_dropped", ">I"), ("bytes_dropped", ">I"),
        ("threshold_sigma", ">f"), ("background_adu", ">f"), ("sigma_adu", ">f"), ("psf_sigma_px", ">f"), ("n_masked", ">I"),
        *((f"this.{name}", form) for name, form in TELEMETRY_FIELDS),
        *((f"previous.{name}", form) for name, form in TELEMETRY_FIELDS),
        ("parameter_set", ">I"), ("operations_thousands", ">I"), ("shed_stars", ">I"), ("shed_halos", ">I"),
        ("shed_candidates", ">I"), ("shed_points", ">I"), ("shed_trails", ">I"), ("shed_regions", ">I"),
    ),
    "stars": tuple(
        (f"star{k}.{name}", form)
        for k in range(2)
        for name, form in (
            ("row_hi", ">B"), ("row_lo", ">H"), ("col_hi", ">B"), ("col_lo", ">H"), ("flux", ">H"),
            ("snr", ">B"), ("flags", ">B"),
        )
    ),
    "roi": (
        ("row0", ">f"), ("col0", ">f"), ("row1", ">f"), ("col1", ">f"), ("snr", ">f"), ("flags", ">H"), ("sagitta_px", ">f"),
        ("codec", ">B"), ("axis", ">B"), ("major0", ">H"), ("n", ">H"), ("width", ">H"), ("minor0_fp", ">i"), ("slope_fp", ">i"),
        ("level", ">i"), ("sigma", ">f"), ("block_bytes", ">I"), *((f"value{k}", ">i") for k in range(6)),
    ),
    "background": (
        ("tile_px", ">H"), ("mesh_rows", ">H"), ("mesh_cols", ">H"), ("first_row", ">H"), ("n_rows", ">H"),
        ("level_unit_adu", ">f"), ("sigma_unit_adu", ">f"), ("level_centre", ">i"), ("sigma_centre", ">i"), ("level_bytes", ">I"),
    ),
    "thumbnail": (
        ("rows", ">H"), ("cols", ">H"), ("cell_px", ">H"), ("first_row", ">H"), ("n_rows", ">H"),
        ("offset_adu", ">f"), ("unit_adu", ">f"),
    ),
    "frame": (
        ("codec", ">B"), ("reserved", ">B"), ("first_row", ">H"), ("rows", ">H"), ("first_col", ">H"), ("cols", ">H"),
        ("level", ">i"), ("sigma", ">f"), ("block_bytes", ">I"), ("layout", ">B"), ("n_escapes", ">H"),
    ),
    "track": (
        ("track", ">I"), ("frame", ">I"), ("t_start_tai_ns", ">q"), ("snr", ">f"), ("roi_id", ">i"), ("n_members", ">H"),
        ("reserved", ">H"),
    ),
}  # fmt: skip

HEADER = FrameHeader(
    frame=41,
    t_start_tai_ns=2_179_872_047_250_000_123,
    exposure_ns=200_000_000,
    line_time_ns=-10_000,
    rows=4096,
    cols=4000,
    bin_rows=1,
    bin_cols=2,
    window_row0=3,
    window_col0=90,
    gain_e_adu=1.25,
    read_noise_e=2.5,
    saturation_adu=32241.0,
    attitude=AttitudeEstimate(
        quaternion=np.array([0.5, -0.5, 0.5, 0.5]),
        rate_rad_s=np.array([1e-6, -2e-6, 3e-6]),
        covariance_rad2=np.array([[4e-9, 1e-10, 2e-10], [1e-10, 5e-9, 3e-10], [2e-10, 3e-10, 9e-9]]),
    ),
    observer=ObserverState(
        tai_ns=2_179_872_047_300_000_000,
        position_m=np.array([4669943.5, 2829360.25, 4504055.75]),
        velocity_m_s=np.array([-3292.5, -3611.5, 5682.625]),
        sigma_position_m=10.0,
        sigma_velocity_m_s=0.0625,
    ),
    temperature_k=None,
)

PREVIOUS = FrameHeader(
    frame=40, t_start_tai_ns=2_179_872_047_000_000_123, exposure_ns=200_000_000, line_time_ns=-10_000, rows=4096, cols=4000,
    attitude=HEADER.attitude,
)  # fmt: skip

HOUSEKEEPING = Housekeeping(
    flags=FrameFlag.NO_OBSERVER | FrameFlag.BUDGET_CUT,
    n_stars_found=25000,
    n_stars_sent=250,
    n_detections=14,
    n_rois_sent=12,
    n_rois_dropped=2,
    bytes_dropped=12345,
    threshold_sigma=7.25,
    background_adu=2.75,
    sigma_adu=2.375,
    n_masked=1846,
    parameter_set=0x5E7_0001,
    operations=412_345_000,
    shed_stars=3,
    shed_halos=5,
    shed_candidates=20,
    shed_points=1,
    shed_trails=2,
    shed_regions=4,
)

STARS = StarList(
    row=np.array([100.25, -3.5]),
    col=np.array([2047.998046875, 4000.0]),
    flux_e=np.array([1000.0, 63.0]),
    snr=np.array([120.0, 7.0]),
    flags=np.array([0, int(StarFlag.SATURATED | StarFlag.EDGE)]),
)

DETECTION = Detection(
    row0=100.5, col0=200.25, row1=103.5, col1=201.0, snr=9.5, sagitta_px=-0.25, flags=StreakFlag.POINT_LIKE | StreakFlag.CURVED
)

STRIP = Strip(
    axis=0,
    major0=101,
    minor0_fp=199 * 65536 + 32768,
    slope_fp=16384,
    level_adu=3,
    values_adu=np.array([[1, 2, 70000], [-4, 3, 0]]),
)

BACKGROUND = BackgroundModel(
    tile_px=64,
    level_adu=np.array([[2.5, 3.0, 2.0], [2.25, 2.75, -1.0]]),
    sigma_adu=np.array([[2.5, 2.25, 2.0], [2.75, 3.0, 9.0]]),
)

TRACK = Track(
    number=3,
    snr=8.25,
    members=(TrackMember(frame=40, detection=DETECTION), TrackMember(frame=41, detection=DETECTION)),
)

CELLS = np.array([[0, 16, 17], [255, 15, 16]], dtype=np.uint8)

CHUNK = np.array([[5, 6, 4, 5], [5, 300, 5, -2]])


STAR = np.array(
    [
        [4, 5, 7, 3, 5, 6],
        [5, 9, 40, 21, 6, 2],
        [6, 31, 5000, 90, 8, 5],
        [3, 8, 70000, 300, 4, -200],
        [5, 6, 4, 5, 5, 2000000000],
    ]
)
"""A star, a saturated column, values that need the escape: the block of codec `rans`, level 5."""


def make_packets() -> dict[str, bytes]:
    """The packet of each kind as the on-board software writes it."""
    writer = packets.PacketWriter(run_id=RUN_ID, counts={int(apid): 16383 for apid in Apid})
    raw, planes = RawCodec(), PlanesCodec()
    payloads = {
        Apid.HEADER: packets.header_payload(HEADER, HOUSEKEEPING, PREVIOUS, adu_scale=1.0, adu_offset=0.0, psf_sigma_px=0.875),
        Apid.STARS: packets.star_payloads(STARS)[0],
        Apid.ROI: packets.roi_payload(
            DETECTION, STRIP, raw.number, 2.375, raw.encode(STRIP.values_adu, level_adu=3, sigma_adu=2.375)
        ),
        Apid.BACKGROUND: packets.background_payloads(BACKGROUND, level_unit_adu=0.125, sigma_unit_adu=0.0625)[0],
        Apid.THUMBNAIL: packets.thumbnail_payloads(CELLS, cell_px=2048, offset_adu=-2.0, unit_adu=0.25)[0],
        Apid.FRAME: packets.chunk_payload(
            (64, 2, 128, 4), planes.number, level_adu=5, sigma_adu=2.375, block=planes.encode(CHUNK, level_adu=5, sigma_adu=2.375)
        ),
    }
    payloads[Apid.TRACK] = packets.track_payload(TRACK, TRACK.members[0], PREVIOUS.t_start_tai_ns, 5)
    return {apid.name.lower(): writer.write(apid, HEADER, [payload], item=7)[0][0] for apid, payload in payloads.items()}


def table(kind: str, packet: bytes) -> list[tuple[int, str, str, Any]]:
    """Rows (offset, format, field, value) of a packet by the fields above, its checksum last."""
    rows, offset = [], 0
    for name, form in (*PACKET_FIELDS, *PAYLOAD_FIELDS[kind]):
        rows.append((offset, form, name, struct.unpack_from(form, packet, offset)[0]))
        offset += struct.calcsize(form)
    rows.append((len(packet) - 2, ">H", "crc", struct.unpack_from(">H", packet, len(packet) - 2)[0]))
    return rows


def main() -> None:
    """Write the golden packets and tables."""
    for kind, packet in make_packets().items():
        (FOLDER / f"{kind}.bin").write_bytes(packet)
        with (FOLDER / f"{kind}.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(("offset", "format", "field", "value"))
            writer.writerows((offset, form, name, repr(value)) for offset, form, name, value in table(kind, packet))
    (FOLDER / "rans.bin").write_bytes(RansCodec().encode(STAR, level_adu=5, sigma_adu=2.375))
    np.savetxt(FOLDER / "rans.csv", STAR, fmt="%d", delimiter=",")


if __name__ == "__main__":
    main()
