"""A camera on its platform: orbit or site, pointing, jitter, shutter, clock and telemetry of the options."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from simulator.camera import Camera
from simulator.options import SimulatorOptions
from simulator.platform import earth
from simulator.platform.carrier import Carrier
from simulator.platform.jitter import make_jitter
from simulator.platform.observer import OrbitingObserver, SiteObserver
from simulator.platform.pointing import commanded_attitude
from simulator.platform.shutter import ShutterOptions

Array = NDArray[np.float64]


def carrier_of(
    options: SimulatorOptions,
    shutter: ShutterOptions,
    observer: OrbitingObserver | SiteObserver,
    camera: Camera,
    seed: int,
    target: Callable[[int], Array] | None = None,
) -> Carrier:
    """The platform that carries a camera. target : direction that the law `object` follows."""
    epoch = earth.tai_ns_of_utc(options.epoch_utc)
    return Carrier(
        epoch_tai_ns=epoch,
        seed=seed,
        frame_rate_hz=options.frame_rate_hz,
        observer=observer,
        attitude=commanded_attitude(options.pointing, observer, epoch, target),
        jitter=make_jitter(options.jitter, seed),
        shutter=shutter,
        clock=options.clock,
        telemetry=options.telemetry,
        rows=camera.shape[0],
        row_step=camera.binning.rows,
    )
