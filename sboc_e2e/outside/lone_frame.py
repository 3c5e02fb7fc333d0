"""A large frame alone: a process of its own does the on-board half, while this one makes ready for ground.

Each loads the libraries of its half beside the other. The process begins before there are threads, and before most libraries are
loaded, of which this module therefore names few.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from sboc_e2e.outside import second_processor
from sboc_e2e.outside.first_frame import FirstFrame
from sboc_e2e.outside.fits_frames import FitsFolder, wcs_of
from sboc_e2e.outside.memory import keep_freed_memory, uncollected
from sboc_e2e.outside.star_width import star_sigma_px
from sboc_e2e.run.progress import Progress, Silent

if TYPE_CHECKING:
    from sboc_e2e.catalogue import StarCatalogue
    from sboc_e2e.icd.frame import NominalCamera
    from sboc_e2e.outside.aboard import Flight, Orders
    from sboc_e2e.scenario import Scenario


@contextmanager
def begun(source: FitsFolder, *, alone: bool, guessed: bool) -> "Iterator[LoneFrame | FirstFrame]":
    """The first frame of a source, in a process of its own where it is large and the only one; that process has then begun.

    alone : nothing but the on-board half needs the frame. guessed : whether the camera is to be guessed. Raises `UserError` for a
    source without frames.
    """
    places = source.places
    if not (alone and len(places) == 1 and second_processor.is_worth(places[0].rows * places[0].cols)):
        yield FirstFrame.of(source)
        return
    with second_processor.companion(_aboard, source, guessed) as aboard:
        yield LoneFrame(source, aboard)


class LoneFrame:
    """The on-board half of a frame alone, as this process sees it."""

    threaded = False

    def __init__(self, source: FitsFolder, aboard: second_processor.Companion) -> None:
        self.source = source
        self._aboard = aboard

    def begin(self, orders: "Orders") -> None:
        """Give orders."""
        self._orders = orders
        self._aboard.tell(orders)

    def rehearse(self, _begin: Callable[..., Any], scenario: "Scenario", catalogue: "StarCatalogue") -> None:
        """Make ground ready."""
        from sboc_e2e.outside.ground_rehearsal import rehearse_ground

        rehearse_ground(scenario, catalogue)

    def camera(self) -> "NominalCamera":
        """The nominal camera. Raises `UserError` where the frame cannot be read."""
        camera: NominalCamera = self._aboard.reply()
        return camera

    def fly(self, _camera: "NominalCamera", progress: Progress, _focal_px: object = None) -> "Flight":
        """What the half leaves; its packets go into the run's files."""
        from sboc_e2e.run.onboard_stage import keep

        packets: list[bytes]
        flight: Flight
        packets, flight = self._aboard.reply()
        for position, each in enumerate(packets):
            keep(self._orders.run, position, each)
        progress.advance()
        # A WCS that went from process to process would have rounded numbers.
        flight.seen.wcs.update({number: wcs_of(self.source.places[0]) for number in flight.seen.wcs})
        return flight


def _aboard(orders: "Callable[[], Orders]", source: FitsFolder, guessed: bool) -> Iterator[Any]:
    """The on-board half: gives the camera, then the packets and the flight. orders : waits for them."""
    with uncollected():
        first = FirstFrame.of(source)  # which is read beside what follows
        from ground.vetting.sides import SkyMap
        from sboc_e2e.outside import aboard

        SkyMap.of(np.zeros((64, 64), dtype=np.int32), np.zeros((64, 64), dtype=np.uint8))  # the first kernel takes 0.2 s to load
    first.wait()
    keep_freed_memory()
    width = star_sigma_px(np.asarray(first.frame.frame.pixels, dtype=np.float32)) if guessed else None
    ordered = orders()
    camera = aboard.nominal_camera(ordered, first.frame, lambda: width)
    yield camera
    packets: list[bytes] = []
    flight = aboard.fly(first, ordered, camera, Silent(), keep=lambda _, each: packets.append(each))
    yield packets, replace(flight, seen=replace(flight.seen, wcs=dict.fromkeys(flight.seen.wcs)))
