"""Orbit Parameter Messages (CCSDS 502.0-B-2): one state, with its covariance where it has one."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.errors import UserError
from sboc_e2e.score.published.axes import gcrs_from
from sboc_e2e.score.published.covariance_lines import COVARIANCE_KEYS, in_gcrs, symmetric
from sboc_e2e.score.published.epochs import tai_ns
from sboc_e2e.score.published.kvn import UnreadableProduct, read_kvn

Array = NDArray[np.float64]

_NUMBER: Final = re.compile(r"(\d+)$")
_STATE: Final = ("X", "Y", "Z", "X_DOT", "Y_DOT", "Z_DOT")


@dataclass(frozen=True, kw_only=True, eq=False)
class PublishedState:
    """tracklet_id : number at the end of OBJECT_ID (else of OBJECT_NAME), -1 without one. state (6,) km, km/s, GCRS axes.

    covariance : (6, 6) km2, km2/s, km2/s2, or None.
    """

    tracklet_id: int
    t_tai_ns: int
    state: Array
    covariance: Array | None


def read_opm(path: Path) -> PublishedState:
    """The state of a message. Raises UnreadableProduct."""
    message = read_kvn(path, "CCSDS_OPM_VERS")
    fields = {line.keyword: line for line in message.lines if line.keyword}
    for name in ("CENTER_NAME", "REF_FRAME", "TIME_SYSTEM", "EPOCH", *_STATE):
        if name not in fields:
            raise message.wrong(None, name)
    if fields["CENTER_NAME"].value.upper() != "EARTH":
        raise message.wrong(fields["CENTER_NAME"], "EARTH")
    state = np.array([message.numbers(fields[name], fields[name].value.split(), 1)[0] for name in _STATE])
    given = [name for name in COVARIANCE_KEYS if name in fields]
    if given and len(given) != len(COVARIANCE_KEYS):
        raise message.wrong(fields[given[0]], f"all {len(COVARIANCE_KEYS)} elements of the covariance")
    triangle = [message.numbers(fields[name], fields[name].value.split(), 1)[0] for name in given]
    axes_name = fields["REF_FRAME"].value
    try:
        axes = gcrs_from(axes_name)
        state = (state.reshape(2, 3) @ axes.T).ravel()
        cov_frame = fields["COV_REF_FRAME"].value if "COV_REF_FRAME" in fields else axes_name
        covariance = in_gcrs(symmetric(triangle), cov_frame, state[:3], state[3:]) if triangle else None
        epoch = int(tai_ns([fields["EPOCH"].value], fields["TIME_SYSTEM"].value)[0])
    except UserError as error:
        raise UnreadableProduct(f"{message.name}: {error}") from error
    names = (fields[name].value for name in ("OBJECT_ID", "OBJECT_NAME") if name in fields)
    numbers = [found.group(1) for found in map(_NUMBER.search, names) if found]
    return PublishedState(tracklet_id=int(numbers[0]) if numbers else -1, t_tai_ns=epoch, state=state, covariance=covariance)
