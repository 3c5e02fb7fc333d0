"""What a run shows, sent to the tools that listen: DS9, Aladin, TOPCAT through a SAMP hub on this machine."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from sboc_e2e.icd.errors import UserError
from sboc_e2e.view.run_frames import ShownFrame

IMAGE, TABLE, DS9 = "image.load.fits", "table.load.votable", "ds9.set"


@dataclass(kw_only=True)
class Hub:
    """A connection to the hub that runs on this machine; a context manager. Raises `UserError` where none runs."""

    client: Any = None

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
        self.client.disconnect()


def send(hub: Hub, written: Sequence[tuple[ShownFrame, Path, Path]]) -> int:
    """Images, tables and regions of frames to everybody who listens; returns how many messages somebody got."""
    heard = 0
    for frame, regions, streaks in written:
        if frame.file is not None:
            where = f"{frame.file.resolve().as_uri()}" + (f"#{frame.hdu}" if frame.hdu else "")
            heard += _notify(hub, IMAGE, {"url": where, "image-id": f"frame {frame.number}", "name": f"frame {frame.number}"})
        heard += _notify(hub, DS9, {"cmd": f"regions load {regions.resolve()}"})
        table = {"url": streaks.resolve().as_uri(), "table-id": f"streaks {frame.number}", "name": f"streaks {frame.number}"}
        heard += _notify(hub, TABLE, table)
    return heard


def _notify(hub: Hub, mtype: str, parameters: dict[str, str]) -> int:
    return len(hub.client.notify_all({"samp.mtype": mtype, "samp.params": parameters}))
