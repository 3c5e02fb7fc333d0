"""Hits of one exposure: Poisson numbers, isotropic directions, energy loss with straggling, charge in pixels."""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from simulator.radiation.energy_loss import SHIELDS, SILICON, StoppingRange, stopping_power_mev_cm2_g
from simulator.radiation.environment import (
    EQUATOR_RIGIDITY_GV,
    GROUND_RATE_CM2_S,
    GROUND_RIGIDITY_GV,
    NUCLEI,
    CosmicRaySpectrum,
    GeodeticPosition,
    cosmic_rate_cm2_s,
    cutoff_rigidity_gv,
    draw_trapped_mev,
    energy_of_rigidity_mev,
    trapped_above,
    trapped_omni_cm2_s,
)
from simulator.radiation.hits import TRACK_DTYPE, HitList, no_hits
from simulator.radiation.options import RadiationOptions
from simulator.radiation.straggling import FANO, PAIR_EV, draw_loss_kev, landau_table
from simulator.radiation.tracks import deposit
from simulator.randomness import Effect, generator

_GRAZING: Final = 0.02
"""Smallest cosine of incidence: flatter tracks (4 in 10,000) are drawn at 50 layer thicknesses of path."""


class ParticleField:
    """Particles through a sensor of (rows, cols) pixels of `pitch_um`.

    The flux is isotropic; a plane of area A is crossed from both sides by half of the omnidirectional flux times A, with
    probability proportional to the cosine of incidence.
    """

    def __init__(
        self, options: RadiationOptions, *, rows: int, cols: int, pitch_um: float, seed: int, epoch_jyear: float = 2027.0
    ) -> None:
        self.options = options
        self.rows, self.cols, self.pitch_um = rows, cols, pitch_um
        self.seed = seed
        self.epoch_jyear = epoch_jyear
        self._shield = StoppingRange(SHIELDS[options.shield_material])
        self._spectrum = CosmicRaySpectrum(options.modulation_mv)
        self._stopped_mev = self._shield.stopped_below_mev_u(options.shield_mm)
        self._landau = landau_table()

    def rates_cm2_s(self, position: tuple[float, float, float] | None) -> tuple[float, float, float]:
        """Crossings of one cm2 per second by cosmic rays and by trapped protons, and the cosmic rays' cutoff rigidity in GV.

        position : geodetic latitude and longitude in degrees, altitude in km; None for a site on the ground.
        """
        options = self.options
        trapped, cutoff_gv = 0.0, EQUATOR_RIGIDITY_GV
        match options.environment:
            case "saa":
                trapped = options.saa_peak_omni_cm2_s
            case "polar":
                cutoff_gv = 0.0
            case "orbit" if position is not None:
                where = GeodeticPosition(*position)
                trapped = trapped_omni_cm2_s(where, self.epoch_jyear, options.saa_drift_deg_yr)
                cutoff_gv = cutoff_rigidity_gv(where)
            case "orbit" | "ground":
                return GROUND_RATE_CM2_S, 0.0, GROUND_RIGIDITY_GV
        trapped *= 0.5 * options.saa_factor * trapped_above(self._stopped_mev)
        return cosmic_rate_cm2_s(options, self._spectrum, cutoff_gv), trapped, cutoff_gv

    def hits(self, frame: int, exposure_s: float, position: tuple[float, float, float] | None) -> HitList:
        """Hits of one frame: new in every frame, the same for the same seed and frame."""
        options = self.options
        if not options.enabled:
            return no_hits()
        rng = generator(self.seed, Effect.RADIATION, frame)
        cosmic_rate, trapped_rate, cutoff_gv = self.rates_cm2_s(position)
        # Tracks may start outside and end inside, so that particles fall on a frame widened by the longest track.
        margin_px = options.depletion_um / self.pitch_um / _GRAZING
        height, width = self.rows + 2.0 * margin_px, self.cols + 2.0 * margin_px
        area_cm2 = height * width * (self.pitch_um * 1e-4) ** 2
        n_cosmic = int(rng.poisson(cosmic_rate * area_cm2 * exposure_s))
        n_trapped = int(rng.poisson(trapped_rate * area_cm2 * exposure_s))
        n = n_cosmic + n_trapped
        if n == 0:
            return no_hits()
        row0 = rng.random(n) * height - margin_px - 0.5
        col0 = rng.random(n) * width - margin_px - 0.5
        cosine = np.maximum(np.sqrt(rng.random(n)), _GRAZING)
        azimuth = rng.random(n) * (2.0 * math.pi)
        path_um = options.depletion_um / cosine
        sideways_px = np.sqrt(path_um**2 - options.depletion_um**2) / self.pitch_um
        row1 = row0 + sideways_px * np.sin(azimuth)
        col1 = col0 + sideways_px * np.cos(azimuth)
        energy, charge, mass = self._particles(rng, n_cosmic, n_trapped, cutoff_gv)
        electrons = self._electrons(rng, energy, charge, mass, path_um)
        spread_px = options.diffusion_um / self.pitch_um
        reach = 1.0 + 3.5 * spread_px
        near = (
            (np.maximum(row0, row1) > -reach)
            & (np.minimum(row0, row1) < self.rows + reach)
            & (np.maximum(col0, col1) > -reach)
            & (np.minimum(col0, col1) < self.cols + reach)
            & (electrons > 0.0)
        )
        row0, col0, row1, col1, electrons = (v[near] for v in (row0, col0, row1, col1, electrons))
        pieces = np.hypot(row1 - row0, col1 - col0) * 4.0 + 6.0
        per_piece = (2.0 * min(math.ceil(3.5 * spread_px), 15) + 1.0) ** 2
        capacity = int((pieces * per_piece).sum()) + 16
        row, col, charge_e, inside = deposit(row0, col0, row1, col1, electrons, spread_px, self.rows, self.cols, capacity)
        tracks = np.zeros(row0.size, dtype=TRACK_DTYPE)
        for name, values in (("row0", row0), ("col0", col0), ("row1", row1), ("col1", col1), ("charge_e", inside)):
            tracks[name] = values
        return HitList(row=row, col=col, charge_e=charge_e, tracks=tracks[inside > 0.0])

    def _particles(
        self, rng: np.random.Generator, n_cosmic: int, n_trapped: int, cutoff_gv: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Energy per nucleon behind the shield, charge and mass number; what the shield stops was never counted."""
        options = self.options
        kinds = np.array(NUCLEI if options.nuclei else NUCLEI[:1])
        kind = rng.choice(len(kinds), size=n_cosmic, p=kinds[:, 2] / kinds[:, 2].sum())
        charge = np.concatenate([kinds[kind, 0], np.ones(n_trapped)])
        mass = np.concatenate([kinds[kind, 1], np.ones(n_trapped)])
        threshold = max(energy_of_rigidity_mev(cutoff_gv), self._stopped_mev)
        energy = np.concatenate(
            [
                self._spectrum.draw_mev(rng, n_cosmic, threshold),
                draw_trapped_mev(rng, n_trapped, self._stopped_mev),
            ]
        )
        behind = self._shield.energy_behind_mev_u(energy, options.shield_mm, charge, mass)
        return behind, charge, mass

    def _electrons(
        self,
        rng: np.random.Generator,
        energy_mev_u: NDArray[np.float64],
        charge: NDArray[np.float64],
        mass: NDArray[np.float64],
        path_um: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Electron-hole pairs along each track; 0 for particles that did not arrive."""
        arrived = energy_mev_u > 0.0
        energy = np.where(arrived, energy_mev_u, 1.0)
        if self.options.straggling:
            loss_kev = draw_loss_kev(rng, energy, path_um, charge, SILICON, self._landau)
        else:
            loss_kev = stopping_power_mev_cm2_g(energy, SILICON, charge) * SILICON.density_g_cm3 * path_um * 1e-4 * 1e3
        # No particle leaves more than it has.
        pairs = np.minimum(loss_kev, 1e3 * energy * mass) * 1e3 / PAIR_EV
        pairs = pairs + np.sqrt(FANO * pairs) * rng.standard_normal(pairs.size)
        return np.where(arrived, np.maximum(pairs, 0.0), 0.0)
