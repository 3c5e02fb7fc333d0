"""`onboard.tracker: joint`: trails too faint for any single frame, found in several together.

Segments that a frame shows at S/N 4.1, below the detector's threshold, are pointers. Each foretells in both senses of motion
where the object's trail lies in the frames around. The sum over all frames is compared with the sums that noise alone makes.
"""

import math
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from onboard.image import registration
from onboard.track import joint_filter, trail_sums
from onboard.track.false_alarms import independent_tracks, threshold_sigma
from onboard.track.frames import Frames, halved_transforms
from onboard.track.kept_search import NO_SEEDS, NONE_REMOVED, NONE_WAIT, KeptSearch, exposures_from, from_centre
from onboard.track.packed import half_of, packed
from onboard.track.particles import blank_hits
from onboard.track.records import plausible, stands, track_of
from onboard.track.removed_stars import by_row
from onboard.track.same import most_alike, same_object, tells_nothing_new
from onboard.track.star_rings import take_off
from onboard.track.start import dearer
from onboard.track.wide_look import AWAY
from sboc_e2e.icd.signals import DetectorView, Track, TrackerView

LONGEST_PX: Final = 2000.0
"""Trails of one exposure that the false-alarm rate is reckoned for; longer seeds are not followed."""

FOLLOWED: Final = (0.05, 0.02, 0.008)
"""Share of noise's tracks of two, of three and of more frames above a threshold that the search finds, as it begins at seeds: 26,
11 and 4 in 256 whole frames, half of them with stars, where 512 of each number were to be expected (seeds 57000 and 57001, before
`removed_stars`). None of the 41 had five frames or more."""

ALLOWED: Final = (1.2, 0.3, 0.4)
"""Share of `false_tracks` that tracks of two, of three and of each greater number of frames may make, by `FOLLOWED`. An object in
two frames has no other chance; one in four may be found in three of them as well. `FOLLOWED` was measured before tracks had to be
bright on their own lines, and is too large since then, so that the sum may exceed one. Ground tells four in five tracks of noise
by their light and publishes the rest (`ground.link.noise_tracks`). With half as much a track of two frames needed 0.09 more."""

WORK_PER_PX: Final = 30.0  # as many as a frame's nominal work (`onboard.work`)
LEAST_WORK: Final = 50_000_000
"""Pixels read about seeds, per pixel of the frame, but never fewer."""

OLDER: Final = 3
"""Frames before the window that are kept at half resolution, 2 MB each, for tracks that reach its oldest frame: of eight frames a
window of seven has four where the seed is in the last."""

AGAIN: Final = 1
"""Place in the window where seeds that fell short are followed again: five later frames are there then, not three."""

OWN_LOSS: Final = 0.1
"""Less S/N that a seed may have in its own frame when it is looked at there, at half resolution and on other ends."""

LOOK_PER_PX: Final = 110.0
"""Pixels that the first look reads for each px of a seed: sixteen lanes of half resolution, 1.75 + 2 x 5.75 + 0.5 lengths."""

BAND_PX: Final = 128.0
"""Height of a band of seeds that are looked at in turn: 64 lines of three halved images (200 kB) stay in the cache."""


@dataclass(frozen=True, kw_only=True, eq=False)
class JointState:
    """The window, oldest first; how many of its frames, from the oldest, have had their seeds followed; the tracks seen in it.

    psf_sigma_px : nominal width of the PSF; 0 before the first frame. older : the frames before the window, their images at half
    resolution.
    """

    window: tuple[KeptSearch, ...] = ()
    followed: int = 0
    tracks: tuple[Track, ...] = ()
    next_number: int = 0
    psf_sigma_px: float = 0.0
    older: tuple[KeptSearch, ...] = ()


