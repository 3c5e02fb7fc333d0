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
    halos,
    local_noise,
    point_movers,
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
from onboard.detect.line_integral.star_removal import (
    POINT_CLIP_SIGMA,
    TILE_PX,
    WorkingImages,
    noise_e,
    snr_before,
    working_images,
)
from onboard.image import registration
from onboard.image.nearest import nearest
from sboc_e2e.icd.flags import StreakFlag
from sboc_e2e.icd.signals import Detection, DetectorView, Searched
from sboc_e2e.icd.work import Work, WorkMeter

MIN_ROWS: Final = 4
"""Shortest blocks searched, in rows of the half-resolution image (8 px)."""

MAX_CANDIDATES: Final = 50_000
"""Room for candidates of one quadrant of angles."""

MAX_TRAILS: Final = 2_000
"""Room for trails before particle tracks are told apart: those of a storm come first, being brighter."""

COLLECTED_SHARE: Final = 0.5
"""Sums above the threshold take no more than this of the work for candidates: hardly ever a tenth."""

TRAIL_WORK: Final = 200_000.0
TRAIL_WORK_PER_PX: Final = 1_400.0
"""Operations of a trail that is looked at: 45 lines beside it of some 14 px across, its place in the frame before, its light
along it, its surroundings in the star list."""

FIRST_MARGIN: Final = 1.4
"""The corridor search on whole pixels may fall so far short of the final S/N."""

MAX_SEEDS: Final = 60_000
"""Room for segments that a tracker may go on from."""

SEED_LOSS: Final = 0.25
"""A seed's S/N on the coarse lattice may fall so far short of what the search in its corridor makes of it.

With 0.5 there are 1.7 times as many seeds, and half of the objects over four frames are found at S/N 0.04 less; search and
tracker take twice the time for them.
"""

POINT_LIKE_PX: Final = 4.0
"""Trails shorter than about two PSF widths are called point-like."""

BLEND_PX: Final = 25.0
"""Blends of stars look like trails up to this length in a single frame."""

SLOW_SNR: Final = 80.0
"""Least S/N of star-like objects whose motion is seen as a shift of the centroid."""

SLOW_SHIFT_PX: Final = 0.5
"""Least shift of such an object between frames, stars held fixed."""

SLOW_REACH_PX: Final = 3.0
"""Largest such shift; faster objects leave their place empty and are new entries."""

STAR_LIKE_PX: Final = 20.0
"""Shorter trails may be a faint star, or two of them in a row."""

GATHERING_PX: Final = 250.0
"""Longer trails gather so many unlisted stars in the earlier frame that their light there says little.

With 1,000 px a seventh fewer false lines pass (59, not 69 at 150 px, in 40 frames at 6.7 sigma), but trails of 300 px need 0.1
more S/N.
"""

STATIC_SHARE: Final = 0.15
"""Light left by stars is the same in both frames: false lines (142 in 16 blank frames) showed 0.15 of their S/N more in the
earlier one than trails do ..."""

STATIC_SIGMA: Final = 1.7
"""... and what exceeds this, as one place in 22 does by noise, is taken for a star, a spike or a column."""

VARIED_SIGMA: Final = 4.8
"""Rise of a point source between two frames, in sigma of their difference, that stars of constant light do not reach.

With N stars per frame near the threshold false alarms are N Q(z): 30,000 give 0.02 per frame. A star-like object that was not
there before is thus found from S on, S^2 = 2 z^2 (1 + nu S / 2) (`point_movers.object_noise`): 8.8 in the preset.
"""

STORM_ENTRIES: Final = 1000
"""New star-list entries above which a particle storm raises the threshold."""

MOST_HITS: Final = 2000
"""Sharp points that are looked at: a hundred tracks leave about a thousand."""

EDGE_PX: Final = 3.0
"""An end closer than this to the frame's edge may continue beyond it."""


