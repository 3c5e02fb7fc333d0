"""What a response depends on: camera, software and exposures, but not where it flies, looks, or how large its field is."""

import hashlib
import json
from collections.abc import Mapping
from typing import Any, Final

from sboc_e2e.scenario import Scenario, option_models
from simulator.options import SimulatorOptions

TABLES: Final = ("instrument", "psf", "sensor", "shutter", "frame_rate", "jitter", "onboard", "ground")
"""Tables of a scenario that decide how a trail of given S/N and length is found and measured."""

ELSEWHERE: Final = frozenset({"window"})
"""Keys of the sensor that decide which part of the sky is seen, not how."""


def description(scenario: Scenario) -> dict[str, Any]:
    """Keys and values that decide a response, flat: ``{"instrument.aperture": "0.2 m", ...}``."""
    document = scenario.document()
    found: dict[str, Any] = {}
    for name in TABLES:
        if name in document:
            _flatten(name, document[name], found)
    return found


def _flatten(where: str, node: Any, found: dict[str, Any]) -> None:
    """Leaves of nested tables by their dotted names."""
    if not isinstance(node, Mapping):
        found[where] = node
        return
    for key, value in node.items():
        if key not in ELSEWHERE:
            _flatten(f"{where}.{key}", value, found)


def fingerprint(described: Mapping[str, Any]) -> str:
    """Digest of a description."""
    return hashlib.sha256(json.dumps(described, sort_keys=True).encode()).hexdigest()[:16]


def camera_defaults() -> dict[str, Any]:
    """Keys of the camera and their defaults, flat. Steps of board and ground are not in it."""
    document = option_models.to_document(SimulatorOptions())
    found: dict[str, Any] = {}
    for name in TABLES:
        if name in document:
            _flatten(name, document[name], found)
    return found


def first_difference(mine: Mapping[str, Any], theirs: Mapping[str, Any], defaults: Mapping[str, Any] | None = None) -> str | None:
    """The first key in which two descriptions differ, in words; None where they agree.

    defaults : values of keys that are younger than `theirs`. New effects of the camera are off by default, so that a camera
    measured before the key existed is the one that has the default now.
    """
    for key in sorted({*mine, *theirs}):
        younger = defaults is not None and key not in theirs and key in defaults
        known = defaults[key] if defaults is not None and younger else theirs.get(key)
        if mine.get(key) != known:
            return f"{key} is {mine.get(key, 'absent')} here and {theirs.get(key, 'absent')} there"
    return None
