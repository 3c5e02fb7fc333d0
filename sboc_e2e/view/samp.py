"""What a run shows, sent to the tools that listen: DS9, Aladin, TOPCAT through a SAMP hub on this machine."""

import contextlib
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from queue import Empty, Queue
from types import TracebackType
from typing import Any, Final, Self
from xmlrpc.client import Fault

from sboc_e2e.icd.errors import UserError
from sboc_e2e.view.run_frames import ShownFrame

IMAGE, TABLE, DS9 = "image.load.fits", "table.load.votable", "ds9.set"

ANSWER_S: Final = 30
"""So long a tool may take for one file; it answers when it has loaded it."""


@dataclass(kw_only=True)
class Hub:
    """A connection to the hub that runs on this machine; a context manager. Raises `UserError` where none runs."""

    client: Any = None
    taken: int = 0
    """Messages that a tool took."""
    remarks: list[str] = field(default_factory=list)
    """A line for each message that a tool refused, and each tool that did not answer."""
    silent: set[str] = field(default_factory=set)
    calls: int = 0

    def __enter__(self) -> Self:
        # Only who sends waits a tenth of a second for these.
        from astropy.utils.exceptions import AstropyDeprecationWarning

        with warnings.catch_warnings():
            # since 8.0 astropy names pyvo as the future home of the same code; the locked version has it here
            warnings.simplefilter("ignore", AstropyDeprecationWarning)
            from astropy.samp import SAMPHubError, SAMPIntegratedClient

        client = SAMPIntegratedClient(name="sboc", description="frames and streaks of a run")
        try:
            client.connect()
        except (SAMPHubError, OSError) as error:
            raise UserError("--samp: no SAMP hub runs on this machine; start Aladin or TOPCAT, or DS9 with a hub") from error
        self.client = client
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        with contextlib.suppress(OSError, Fault):  # the hub may have gone
            self.client.disconnect()

    def call(self, mtype: str, parameters: dict[str, str]) -> None:
        """A message to each tool that listens for its type; returns when all have answered.

        A notification need not have been passed on when its sender leaves, and a hub then drops it: astropy's does. So tools are
        called, and answer (SAMP 1.3, section 3.2). One that does not answer within `ANSWER_S` gets no further message. Raises
        `UserError` where the hub has gone.
        """
        answers: Queue[tuple[str, dict[str, Any]]] = Queue()
        self.calls += 1
        tag = f"sboc-{self.calls}"
        self.client.bind_receive_response(tag, lambda _key, tool, _tag, answer: answers.put((tool, answer)))
        waiting = set[str]()
        try:
            waiting |= set(self.client.get_subscribed_clients(mtype)) - self.silent
            for tool in waiting:
                self.client.call(tool, tag, {"samp.mtype": mtype, "samp.params": parameters})
            while waiting:
                tool, answer = answers.get(timeout=ANSWER_S)
                waiting.remove(tool)
                if answer.get("samp.status") == "samp.error":
                    why = answer.get("samp.error", {}).get("samp.errortxt", "no reason given")
                    self.remarks.append(f"{self._name(tool)} refused {mtype}: {why}")
                else:
                    self.taken += 1
        except (Empty, Fault):  # it is busy, or has left
            self.silent |= waiting
            self.remarks += [
                f"{self._name(tool)} did not answer {mtype} within {ANSWER_S} s, and got nothing more" for tool in waiting
            ]
        except OSError as error:
            raise UserError(f"--samp: the hub stopped while files were sent; {self.taken} messages were taken") from error
        finally:
            self.client.unbind_receive_response(tag)

    def _name(self, tool: str) -> str:
        try:
            return str(self.client.get_metadata(tool).get("samp.name", tool))
        except (Fault, OSError):
            return tool  # it has left meanwhile, or the hub has


def send(hub: Hub, written: Sequence[tuple[ShownFrame, Path, Path]]) -> None:
    """Images, tables and regions of frames to everybody who listens; the hub keeps how many messages were taken, and remarks."""
    for frame, regions, streaks in written:
        if frame.file is not None:
            where = f"{frame.file.resolve().as_uri()}" + (f"#{frame.hdu}" if frame.hdu else "")
            hub.call(IMAGE, {"url": where, "image-id": f"frame {frame.number}", "name": f"frame {frame.number}"})
        hub.call(DS9, {"cmd": f"regions load {regions.resolve()}"})
        table = {"url": streaks.resolve().as_uri(), "table-id": f"streaks {frame.number}", "name": f"streaks {frame.number}"}
        hub.call(TABLE, table)
