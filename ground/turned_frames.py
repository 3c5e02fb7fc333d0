"""Frames of a run with the rates at which the camera turned, from the attitudes of all frames."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from ground.on_demand import OnDemand
from ground.records import FrameProducts
from ground.sky.pixel_sky import SolvedSky
from ground.sky.turning import Attitude, Rate, rates_of
from ground.streak_rows import StreakRows

FRAMES_TURNED: Final = 64
"""Number of frames with final rates that are kept in memory."""


def turned_frames(
    products: Sequence[FrameProducts], attitudes: Sequence[Attitude]
) -> tuple[Sequence[FrameProducts], Sequence[Rate]]:
    """The frames with these rates in their solutions and streaks, made on demand; and the rates."""
    order = sorted(range(len(attitudes)), key=lambda k: attitudes[k].tai_ns)
    in_order = dict(zip(order, rates_of([attitudes[k] for k in order]), strict=True))
    rates = [in_order[k] for k in range(len(attitudes))]

    def turned(k: int) -> FrameProducts:
        product, rate = products[k], rates[k].rate_rad_s
        if product.wcs is not None or not attitudes[k].solved:
            return product
        solution = replace(product.solution, rate_rad_s=rate)
        turn_rad_s = SolvedSky(header=product.header, solution=solution).turn_rad_s
        streaks = product.streaks if isinstance(product.streaks, StreakRows) else StreakRows.of(product.streaks)
        return replace(product, solution=solution, streaks=streaks.turned(turn_rad_s))

    return OnDemand(len(products), turned, keep=FRAMES_TURNED), rates
