"""`onboard.detector: line_integral`: matched-filter line integrals over all positions, angles and lengths.

noise-normalise, remove stars -> smooth by the PSF, bin 2 x 2 -> sums over dyadic segments of all lines -> candidates above a
low threshold -> continuous maximum of the matched filter at full resolution -> threshold, uniformity, static-sky test.
Movers too short for a line (star-like to ~10 px) come from the star list: what was not there in the preceding frame.
"""

import math
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from onboard.detect import star_mask, whiten
from onboard.detect.line_integral import (
    context,
    dyadic,
    fragments,
    local_noise,
    resolve,
    sharpness,
    static_sky,
    strip,
    track_pieces,
    trailed_sky,
    trains,
    varied,
)
from onboard.detect.line_integral.kept_frame import KeptFrame, kept
from onboard.detect.line_integral.movers import particle_hits, short_detections, slow_movers, stays_above_earlier
from onboard.detect.line_integral.segments import (
    MAX_TRAILS,
    line_detection,
    seed_ends,
    with_blurred_ends,
    with_unclipped_snr,
    within_work,
)
from onboard.detect.line_integral.star_removal import POINT_CLIP_SIGMA, TILE_PX, WorkingImages, working_images
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.signals import Detection, DetectorView, Searched
from sboc_e2e.icd.work import Work

MIN_ROWS: Final = 4
"""Shortest blocks searched, in rows of the half-resolution image (8 px)."""

MAX_CANDIDATES: Final = 50_000
"""Room for candidates of one quadrant of angles."""

COLLECTED_SHARE: Final = 0.5
"""Sums above the threshold take no more than this of the work for candidates: hardly ever a tenth."""

FIRST_MARGIN: Final = 1.4
"""The corridor search on whole pixels may fall so far short of the final S/N."""

MAX_SEEDS: Final = 60_000
"""Room for segments that a tracker may go on from."""

SEED_LOSS: Final = 0.25
"""A seed's S/N on the coarse lattice may fall so far short of what the best ends make of it."""

BLEND_PX: Final = 25.0
"""Blends of stars look like trails up to this length in a single frame."""
BRIGHT_SNR: Final = 20.0
"""S/N from which shorter lines are reported where `blend_px` says so. Fainter ones, followed, ran over trails beside them."""

STORM_ENTRIES: Final = 1000
"""New star-list entries above which a particle storm raises the threshold."""

MOST_HITS: Final = 2000
"""Sharp points that are looked at: a hundred tracks leave about a thousand."""