def within_work(table: NDArray[np.float64], work: WorkMeter) -> NDArray[np.float64]:
    """The rows of `resolve.resolve` that are looked at further, in their order, as far as work allows; the others are counted.

    Trails of each octave of length take turns, the most significant of each first.
    """
    length = np.hypot(table[:, 3] - table[:, 1], table[:, 4] - table[:, 2])
    best_first = np.argsort(-table[:, 6], kind="stable")
    turn = dyadic.turns(np.log2(np.maximum(length[best_first], 1.0)).astype(np.int64))
    in_turn = best_first[np.argsort(turn, kind="stable")]
    operations = np.cumsum(TRAIL_WORK + TRAIL_WORK_PER_PX * length[in_turn])
    room = int(np.searchsorted(operations, work.left(Work.TRAILS), side="right"))
    work.spend(Work.TRAILS, operations[room - 1] if room else 0)
    work.leave(Work.TRAILS, len(table) - room)
    return np.asarray(table[np.sort(in_turn[:room])])


def edge_flags(ends: tuple[float, float, float, float], shape: tuple[int, int], snr: float) -> StreakFlag:
    """EDGE0 and EDGE1 of a segment (row0, col0, row1, col1): ends whose uncertainty reaches the frame's edge.

    The change-point law of faint ends: rms sqrt(26) L / S^2.
    """
    length = math.hypot(ends[2] - ends[0], ends[3] - ends[1])
    reach = EDGE_PX + min(20.0, math.sqrt(26.0) * length / snr**2)
    u_row, u_col = ((ends[2] - ends[0]) / length, (ends[3] - ends[1]) / length) if length > 0.0 else (0.0, 0.0)
    flags = StreakFlag(0)
    for row, col, sign, flag in ((ends[0], ends[1], -1.0, StreakFlag.EDGE0), (ends[2], ends[3], 1.0, StreakFlag.EDGE1)):
        row, col = row + sign * reach * u_row, col + sign * reach * u_col
        if row < 0.0 or col < 0.0 or row > shape[0] - 1 or col > shape[1] - 1:
            flags |= flag
    return flags


def _inside(ends: NDArray[np.float64], shape: tuple[int, int]) -> tuple[float, float, float, float]:
    """The part inside the frame of a segment (major0, minor0, major1, minor1); along it, so that its direction stays."""
    start = (float(ends[0]), float(ends[1]))
    way = (float(ends[2]) - start[0], float(ends[3]) - start[1])
    low, high = 0.0, 1.0
    for k in range(2):
        if abs(way[k]) > 1e-6:
            cuts = sorted((-start[k] / way[k], (shape[k] - 1.0 - start[k]) / way[k]))
            low, high = max(low, cuts[0]), min(high, cuts[1])
    high = max(low, high)
    (a0, b0), (a1, b1) = (tuple(min(max(start[k] + u * way[k], 0.0), shape[k] - 1.0) for k in range(2)) for u in (low, high))
    return a0, b0, a1, b1


def line_detection(row: NDArray[np.float64], shape: tuple[int, int]) -> Detection:
    """A row of `resolve.resolve` as a contract record, ends inside the frame."""
    axis = int(row[0])
    a0, b0, a1, b1 = _inside(row[1:5], shape if axis == 0 else shape[::-1])
    ends = (a0, b0, a1, b1) if axis == 0 else (b0, a0, b1, a1)
    slope = (row[4] - row[2]) / max(row[3] - row[1], 1e-6)
    sagitta = float(row[5]) / math.sqrt(1.0 + slope * slope)
    flags = edge_flags(ends, shape, float(row[6]))
    if abs(sagitta) < 0.5:
        sagitta = 0.0
    else:
        flags |= StreakFlag.CURVED
    # positive side of the contract: (+drow, -dcol) turned from the chord, i.e. growing row for a chord along growing col
    signed = sagitta if axis == 1 else -sagitta
    return Detection(row0=ends[0], col0=ends[1], row1=ends[2], col1=ends[3], snr=float(row[6]), sagitta_px=signed, flags=flags)


def seed_ends(seeds: NDArray[np.float64]) -> NDArray[np.float64]:
    """Seeds of `resolve.resolve` (n, 6) as row0, col0, row1, col1, S/N (n, 5), ends by growing major coordinate."""
    steep = seeds[:, :1] == 0.0
    return np.column_stack([np.where(steep, seeds[:, 1:5], seeds[:, [2, 1, 4, 3]]), seeds[:, 5]])


