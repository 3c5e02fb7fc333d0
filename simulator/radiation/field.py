"""Hits of one exposure: Poisson numbers, directions, energy loss with straggling, electrons' paths, charge in pixels."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from sboc_e2e.icd.errors import UserError
from simulator.radiation import electrons
from simulator.radiation.arrival import FieldLines, arrival, crossing_directions, proton_scale_km
from simulator.radiation.belts import ANOMALY, HORN, GeodeticPosition, TrappedSpectrum, trapped
from simulator.radiation.delta_rays import CUT_KEV, knocked_out
from simulator.radiation.energy_loss import SHIELDS, SILICON, StoppingRange, stopping_power_mev_cm2_g
from simulator.radiation.environment import (
    EQUATOR_RIGIDITY_GV,
    GROUND_RATE_CM2_S,
    GROUND_RIGIDITY_GV,
    NUCLEI,
    CosmicRaySpectrum,
    cosmic_rate_cm2_s,
    cutoff_rigidity_gv,
    energy_of_nucleus_mev_u,
    nuclei_through,
)
from simulator.radiation.hits import TRACK_DTYPE, HitList, no_hits
from simulator.radiation.options import RadiationOptions
from simulator.radiation.straggling import FANO, PAIR_EV, draw_electron_loss_kev, draw_loss_kev, landau_table
from simulator.radiation.tracks import deposit
from simulator.randomness import Effect, generator

Array = NDArray[np.float64]

_GRAZING: Final = 0.02
"""Smallest cosine of incidence: flatter tracks (4 in 10,000) are drawn at 50 layer thicknesses of path."""

_STEP_UM: Final = 3.0
"""Longest step of an electron's path, where a quarter of a pixel is not longer."""

