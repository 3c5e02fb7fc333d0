"""A schedule as a Pointing Request Message: CCSDS 509.0-B-1, templates 4-1 and 4-2, inertial pointing.

Each visit is a block that holds the camera's axis +Z on a direction of the celestial frame, with the camera's turn about it.
The time between two blocks is that of slew and settling; the message leaves the way of the slew to the spacecraft.
"""

from typing import Final
from xml.etree import ElementTree as Xml

from ground.options import ProductOptions
from ground.planning.schedule import Schedule
from ground.products.epochs import utc_text

ROOT_FRAME: Final = "GCRF"
CAMERA_FRAME: Final = "CAMERA"
DEFINITION: Final = "inertialPointing"


def prm_xml(schedule: Schedule, roll_deg: float, start_tai_ns: int, names: ProductOptions) -> bytes:
    """The message, UTF-8; its date of creation is the plan's start.

    roll_deg : turn of the camera about its boresight, 0 where its rows grow to the south.
    """
    root = Xml.Element("prm", {"id": "CCSDS_PRM_VERS", "version": "1.0"})
    header = Xml.SubElement(root, "header")
    _text(header, "CREATION_DATE", utc_text([start_tai_ns], 3)[0])
    _text(header, "ORIGINATOR", names.originator)
    segment = Xml.SubElement(Xml.SubElement(root, "body"), "segment")
    metadata = Xml.SubElement(segment, "metadata")
    starts = utc_text([visit.start_tai_ns for visit in schedule.visits], 6)
    ends = utc_text([visit.end_tai_ns for visit in schedule.visits], 6)
    _text(metadata, "TIME_SYSTEM", "UTC")
    _text(metadata, "OBJECT_ID", names.observer_id)
    _text(metadata, "OBJECT_NAME", names.observer_name)
    _text(metadata, "START_TIME", starts[0])
    _text(metadata, "STOP_TIME", ends[-1])
    _definition(metadata)
    timeline = Xml.SubElement(Xml.SubElement(segment, "data"), "timeline", {"frame": CAMERA_FRAME})
    for visit, start, end in zip(schedule.visits, starts, ends, strict=True):
        block = Xml.SubElement(timeline, "block", {"ref": "inertial"})
        _text(block, "blockStart", start)
        _text(block, "blockEnd", end)
        _direction(block, "boresight", CAMERA_FRAME, (0.0, 0.0, 1.0))
        _direction(block, "target", ROOT_FRAME, visit.boresight)
        _text(block, "phaseAngle", repr(float(roll_deg)), {"units": "deg"})
    Xml.indent(root)
    return bytes(Xml.tostring(root, encoding="UTF-8", xml_declaration=True)) + b"\n"


def _definition(metadata: Xml.Element) -> None:
    """Template 4-1. The phase angle is counted from celestial north to the camera's -Y, which points north where it is 0."""
    definition = Xml.SubElement(metadata, "definition", {"name": DEFINITION, "version": "1.0"})
    Xml.SubElement(definition, "frame", {"baseFrame": "none", "name": ROOT_FRAME})
    Xml.SubElement(definition, "frame", {"baseFrame": ROOT_FRAME, "name": CAMERA_FRAME})
    block = Xml.SubElement(definition, "block", {"name": "inertial"})
    Xml.SubElement(block, "startEpoch", {"localName": "blockStart"})
    Xml.SubElement(block, "endEpoch", {"localName": "blockEnd"})
    attitude = Xml.SubElement(block, "attitude")
    Xml.SubElement(attitude, "frameDir", {"localName": "boresight"})
    Xml.SubElement(attitude, "baseFrameDir", {"localName": "target"})
    phase = Xml.SubElement(attitude, "phaseAngle")
    _direction(phase, "frameDir", CAMERA_FRAME, (0.0, -1.0, 0.0))
    _direction(phase, "baseFrameDir", ROOT_FRAME, (0.0, 0.0, 1.0))
    Xml.SubElement(phase, "projAngle", {"localName": "phaseAngle"})


def _text(parent: Xml.Element, tag: str, text: str, attributes: dict[str, str] | None = None) -> None:
    Xml.SubElement(parent, tag, attributes or {}).text = text


def _direction(parent: Xml.Element, tag: str, frame: str, vector: tuple[float, float, float]) -> None:
    """A direction vector in Cartesian coordinates (table 3-10); its units are empty."""
    text = " ".join(f"{value:.9f}" for value in vector)
    _text(parent, tag, text, {"frame": frame, "coord": "cartesian", "units": ""})