def with_blurred_ends(detection: Detection, images: WorkingImages, psf_sigma_px: float) -> Detection:
    """A short line refitted with the template whose ends are blurred by the PSF: sharp ends cost it a few per cent of S/N."""
    row, col = 0.5 * (detection.row0 + detection.row1), 0.5 * (detection.col0 + detection.col1)
    angle = math.atan2(detection.row1 - detection.row0, detection.col1 - detection.col0)
    rough = (detection.snr, row, col, angle, detection.length_px)
    snr, row, col, angle, length = point_movers.fit_short_trail(
        images.image, images.blocked, whiten.FOUND_BIT, rough, psf_sigma_px
    )
    if snr <= detection.snr:
        return detection
    limit_row, limit_col = images.image.shape[0] - 1.0, images.image.shape[1] - 1.0
    half_row, half_col = 0.5 * length * math.sin(angle), 0.5 * length * math.cos(angle)
    row0, row1 = (float(np.clip(row + sign * half_row, 0.0, limit_row)) for sign in (-1.0, 1.0))
    col0, col1 = (float(np.clip(col + sign * half_col, 0.0, limit_col)) for sign in (-1.0, 1.0))
    return replace(detection, row0=row0, col0=col0, row1=row1, col1=col1, snr=float(snr))


def segment_snr(detection: Detection, view: DetectorView, images: WorkingImages, s_px: float) -> float:
    """Matched-filter S/N of a detection's segment in the unclipped image, on its usable pixels; NaN where these are few."""
    ends = np.array([detection.row0, detection.col0, detection.row1, detection.col1])
    return static_sky.segment_snr(
        view.residual_adu,
        view.mask,
        view.background.sigma_adu,
        view.background.tile_px,
        images.blocked,
        whiten.FOUND_BIT,
        images.level,
        TILE_PX,
        ends,
        s_px,
    )


def _snr_beyond(snr: float, before: float) -> float:
    """S/N of a detection less what stood there before: a small share of it, and all of it beyond STATIC_SIGMA."""
    return snr - STATIC_SHARE * before - (1.0 - STATIC_SHARE) * max(0.0, before - STATIC_SIGMA)


def moved(
    detection: Detection,
    earlier: static_sky.EarlierFrame,
    images: WorkingImages,
    psf_sigma_px: float,
    n_sigma: float,
    short_margin: float,
) -> bool:
    """Whether a detection stays above n_sigma once what the earlier frame shows at its place is held against it.

    The place is that among the stars (faint stars in a row, spikes) and that on the sensor (columns). Light of stars that were
    subtracted from this frame does not count, and long segments are refused only when nearly all of their light was there before.
    The part of short_margin asked of short ones goes from all at no length to nothing at STAR_LIKE_PX.
    """
    row, col, then = images.subtracted.T
    ends = np.array([detection.row0, detection.col0, detection.row1, detection.col1])
    wanted = n_sigma + short_margin * max(0.0, 1.0 - detection.length_px / STAR_LIKE_PX)
    # among the stars these lie where they lie in this frame, on the sensor where the earlier frame had them
    back = registration.inverse(earlier.transform)
    for transform, sky, places in (
        (earlier.transform, static_sky.IDENTITY, static_sky.IDENTITY),
        (static_sky.IDENTITY, back, earlier.transform),
    ):
        before = static_sky.segment_snr_before(
            earlier.frame.pixels, transform, sky, images.blocked, whiten.FOUND_BIT, images.level, TILE_PX, ends, psf_sigma_px
        )
        if math.isnan(before):
            continue
        before -= halos.subtracted_snr(images.halos, places, images.blocked, whiten.FOUND_BIT, ends, psf_sigma_px)
        if before > 0.8 * detection.snr:
            return False
        if detection.length_px < GATHERING_PX and _snr_beyond(detection.snr, before) < wanted:
            before -= static_sky.subtracted_snr(row, col, then, places, ends, psf_sigma_px)
            if _snr_beyond(detection.snr, before) < wanted:
                return False
    return True