MOST_PARTICLES: Final = 1_000_000
"""Of one frame: more fill a detector of any size and would not fit into memory."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Fluxes:
    """Particles through one cm2 of the sensor behind its shield, per second; cutoff_gv : rigidity of the softest cosmic rays."""

    cosmic_cm2_s: float
    proton_cm2_s: float = 0.0
    electron_cm2_s: float = 0.0
    cutoff_gv: float = EQUATOR_RIGIDITY_GV
    protons: TrappedSpectrum | None = None
    electrons: TrappedSpectrum | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class _Crossing:
    """Particles on the entry face. row, col : (n,) px. direction : (n, 3) of motion along cols, rows, depth."""

    row: Array
    col: Array
    direction: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class _Pieces:
    """Straight pieces of tracks. ends : (m, 6) row, col, depth share at both ends. electrons, track : (m,)."""

    ends: Array
    electrons: Array
    track: NDArray[np.int64]


class ParticleField:
    """Particles through a sensor of (rows, cols) pixels of `pitch_um`.

    A plane of area A is crossed from both sides by half of an isotropic omnidirectional flux times A, with probability
    proportional to the cosine of incidence.
    """

    def __init__(
        self, options: RadiationOptions, *, rows: int, cols: int, pitch_um: float, seed: int, epoch_jyear: float = 2027.0
    ) -> None:
        self.options = options
        self.rows, self.cols, self.pitch_um = rows, cols, pitch_um
        self.seed = seed
        self.epoch_jyear = epoch_jyear
        self._shield = StoppingRange(SHIELDS[options.shield_material])
        self._shield_g_cm2 = self._shield.material.density_g_cm3 * options.shield_mm * 0.1
        self._spectrum = CosmicRaySpectrum(options.modulation_mv)
        self._stopped_mev = self._shield.stopped_below_mev_u(options.shield_mm)
        self._electrons_stopped_mev = max(float(electrons.energy_of_range_mev(self._shield_g_cm2)), electrons.LOWEST_MEV)
        self._landau = landau_table()

    def fluxes(self, position: tuple[float, float, float] | None) -> Fluxes:
        """Fluxes through the sensor at a place.

        position : geodetic latitude and longitude in degrees, altitude in km; None for a site on the ground.
        """
        options = self.options
        protons = belt = None
        proton_scale = 1.0
        cutoff_gv = EQUATOR_RIGIDITY_GV
        match options.environment:
            case "saa":
                protons, belt = trapped("proton", ANOMALY), trapped("electron", ANOMALY)
                proton_scale = options.saa_peak_omni_cm2_s / protons.above(50.0)
            case "horn":
                protons, belt, cutoff_gv = trapped("proton", HORN), trapped("electron", HORN), cutoff_rigidity_gv(HORN)
            case "polar":
                cutoff_gv = 0.0
            case "orbit" if position is not None:
                where = GeodeticPosition(*position)
                protons, belt = (
                    trapped(kind, where, self.epoch_jyear, options.saa_drift_deg_yr) for kind in ("proton", "electron")
                )
                cutoff_gv = cutoff_rigidity_gv(where)
            case "orbit" | "ground":
                return Fluxes(cosmic_cm2_s=GROUND_RATE_CM2_S, cutoff_gv=GROUND_RIGIDITY_GV)
        return Fluxes(
            cosmic_cm2_s=cosmic_rate_cm2_s(options, self._spectrum, cutoff_gv),
            proton_cm2_s=0.5 * options.saa_factor * proton_scale * protons.above(self._stopped_mev) if protons else 0.0,
            electron_cm2_s=0.5 * options.electron_factor * belt.above(self._electrons_stopped_mev) if belt else 0.0,
            cutoff_gv=cutoff_gv,
            protons=protons,
            electrons=belt,
        )

    def hits(
        self,
        frame: int,
        exposure_s: float,
        position: tuple[float, float, float] | None,
        lines: FieldLines | None = None,
    ) -> HitList:
        """Hits of one frame: new in every frame, the same for the same seed and frame.

        lines : the magnetic field at the sensor, for directions; without it they are isotropic.
        """
        options = self.options
        if not options.enabled:
            return no_hits()
        rng = generator(self.seed, Effect.RADIATION, frame)
        fluxes = self.fluxes(position)
        pattern = None
        if lines is not None and options.anisotropy and options.environment == "orbit" and fluxes.proton_cm2_s > 0.0:
            where = GeodeticPosition(*position) if position else ANOMALY
            scale_km = proton_scale_km(where, self.epoch_jyear, options.saa_drift_deg_yr, self._stopped_mev)
            pattern = arrival(lines, options.pitch_width_deg, max(self._stopped_mev, 20.0) * 1.5, scale_km)
        # Tracks may start outside and end inside, so that particles fall on a frame widened by the longest track.
        margin_px = options.depletion_um / self.pitch_um / _GRAZING
        area_cm2 = (self.rows + 2.0 * margin_px) * (self.cols + 2.0 * margin_px) * (self.pitch_um * 1e-4) ** 2
        through = pattern.through_plane() if pattern else 1.0
        expected = (
            area_cm2 * exposure_s * np.array([fluxes.cosmic_cm2_s, fluxes.proton_cm2_s * through, fluxes.electron_cm2_s])
        )  # fmt: skip - the three kinds of one product
        if expected.sum() > MOST_PARTICLES:
            raise UserError(
                f"radiation.shield: behind {options.shield_mm:g} mm of {options.shield_material} {expected.sum():.1e} particles "
                f"reach one exposure; allowed are {MOST_PARTICLES:,}: thicken it, or lower electron_factor and saa_factor"
            )
        n_cosmic, n_proton, n_electron = (int(n) for n in rng.poisson(expected))
        if n_cosmic + n_proton + n_electron == 0:
            return no_hits()
        directions = [crossing_directions(rng, n_cosmic)]
        directions.append(pattern.draw(rng, n_proton) if pattern else crossing_directions(rng, n_proton))
        heavy = self._fall(rng, np.concatenate(directions), margin_px)
        falling = self._fall(rng, crossing_directions(rng, n_electron), margin_px)
        pieces = [self._heavy(rng, heavy, n_cosmic, fluxes)]
        if n_electron and fluxes.electrons is not None:
            energy = fluxes.electrons.draw_mev(rng, n_electron, self._electrons_stopped_mev)
            energy = electrons.behind_shield_mev(energy, self._shield_g_cm2)
            pieces.append(self._light(rng, falling, energy, n_cosmic + n_proton))
        return self._deposited(pieces, n_cosmic + n_proton + n_electron)

    def _fall(self, rng: np.random.Generator, direction: Array, margin_px: float) -> _Crossing:
        """Places on the widened frame for particles of given directions, none flatter than `_GRAZING`."""
        n = len(direction)
        row = rng.random(n) * (self.rows + 2.0 * margin_px) - margin_px - 0.5
        col = rng.random(n) * (self.cols + 2.0 * margin_px) - margin_px - 0.5
        depth = np.where(direction[:, 2] < 0.0, -1.0, 1.0) * np.maximum(np.abs(direction[:, 2]), _GRAZING)
        flat = np.sqrt((1.0 - depth**2) / np.maximum(direction[:, 0] ** 2 + direction[:, 1] ** 2, 1e-12))
        return _Crossing(row=row, col=col, direction=np.column_stack([direction[:, 0] * flat, direction[:, 1] * flat, depth]))

    def _near(self, crossing: _Crossing, reach_px: Array | float) -> NDArray[np.bool_]:
        """Whether a straight track, or one within a reach, comes near the detector."""
        reach = 1.0 + 3.5 * self.options.diffusion_um / self.pitch_um + reach_px
        over = np.zeros(len(crossing.row), dtype=bool)
        layer_px = self.options.depletion_um / self.pitch_um
        row1 = crossing.row + layer_px * crossing.direction[:, 1] / np.abs(crossing.direction[:, 2])
        col1 = crossing.col + layer_px * crossing.direction[:, 0] / np.abs(crossing.direction[:, 2])
        for low, high, size in (
            (np.minimum(crossing.row, row1), np.maximum(crossing.row, row1), self.rows),
            (np.minimum(crossing.col, col1), np.maximum(crossing.col, col1), self.cols),
        ):
            over |= (high < -reach) | (low > size - 1 + reach)
        return ~over

    def _heavy(self, rng: np.random.Generator, crossing: _Crossing, n_cosmic: int, fluxes: Fluxes) -> _Pieces:
        """Straight tracks of protons and nuclei, and the electrons they knock out."""
        options = self.options
        energy, charge, mass = self._particles(rng, n_cosmic, len(crossing.row) - n_cosmic, fluxes)
        track = np.arange(len(crossing.row))
        keep = self._near(crossing, 0.0) & (energy > 0.0)
        track, energy, charge, mass = track[keep], energy[keep], charge[keep], mass[keep]
        direction = crossing.direction[keep]
        path_um = options.depletion_um / np.abs(direction[:, 2])
        cut_kev = CUT_KEV if options.delta_rays else np.inf
        if options.straggling:
            loss_kev = draw_loss_kev(rng, energy, path_um, charge, SILICON, self._landau, cut_kev=cut_kev)
        else:
            loss_kev = stopping_power_mev_cm2_g(energy, SILICON, charge) * SILICON.density_g_cm3 * path_um * 1e-4 * 1e3
        # No particle leaves more than it has.
        pairs = self._pairs(rng, np.minimum(loss_kev, 1e3 * energy * mass))
        start = np.column_stack([crossing.row[keep], crossing.col[keep], np.where(direction[:, 2] > 0.0, 0.0, 1.0)])
        layer_px = options.depletion_um / self.pitch_um
        along = np.column_stack([direction[:, 1] * layer_px, direction[:, 0] * layer_px, direction[:, 2]])
        along = along / np.abs(direction[:, 2:])
        own = _Pieces(ends=np.concatenate([start, start + along], axis=1), electrons=pairs, track=track)
        if not (options.delta_rays and options.straggling):
            return own
        rays = knocked_out(rng, energy, charge, path_um, direction)
        at = start[rays.parent] + rays.share[:, None] * along[rays.parent]
        place_um = np.column_stack([at[:, :2] * self.pitch_um, at[:, 2] * options.depletion_um])
        rowwise = np.column_stack([rays.direction[:, 1], rays.direction[:, 0], rays.direction[:, 2]])
        more = self._walked(rng, place_um, rowwise, rays.energy_mev, np.ones(len(rays.share)), track[rays.parent])
        return _joined([own, more])

    def _light(self, rng: np.random.Generator, crossing: _Crossing, energy_mev: Array, first_track: int) -> _Pieces:
        """Paths of belt electrons."""
        layer_um = self.options.depletion_um
        keep = self._near(crossing, 0.5 * layer_um / self.pitch_um) & (energy_mev > 0.0)
        energy, direction = energy_mev[keep], crossing.direction[keep]
        path_um = layer_um / np.abs(direction[:, 2])
        factor = np.ones(energy.size)
        if self.options.straggling:
            mean_kev = electrons.stopping_power_mev_cm2_g(energy, SILICON) * SILICON.density_g_cm3 * path_um * 0.1
            factor = draw_electron_loss_kev(rng, energy, path_um, mean_kev, SILICON, self._landau) / mean_kev
        depth_um = np.where(direction[:, 2] > 0.0, 0.0, layer_um)
        place_um = np.column_stack([crossing.row[keep] * self.pitch_um, crossing.col[keep] * self.pitch_um, depth_um])
        rowwise = np.column_stack([direction[:, 1], direction[:, 0], direction[:, 2]])
        track = first_track + np.arange(len(crossing.row))[keep]
        return self._walked(rng, place_um, rowwise, energy, np.maximum(factor, 0.05), track)

    def _walked(
        self,
        rng: np.random.Generator,
        place_um: Array,
        direction: Array,
        energy_mev: Array,
        factor: Array,
        track: NDArray[np.int64],
    ) -> _Pieces:
        """Electrons' paths as pieces."""
        options = self.options
        segments, of = electrons.walk(
            rng,
            place_um,
            direction,
            energy_mev,
            factor,
            options.depletion_um,
            max(_STEP_UM, 0.25 * self.pitch_um),
            scattering=options.scattering,
        )  # fmt: skip - what is walked, and how
        ends = segments[:, :6] / np.array([self.pitch_um, self.pitch_um, options.depletion_um] * 2)
        return _Pieces(ends=ends, electrons=self._pairs(rng, 1e3 * segments[:, 6]), track=track[of])

    def _pairs(self, rng: np.random.Generator, loss_kev: Array) -> Array:
        """Electron-hole pairs of energy losses."""
        pairs = np.maximum(loss_kev, 0.0) * 1e3 / PAIR_EV
        return np.maximum(pairs + np.sqrt(FANO * pairs) * rng.standard_normal(pairs.size), 0.0)

    def _particles(self, rng: np.random.Generator, n_cosmic: int, n_trapped: int, fluxes: Fluxes) -> tuple[Array, Array, Array]:
        """Energy per nucleon behind the shield, charge and mass number; 0 energy for what does not arrive."""
        options = self.options
        nuclei = options.nuclei and fluxes.cutoff_gv != GROUND_RIGIDITY_GV
        kinds = np.array(NUCLEI if nuclei else NUCLEI[:1])
        share = nuclei_through(self._spectrum, fluxes.cutoff_gv, nuclei=nuclei)
        kind = rng.choice(len(kinds), size=n_cosmic, p=share / share.sum())
        charge = np.concatenate([kinds[kind, 0], np.ones(n_trapped)])
        mass = np.concatenate([kinds[kind, 1], np.ones(n_trapped)])
        energy = np.zeros(n_cosmic + n_trapped)
        for k, (z, a, _) in enumerate(kinds):
            chosen = np.flatnonzero(kind == k)
            cutoff_mev_u = energy_of_nucleus_mev_u(fluxes.cutoff_gv, z, a)
            stopped_mev_u = self._shield.stopped_below_mev_u(options.shield_mm, z, a)
            energy[chosen] = self._spectrum.draw_mev(rng, chosen.size, max(cutoff_mev_u, stopped_mev_u))
        if n_trapped and fluxes.protons is not None:
            energy[n_cosmic:] = fluxes.protons.draw_mev(rng, n_trapped, self._stopped_mev)
        return self._shield.energy_behind_mev_u(energy, options.shield_mm, charge, mass), charge, mass

    def _deposited(self, parts: list[_Pieces], n: int) -> HitList:
        """Charge in pixels of all pieces, and the tracks that left any."""
        pieces = _joined(parts)
        if pieces.track.size == 0:
            return no_hits()
        spread_px = self.options.diffusion_um / self.pitch_um
        ends = np.ascontiguousarray(pieces.ends.T)
        cuts = np.hypot(ends[3] - ends[0], ends[4] - ends[1]) * 6.0 + 3.0
        per_cut = (2.0 * min(math.ceil(3.5 * spread_px), 15) + 1.0) ** 2
        row, col, charge_e, inside = deposit(
            ends[0],
            ends[1],
            ends[3],
            ends[4],
            ends[2],
            ends[5],
            pieces.electrons,
            spread_px,
            self.rows,
            self.cols,
            int((cuts * per_cut).sum()) + 16,
        )  # fmt: skip - ends, depths, charge; the detector
        # A track's own pieces come first among those of its number and in order; electrons it knocked out follow.
        number, first = np.unique(pieces.track, return_index=True)
        last = self._last_of_own(pieces.track, first)
        tracks = np.zeros(number.size, dtype=TRACK_DTYPE)
        tracks["row0"], tracks["col0"] = ends[0][first], ends[1][first]
        tracks["row1"], tracks["col1"] = ends[3][last], ends[4][last]
        tracks["charge_e"] = np.bincount(pieces.track, weights=inside, minlength=n)[number]
        return HitList(row=row, col=col, charge_e=charge_e, tracks=tracks[tracks["charge_e"] > 0.0])

    @staticmethod
    def _last_of_own(track: NDArray[np.int64], first: NDArray[np.intp]) -> NDArray[np.intp]:
        """Index of the last of the pieces that follow a track's first one without a break."""
        breaks = np.flatnonzero(np.concatenate([track[1:] != track[:-1], [True]]))
        return np.asarray(breaks[np.searchsorted(breaks, first)])


def _joined(parts: list[_Pieces]) -> _Pieces:
    """All pieces, one part after the other."""
    return _Pieces(
        ends=np.concatenate([p.ends for p in parts]),
        electrons=np.concatenate([p.electrons for p in parts]),
        track=np.concatenate([p.track for p in parts]),
    )
