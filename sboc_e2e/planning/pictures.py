"""Pictures of a schedule: what is visited when, and where on the sky."""

import io
from typing import Final

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from ground.planning.schedule import Schedule

_STYLE: Final = {"font.size": 9, "axes.grid": True, "grid.alpha": 0.25}


def timeline_png(schedule: Schedule, start_tai_ns: int) -> bytes:
    """Gain, slews and targets of each visit over time."""
    hours = np.array([(visit.start_tai_ns - start_tai_ns) / 3.6e12 for visit in schedule.visits])
    boresight = np.array([visit.boresight for visit in schedule.visits]).reshape(-1, 3)
    turns = np.degrees(np.arccos(np.clip(np.sum(boresight[1:] * boresight[:-1], axis=1), -1.0, 1.0)))
    with mpl.rc_context(_STYLE):  # type: ignore[arg-type]  # matplotlib's names of settings are a literal type
        figure = Figure(figsize=(10.0, 5.0), layout="constrained")
        gain, count, slew = figure.subplots(3, 1, sharex=True)
        gain.plot(hours, [visit.gain for visit in schedule.visits], ".", ms=3)
        gain.set(ylabel="gain (nats)", title=f"{len(schedule.visits)} visits")
        count.plot(hours, [len(visit.targets) for visit in schedule.visits], ".", ms=3, color="C2")
        count.set(ylabel="targets")
        slew.plot(hours[1:], turns, ".", ms=3, color="C1")
        slew.set(ylabel="slew before (deg)", xlabel="time from the start (h)")
        return _png(figure)


def sky_png(schedule: Schedule, start_tai_ns: int) -> bytes:
    """Fields on the whole sky (Hammer-Aitoff), coloured by time; right ascension grows to the left."""
    boresight = np.array([visit.boresight for visit in schedule.visits]).reshape(-1, 3)
    hours = [(visit.start_tai_ns - start_tai_ns) / 3.6e12 for visit in schedule.visits]
    ra = np.arctan2(boresight[:, 1], boresight[:, 0])
    with mpl.rc_context(_STYLE):  # type: ignore[arg-type]  # as above
        figure = Figure(figsize=(9.0, 5.0), layout="constrained")
        sky = figure.add_subplot(projection="hammer")
        points = sky.scatter(-ra, np.arcsin(boresight[:, 2]), c=hours, s=8, cmap="viridis")
        sky.set_xticks(np.radians(np.arange(-150, 151, 30)), [f"{-k % 360}°" for k in range(-150, 151, 30)])
        figure.colorbar(points, ax=sky, label="time from the start (h)", shrink=0.7)
        return _png(figure)


def _png(figure: Figure) -> bytes:
    """The picture without a date, so that bytes repeat."""
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=110, metadata={"Software": None})
    return out.getvalue()