def short_detections(
    view: DetectorView,
    earlier: static_sky.EarlierFrame,
    images: WorkingImages,
    smooth: NDArray[np.int8],
    n_sigma: float,
) -> list[Detection]:
    """Star-like and short movers: new entries of the star list, refined; a static source of changed brightness is refused."""
    stars, s_px = view.stars, view.psf_sigma_px
    entries = images.new[~images.sharp]
    table, done, left = point_movers.short_trails(
        images.image,
        smooth,
        images.blocked,
        stars.row[entries],
        stars.col[entries],
        s_px,
        n_sigma,
        whiten.FOUND_BIT,
        MAX_TRAILS,
        view.work.left(Work.POINTS),
    )
    view.work.spend(Work.POINTS, done)
    view.work.leave(Work.POINTS, left)
    before = snr_before(earlier, table[:, 2], table[:, 3], s_px)
    sigma_e = noise_e(view)
    found = []
    for (_, snr, row, col, angle, length), then in zip(table, before, strict=True):
        if not (snr - max(then, 0.0) > n_sigma and point_movers.rise_sigma(snr, then, s_px, sigma_e) > VARIED_SIGMA):
            continue
        half_row, half_col = 0.5 * length * math.sin(angle), 0.5 * length * math.cos(angle)
        limit_row, limit_col = view.residual_adu.shape[0] - 1.0, view.residual_adu.shape[1] - 1.0
        row0, row1 = (float(np.clip(row + sign * half_row, 0.0, limit_row)) for sign in (-1.0, 1.0))
        col0, col1 = (float(np.clip(col + sign * half_col, 0.0, limit_col)) for sign in (-1.0, 1.0))
        flags = edge_flags((row0, col0, row1, col1), view.residual_adu.shape, float(snr))
        if length < POINT_LIKE_PX:
            flags |= StreakFlag.POINT_LIKE
        found.append(Detection(row0=row0, col0=col0, row1=row1, col1=col1, snr=float(snr), flags=flags))
    return found


def slow_movers(view: DetectorView, earlier: static_sky.EarlierFrame) -> list[Detection]:
    """Bright star-like objects that moved by a fraction of a pixel to a few pixels: clean list entries matched in both frames.

    A centroid is good to about s sqrt(2) / S px, so at S/N SLOW_SNR a shift of SLOW_SHIFT_PX is over twenty sigma: what is left
    are blends.
    """
    stars, then = view.stars, earlier.frame.stars
    # in both frames: a particle that hits a star moves its centroid, and so does a hot pixel that a star comes to lie beside
    clean, known = (stars.snr >= SLOW_SNR) & (stars.flags == 0), (then.snr >= 0.5 * SLOW_SNR) & (then.flags == 0)
    bright = np.flatnonzero(clean)
    hit = point_movers.holds_sharp_pixel(
        view.residual_adu,
        view.mask,
        view.background.sigma_adu,
        view.background.tile_px,
        stars.row[bright],
        stars.col[bright],
        sharpness.measured_width_px(view),
    )
    clean[bright[hit]] = False
    if not clean.any() or not known.any():
        return []
    place = np.column_stack([stars.row[clean], stars.col[clean]])
    before = np.column_stack([then.row[known], then.col[known]])
    shift, index = nearest(registration.apply(earlier.transform, place), before, SLOW_REACH_PX)
    matched = np.isfinite(shift)
    ratio = np.full(len(shift), np.inf)
    ratio[matched] = then.snr[known][index[matched]] / stars.snr[clean][matched]
    moved_far = matched & (shift > SLOW_SHIFT_PX) & (np.abs(np.log(ratio)) < 0.4)
    return [
        Detection(row0=float(row), col0=float(col), row1=float(row), col1=float(col), snr=float(snr), flags=StreakFlag.POINT_LIKE)
        for (row, col), snr in zip(place[moved_far], stars.snr[clean][moved_far], strict=True)
        if 0.0 <= row <= view.residual_adu.shape[0] - 1 and 0.0 <= col <= view.residual_adu.shape[1] - 1
    ]