@dataclass(frozen=True, kw_only=True)
class JointTracker:
    """Straight tracks through `window` frames, found from segments of S/N `seed_sigma` in one of them."""

    window: int = field(default=7, metadata={"doc": "frames that are searched together", "min": 3, "max": 15})
    seed_sigma: float = field(default=4.1, metadata={"doc": "least S/N of a segment that is followed", "min": 4.0, "max": 20.0})
    false_tracks: float = field(
        default=0.02, metadata={"doc": "false tracks per frame that noise may make", "min": 1e-9, "max": 10.0}
    )
    first_margin: float = field(
        default=2.7, metadata={"doc": "S/N by which the first look may fall short", "min": 0.0, "max": 10.0}
    )

    @property
    def window_frames(self) -> int:
        """The chain keeps as many frames as are searched."""
        return self.window

    def initial_state(self) -> JointState:
        """Nothing seen."""
        return JointState()

    def track(self, state: JointState, view: TrackerView) -> tuple[JointState, tuple[Track, ...]]:
        """Tracks about the frame half a window ago; about all that wait when the window ends."""
        if view.searched is None:
            return replace(JointState(), next_number=state.next_number), ()
        found: list[Track] = []
        if view.transform is None:
            state, rest = self._followed(state, len(state.window))
            found += rest
            state = JointState(next_number=state.next_number)
        new = KeptSearch(
            header=view.view.header,
            image=packed(cleaned(view.searched.smooth, view.view)),
            seeds=view.searched.seeds.astype(np.float32),
            transform=registration.IDENTITY if view.transform is None else view.transform,
            trails=np.array([(d.row0, d.col0, d.row1, d.col1) for d in view.detections]).reshape(-1, 4),
            removed=by_row(view.searched.removed),
        )
        state = replace(state, window=(*state.window, new), psf_sigma_px=view.view.psf_sigma_px)
        state, now = self._followed(state, len(state.window) - (self.window - 1) // 2)
        return self._without_oldest(state) if len(state.window) == self.window else state, tuple(found + now)

    def finish(self, state: JointState) -> tuple[Track, ...]:
        """Tracks about all frames that wait for later ones."""
        return tuple(self._followed(state, len(state.window))[1])

    def _without_oldest(self, state: JointState) -> JointState:
        """The state with one frame less, and without the tracks that lie in none of the others."""
        window = state.window[1:]
        tracks = tuple(t for t in state.tracks if t.members[-1].frame >= window[0].header.frame)
        oldest = state.window[0]
        older = (
            *state.older,
            replace(oldest, image=half_of(oldest.image), waiting=NONE_WAIT, halves=None, removed=NONE_REMOVED),
        )[-OLDER:]
        return replace(state, window=window, followed=max(0, state.followed - 1), tracks=tracks, older=older)

    def _followed(self, state: JointState, stop: int) -> tuple[JointState, list[Track]]:
        """Follow the seeds of the window's frames up to the one at `stop`; the state after it and the tracks found."""
        found, psf_sigma_px = list[Track](), state.psf_sigma_px
        for centre in range(state.followed, stop):
            known, number = {t.number: t for t in state.tracks}, state.next_number
            window = tuple(  # the look at the frames around needs halves
                frame.with_halves() if abs(k - centre) <= AWAY else replace(frame, halves=None)
                for k, frame in enumerate(state.window)
            )
            older = state.older
            window, more, number = self._numbered(window, older, centre, psf_sigma_px, known, number, kept_seeds=False)
            found += more
            if len(window) == self.window and len(window[AGAIN].waiting):
                window, more, number = self._numbered(window, older, AGAIN, psf_sigma_px, known, number, kept_seeds=True)
                found += more
            state = replace(state, window=window, tracks=tuple(known.values()), next_number=number, followed=centre + 1)
        return replace(state, window=self._put_by(state.window, state.followed)), found

    def _put_by(self, window: tuple[KeptSearch, ...], followed: int) -> tuple[KeptSearch, ...]:
        """The window while the next frame is searched: halves of frames two before the next to be followed stay."""
        return tuple(replace(frame, halves=None) if k < followed - AWAY else frame for k, frame in enumerate(window))

    def _numbered(
        self,
        window: tuple[KeptSearch, ...],
        older: tuple[KeptSearch, ...],
        centre: int,
        psf_sigma_px: float,
        known: dict[int, Track],
        number: int,
        *,
        kept_seeds: bool,
    ) -> tuple[tuple[KeptSearch, ...], list[Track], int]:
        """Tracks through one frame's seeds with the numbers of their objects, the next free number, and the window after it.

        known : tracks by number; grows. kept_seeds : those that wait are followed, not those that the frame came with.
        """
        found: list[Track] = []
        asked = self._asked(window, centre, psf_sigma_px)
        tracks, waiting = self._about(window, older, centre, psf_sigma_px, asked, kept_seeds)
        for track in tracks:
            same = most_alike(known.values(), track, asked)
            if same is None:
                track, number = replace(track, number=number), number + 1
            elif any(t is same for t in found) or tells_nothing_new(same, track):
                continue
            else:
                track = replace(track, number=same.number)
            known[track.number] = track
            found.append(track)
        window = tuple(
            replace(frame, seeds=NO_SEEDS, waiting=waiting) if k == centre else frame for k, frame in enumerate(window)
        )
        return window, found, number

    def _asked(self, window: tuple[KeptSearch, ...], centre: int, psf_sigma_px: float) -> NDArray[np.float64]:
        """Joint S/N asked of a track of n frames of a window, at index n."""
        taus = exposures_from(window, centre, from_centre(window, centre))
        period = float(np.median(np.abs(np.diff(taus)))) if len(taus) > 1 else 1.0
        return self.thresholds(window[centre].shape, period, psf_sigma_px)

    def _about(
        self,
        window: tuple[KeptSearch, ...],
        older: tuple[KeptSearch, ...],
        centre: int,
        psf_sigma_px: float,
        asked: NDArray[np.float64],
        kept_seeds: bool,
    ) -> tuple[list[Track], NDArray[np.float64]]:
        """Tracks through seeds of one frame of the window, best first, each object once; and the seeds that wait.

        asked : see `_asked`. kept_seeds : see `_numbered`.
        """
        kept = window[centre]
        most_work = max(LEAST_WORK, round(WORK_PER_PX * kept.shape[0] * kept.shape[1]))
        seeds, senses = kept.waiting[:, :5], np.ascontiguousarray(kept.waiting[:, 5])
        if not kept_seeds:
            every = kept.seeds.astype(np.float64)
            px = np.hypot(*(every[:, 2:4] - every[:, :2]).T)
            seeds, px = every[px < LONGEST_PX], px[px < LONGEST_PX]
            seeds = by_place(seeds[np.argsort(dearer(px) - seeds[:, 4], kind="stable")], most_work)
            senses = np.zeros(len(seeds))
        if len(window) < 2 or not len(seeds):
            return [], NONE_WAIT
        frames, place = older + window, len(older) + centre
        transforms = from_centre(frames, place)
        taus = exposures_from(frames, place, transforms)
        # one kernel for any number of frames: the tuple is filled up to the largest
        missing = OLDER + self.window - len(frames)
        filled = frames + (window[0],) * missing
        own = (kept.image, kept.image)
        near = [frames[k].halves or own if 0 <= k < len(frames) else own for k in range(place - AWAY, place + AWAY + 1)]
        to_each = np.ascontiguousarray(np.concatenate([transforms, np.repeat(transforms[:1], missing, axis=0)]))
        followed = Frames(
            transforms=to_each,
            half_transforms=halved_transforms(to_each),
            taus=np.concatenate([taus, np.zeros(missing)]),
            n_old=len(older),
            n_frames=len(frames),
            centre=place,
            psf_sigma_px=psf_sigma_px,
            threshold=asked,
        )
        table, lines, waiting, _, _ = joint_filter.follow(
            followed,
            tuple(frame.image for frame in filled),
            tuple(half for half, _ in near),
            tuple(flat for _, flat in near),
            np.ascontiguousarray(seeds),
            senses,
            self.first_margin,
            self.seed_sigma - OWN_LOSS,
            most_work,
            trail_sums.work_space(OLDER + self.window),
        )
        tracks: list[Track] = []
        best_first = np.argsort(-table[:, 7], kind="stable")
        for row, line in zip(table[best_first], lines[best_first], strict=True):
            if not plausible(row):
                continue
            track = track_of(row, line, frames, transforms, taus, len(older))
            if track is None or any(same_object(t, track, asked) for t in tracks):
                continue
            if stands(track, row, frames, transforms, len(older), asked, psf_sigma_px):
                tracks.append(track)
        return tracks, waiting

    def thresholds(self, shape: tuple[int, int], period_over_exposure: float, psf_sigma_px: float) -> NDArray[np.float64]:
        """Joint S/N asked of a track of n frames, at index n; (OLDER + window + 1,)."""
        longest = min(LONGEST_PX, math.hypot(*shape))
        out = np.full(OLDER + self.window + 1, np.inf)
        for n in range(2, len(out)):
            volume = independent_tracks(
                n,
                area_px=float(shape[0] * shape[1]),
                longest_px=longest,
                period_over_exposure=period_over_exposure,
                psf_sigma_px=psf_sigma_px,
            )
            followed, allowed = (shares[min(n, len(shares) + 1) - 2] for shares in (FOLLOWED, ALLOWED))
            out[n] = threshold_sigma(followed * volume, allowed * self.false_tracks)
        return out


def cleaned(smooth: NDArray[np.int8], view: DetectorView) -> NDArray[np.int8]:
    """`Searched.smooth` without particle hits and without what stars leave around them."""
    out = smooth.copy()
    take_off(out, view.stars)
    blank_hits(out, view.psf_sigma_px)
    out.flags.writeable = False  # compiled code has one kind of image
    return out


def by_place(seeds: NDArray[np.float64], most_work: int) -> NDArray[np.float64]:
    """As many seeds, best first, as the work allows, in bands of the frame: neighbours read the same lines of memory."""
    way = np.abs(seeds[:, 2:4] - seeds[:, :2])
    seeds, way = (x[np.cumsum(LOOK_PER_PX * way.max(axis=1, initial=0.0)) < most_work] for x in (seeds, way))
    steep = way[:, 0] >= way[:, 1]
    middle = 0.5 * (seeds[:, :2] + seeds[:, 2:4])
    major, minor = np.where(steep, middle.T, middle.T[::-1])
    return np.ascontiguousarray(seeds[np.lexsort((minor, major // BAND_PX, steep))])
