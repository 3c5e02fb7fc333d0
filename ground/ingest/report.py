"""Loss report: packets that arrived, packets that are missing, and defects."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass(frozen=True, kw_only=True)
class ApidReport:
    """Packets of one kind. missing : ranges (first, last) of sequence counts, unwrapped from the first one received."""

    received: int
    duplicates: int
    missing: tuple[tuple[int, int], ...]
    n_missing: int
    bytes: int


@dataclass(frozen=True, kw_only=True)
class IngestReport:
    """Loss report of a downlink; JSON-able by `as_dict`.

    run_id : the run that was decoded; None when there was no intact packet.
    foreign_runs : intact packets of other runs, by run id. corrupted : packets with a wrong checksum; truncated :
    packets that the end of the stream cut; garbage_bytes : bytes outside intact packets; other_contract : intact packets
    of another contract version, or with fields out of range. conflicts : packets with the same place in a frame but
    other content.
    frames_complete, frames_incomplete : frame numbers; frames_missing : numbers between the first and the last frame without any
    packet; frames_unusable : frames with packets, but not enough to be built.
    renumbered : by the number they have in products, number on the link and start (TAI ns) of frames whose number an earlier
    frame of the run has.
    missing_segments : known number of missing packets of each kind, per incomplete frame. A whole frame without any packet shows
    in the sequence counts of `apids` only.
    decode_failures : one line for each intact packet whose content could not be decoded.
    work_shed : items that the on-board work limit left undone, by kind, over all frames that say so.
    fit_failures : regions whose pixels allowed no fit, by the reason.
    """

    run_id: int | None
    n_bytes: int
    apids: Mapping[str, ApidReport]
    foreign_runs: Mapping[int, int]
    corrupted: int
    truncated: int
    garbage_bytes: int
    other_contract: int
    conflicts: int
    frames_complete: tuple[int, ...]
    frames_incomplete: tuple[int, ...]
    frames_missing: tuple[tuple[int, int], ...]
    frames_unusable: tuple[int, ...]
    renumbered: Mapping[int, tuple[int, int]]
    missing_segments: Mapping[int, Mapping[str, int]]
    decode_failures: tuple[str, ...]
    n_decode_failures: int
    work_shed: Mapping[str, int] = field(default_factory=dict)
    fit_failures: Mapping[str, int] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Plain dictionaries, lists, numbers and strings."""
        plain = asdict(self)
        plain["foreign_runs"] = {str(run): n for run, n in self.foreign_runs.items()}
        plain["renumbered"] = {
            str(own): {"frame": number, "t_start_tai_ns": t_start} for own, (number, t_start) in self.renumbered.items()
        }
        plain["missing_segments"] = {str(frame): dict(kinds) for frame, kinds in self.missing_segments.items()}
        return plain