def particle_hits(view: DetectorView, images: WorkingImages, n_sigma: float, most: int) -> list[Detection]:
    """New entries sharper than the PSF, brightest first and no more than `most`."""
    stars = view.stars
    rows, cols = view.residual_adu.shape
    sharp = images.new[images.sharp]
    sharp = sharp[stars.snr[sharp] >= n_sigma]
    hits = sharp[np.argsort(-stars.snr[sharp], kind="stable")[:most]]
    places = zip(np.clip(stars.row[hits], 0, rows - 1), np.clip(stars.col[hits], 0, cols - 1), stars.snr[hits], strict=True)
    flags = StreakFlag.COSMIC_LIKE | StreakFlag.POINT_LIKE
    return [
        Detection(row0=row, col0=col, row1=row, col1=col, snr=snr, flags=flags)
        for row, col, snr in ((float(row), float(col), float(snr)) for row, col, snr in places)
    ]


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
    reach_px: float = field(default=300.0, metadata={"doc": "largest shift of stars between frames", "min": 0.0, "max": 5000.0})
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
        return self._search(view, None)[0]

    def search(self, view: DetectorView, seed_sigma: float) -> tuple[tuple[Detection, ...], Searched]:
        """The same detections, and what a tracker goes on from: segments from `seed_sigma` on, and the image they are in."""
        found, searched = self._search(view, seed_sigma)
        return found, Searched.empty(view.mask.shape) if searched is None else searched

    def _search(self, view: DetectorView, seed_sigma: float | None) -> tuple[tuple[Detection, ...], Searched | None]:
        """Detections and, where seeds are asked for, what a tracker goes on from."""
        if min(view.residual_adu.shape) < 2 * MIN_ROWS:
            return (), None
        s_px = view.psf_sigma_px
        motion = view.stars.motion
        earlier = static_sky.earlier_frame(view, self.reach_px) if motion is None else None
        if motion is None:
            images = working_images(view, earlier, halo_px=self.halo_px)
        else:
            images = trailed_sky.working_images(view, motion)
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
        images = replace(images, blocked=np.unpackbits(bits, count=view.mask.size).reshape(view.mask.shape))
        smooth = whiten.smooth(images.image, images.level, TILE_PX, whiten.odd_taps(s_px), POINT_CLIP_SIGMA)
        # trails are taken out of it as they are found
        # without a frame before, faint stars are still in it: such a frame foretells nothing and bears nothing out
        told = seed_sigma is not None and (earlier is not None or len(view.stars) == 0)
        whole = whiten.known(smooth, images.blocked) if told else None
        seeds = np.empty((0 if seed_sigma is None else MAX_SEEDS, 6))
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
            seeds,
        )
        view.work.spend(Work.CANDIDATES, work)
        view.work.leave(Work.CANDIDATES, n_left)
        table = local_noise.above(
            within_work(table, view.work), n_sigma, images.image, images.blocked, images.level, TILE_PX, s_px
        )
        found = [line_detection(row, view.residual_adu.shape) for row in table]
        found = [piece for d in found for piece in trains.taken_apart(d, view, images.blocked, s_px)]
        found = [with_blurred_ends(d, images, s_px) if d.length_px < resolve.SHARP_ENDS_PX else d for d in found]
        found = [d for d in found if d.snr >= n_sigma]
        if earlier is None:
            found = [d for d in found if d.length_px >= BLEND_PX]
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
            found = [d for d in found if moved(d, earlier, images, s_px, n_sigma, self.short_margin)]
            found += short_detections(view, earlier, images, smooth, n_sigma + self.short_margin)
            found += slow_movers(view, earlier)
        found = [sharpness.with_sharpness(d, view, images.level, TILE_PX) for d in found]
        # the working image is clipped: the S/N of a bright trail comes from the image itself
        unclipped = [
            segment_snr(d, view, images, s_px) if d.snr > 30.0 and d.length_px >= POINT_LIKE_PX else d.snr for d in found
        ]
        found = [replace(d, snr=max(d.snr, s)) for d, s in zip(found, unclipped, strict=True)]
        found = fragments.join(varied.followed(found, view, images, s_px))
        hits = particle_hits(view, images, n_sigma + self.short_margin, MOST_HITS)
        found = track_pieces.flagged(found, hits)
        radii = star_mask.mask_radii_px(view.stars.snr, s_px, self.halo_px) if found else np.zeros(0)
        found = [context.with_context(d, view, images.stars, radii) for d in found]
        tracks = [d for d in found if d.flags & StreakFlag.COSMIC_LIKE]
        real = sorted((d for d in found if not d.flags & StreakFlag.COSMIC_LIKE), key=lambda d: -d.snr)
        tracks += track_pieces.beside_trails(hits[: max(0, self.max_detections - len(real))], found)
        tracks.sort(key=lambda d: -d.snr)
        detections = tuple((real + tracks)[: self.max_detections])
        return detections, None if whole is None else Searched(smooth=whole, seeds=seed_ends(seeds[:n_seeds]))