@dataclass(frozen=True, kw_only=True)
class LineIntegralDetector:
    """Detects trails whose matched-filter S/N exceeds `n_sigma`, whatever their length, angle and position.

    A bank of all segments needs 7.0 in pure noise for 0.1 false detections per 4096 x 4096 px. What is left of faint stars makes
    the noise of a line 3 % larger in a field of 25,000 stars above S/N 8, hence the default of 7.2.

    Without a preceding frame whose stars can be matched, aligned faint stars cannot be told from short trails, so
    `single_frame_margin` is added to the threshold of trails under 60 px and nothing as short as a blend of stars is reported.
    Where stars trail it is added to that of every line.
    """

    n_sigma: float = field(default=7.2, metadata={"doc": "matched-filter S/N of a detection", "min": 4.0, "max": 100.0})
    coarse_sigma: float = field(
        default=4.5, metadata={"doc": "S/N on the coarse lattice worth refining", "min": 3.5, "max": 20.0}
    )
    clip_sigma: float = field(default=3.0, metadata={"doc": "clip of the PSF-smoothed image", "min": 2.0, "max": 7.0})
    halo_px: float = field(
        default=1.0,
        metadata={
            "doc": "star mask growth per sqrt(S/N / 100) up to S/N 1000; halos of brighter stars are measured",
            "min": 0.0,
            "max": 20.0,
        },
    )
    min_length_px: float = field(default=10.0, metadata={"doc": "least length of a line", "min": 4.0, "max": 1000.0})
    single_frame_margin: float = field(
        default=2.0, metadata={"doc": "added to n_sigma below 60 px when no earlier frame helps", "min": 0.0, "max": 20.0}
    )
    short_margin: float = field(
        default=1.4,
        metadata={
            "doc": "added to n_sigma for star-like trails, falling to 0 at 20 px: faint stars vary",
            "min": 0.0,
            "max": 20.0,
        },
    )
    blend_px: float = field(
        default=BLEND_PX,
        metadata={"doc": "least length of a line, however bright, when no earlier frame helps", "min": 4.0, "max": 1000.0},
    )
    reach_px: float = field(default=300.0, metadata={"doc": "largest shift of stars between frames", "min": 0.0, "max": 5000.0})
    held_beside: bool = field(
        default=False,
        metadata={"doc": "light beyond a trail's ends must exceed that of lines beside it: the sky is not known to be even"},
    )
    max_detections: int = field(
        default=200, metadata={"doc": "most detections of a frame, particle hits last", "min": 1, "max": 10000}
    )

    @property
    def history_frames(self) -> int:
        """The preceding frame tells stars from movers."""
        return 1

    def remembered(self, view: DetectorView) -> KeptFrame:
        """The history holds a fifth of a view's bytes."""
        return kept(view)

    def detect(self, view: DetectorView) -> tuple[Detection, ...]:
        """Detections by falling S/N; particle hits (flagged) after everything else."""
        lines = self._lines(view, None)
        return () if lines is None else self._judged(view, lines)

    def detect_in_white_noise(self, view: DetectorView) -> tuple[tuple[Detection, ...], tuple[Detection, ...]]:
        """Detections whose thresholds the lines beside them do not raise, so that structure of the sky counts in full.

        And what `detect` gives, by the same search.
        """
        lines = self._lines(view, None)
        if lines is None:
            return (), ()
        work = replace(view.work, done=dict(view.work.done), shed=dict(view.work.shed))
        own_mask = replace(lines, images=replace(lines.images, blocked=lines.images.blocked.copy()))
        in_white_noise = self._judged(view, own_mask, noise_beside=False)
        return in_white_noise, self._judged(replace(view, work=work), lines) if in_white_noise else ()

    def search(self, view: DetectorView, seed_sigma: float) -> tuple[tuple[Detection, ...], Searched]:
        """The same detections, and what a tracker goes on from: segments from `seed_sigma` on, and the image they are in."""
        lines = self._lines(view, seed_sigma)
        if lines is None:
            return (), Searched.empty(view.mask.shape)
        found = self._judged(view, lines)
        if lines.earlier is None and len(view.stars) > 0:
            # with faint stars still in it, such a frame foretells nothing and bears nothing out
            return found, Searched.empty(view.mask.shape)
        # trails were taken out of it as they were found
        images, taps = lines.images, whiten.odd_taps(view.psf_sigma_px)
        whiten.known(lines.smooth, images.image, images.blocked, images.level, TILE_PX, taps, POINT_CLIP_SIGMA)
        removed = np.rint(np.maximum(images.subtracted[:, :2], 0.0)).astype(np.uint16)  # a fit may leave the frame
        return found, Searched(smooth=lines.smooth, seeds=seed_ends(lines.seeds), removed=removed)

    def _lines(self, view: DetectorView, seed_sigma: float | None) -> "_Lines | None":
        """Lines of a view, found and taken out of its images one after the other; None of a view too small for any."""
        if min(view.residual_adu.shape) < 2 * MIN_ROWS:
            return None
        s_px = view.psf_sigma_px
        motion = view.stars.motion
        earlier = static_sky.earlier_frame(view, self.reach_px) if motion is None else None
        if motion is None:
            images = working_images(view, earlier, halo_px=self.halo_px)
        else:
            images = trailed_sky.working_images(view, motion, halo_px=self.halo_px)
        n_sigma = self.n_sigma + math.log10(max(1.0, len(images.new) / STORM_ENTRIES))
        usable = max(0.01, 1.0 - float(np.mean(images.blocked[::4, ::4] != 0)))
        taps = whiten.even_taps(s_px)
        noise = dyadic.half_resolution_noise(taps, usable)
        # one smoothed image after the other: the coarse one and its line sums are gone before the fine one is made
        binned = whiten.smooth_binned(images.image, images.level, TILE_PX, taps, self.clip_sigma)
        bits = np.packbits(images.blocked)  # not looked at meanwhile: an eighth of its memory will do
        images = replace(images, blocked=np.zeros((0, 0), np.uint8))
        coarse_sigma = self.coarse_sigma if seed_sigma is None else min(self.coarse_sigma, max(seed_sigma - SEED_LOSS, 3.5))
        candidates, work = dyadic.coarse_segments(binned, noise, coarse_sigma, MIN_ROWS, MAX_CANDIDATES)
        # sums are looked at before anything is known of them, so that the search of what they gave keeps its own part
        view.work.spend(Work.CANDIDATES, min(work, COLLECTED_SHARE * view.work.limits[Work.CANDIDATES]))
        del binned
        faint = candidates[:0].astype(np.float32)  # exact but for the S/N: ends lie on the lattice
        if coarse_sigma < self.coarse_sigma:
            # fainter ones are for the tracker alone, which looks at them with the frames around; one frame gains nothing by them
            wanted = dyadic.above(candidates, self.coarse_sigma)
            faint, candidates = candidates[~wanted][:MAX_SEEDS].astype(np.float32), dyadic.in_order(candidates[wanted])
        images = replace(images, blocked=np.unpackbits(bits, count=view.mask.size).reshape(view.mask.shape))
        del bits
        taps = whiten.odd_taps(s_px)
        smooth = whiten.smooth(images.image, images.level, TILE_PX, taps, POINT_CLIP_SIGMA)
        seeds = np.empty((0 if seed_sigma is None else MAX_SEEDS + len(faint), 6))
        table, n_seeds, work, n_left = resolve.resolve(
            images.image,
            smooth,
            images.blocked,
            images.level,
            TILE_PX,
            candidates,
            s_px,
            usable,
            n_sigma,
            n_sigma - FIRST_MARGIN,
            self.min_length_px,
            MAX_TRAILS,
            strip.work_space(max(images.image.shape), s_px),
            max(0, view.work.left(Work.CANDIDATES) - resolve.most_of_one(max(images.image.shape))),
            math.inf if seed_sigma is None else seed_sigma,
            seeds[: len(seeds) - len(faint)],
        )
        del candidates  # memory is dearest here
        if len(faint):
            n_seeds = resolve.with_free(images.blocked, faint, seeds, n_seeds)
            del faint
        seeds = seeds[:n_seeds]
        view.work.spend(Work.CANDIDATES, work)
        view.work.leave(Work.CANDIDATES, n_left)
        table = within_work(table, view.work)
        return _Lines(images=images, smooth=smooth, earlier=earlier, n_sigma=n_sigma, table=table, seeds=seeds)

    def _judged(self, view: DetectorView, lines: "_Lines", *, noise_beside: bool = True) -> tuple[Detection, ...]:
        """Detections among the lines of a view. noise_beside : whether `local_noise` judges.

        Where an earlier frame lets short trails be found they are marked in the mask of the lines.
        """
        images, earlier, n_sigma, table = lines.images, lines.earlier, lines.n_sigma, lines.table
        s_px, motion = view.psf_sigma_px, view.stars.motion
        if noise_beside:
            table = local_noise.above(table, n_sigma, images.image, images.blocked, images.level, TILE_PX, s_px)
        found = [line_detection(row, view.residual_adu.shape) for row in table]
        found = [piece for d in found for piece in trains.taken_apart(d, view, images.blocked, s_px)]
        found = [with_blurred_ends(d, images, s_px) if d.length_px < resolve.SHARP_ENDS_PX else d for d in found]
        found = [d for d in found if d.snr >= n_sigma]
        if earlier is None:
            found = [d for d in found if d.length_px >= (self.blend_px if d.snr >= BRIGHT_SNR else max(self.blend_px, BLEND_PX))]
            # what is left of faint stars that trail lies along every line, long or short
            all_alike = motion is not None
            found = [
                d
                for d in found
                if (d.length_px >= resolve.SHARP_ENDS_PX and not all_alike) or d.snr >= n_sigma + self.single_frame_margin
            ]
            if motion is not None:
                found = [d for d in found if not trailed_sky.is_star(d, motion)]
                found = [d for d in found if not trailed_sky.is_left_over(d, images.blocked, motion)]
                found += trailed_sky.still_points(view, images, n_sigma + self.short_margin)
        else:
            found = [d for d in found if stays_above_earlier(d, earlier, images, s_px, n_sigma, self.short_margin)]
            found += short_detections(view, earlier, images, lines.smooth, n_sigma + self.short_margin)
            found += slow_movers(view, earlier)
        found = [sharpness.with_sharpness(d, view, images.level, TILE_PX) for d in found]
        found = [with_unclipped_snr(d, view, images, s_px) for d in found]
        found = varied.followed(found, view, images, s_px, held_beside=self.held_beside)
        found = fragments.join(found, brighter_apart=self.held_beside)
        hits = particle_hits(view, images, n_sigma + self.short_margin, MOST_HITS)
        found = track_pieces.flagged(found, hits)
        radii = star_mask.mask_radii_px(view.stars.snr, s_px, self.halo_px) if found else np.zeros(0)
        found = [context.with_context(d, view, images.stars, radii) for d in found]
        tracks = [d for d in found if d.flags & StreakFlag.COSMIC_LIKE]
        real = sorted((d for d in found if not d.flags & StreakFlag.COSMIC_LIKE), key=lambda d: -d.snr)
        tracks += track_pieces.beside_trails(hits[: max(0, self.max_detections - len(real))], found)
        tracks.sort(key=lambda d: -d.snr)
        return tuple((real + tracks)[: self.max_detections])


@dataclass(frozen=True, kw_only=True, eq=False)
class _Lines:
    """What the search of a view leaves.

    images, smooth : without the lines. earlier : the frame before, where it helps. n_sigma : threshold.
    table, seeds : see `resolve.resolve`.
    """

    images: WorkingImages
    smooth: NDArray[np.int8]
    earlier: static_sky.EarlierFrame | None
    n_sigma: float
    table: NDArray[np.float64]
    seeds: NDArray[np.float64]
