"""Random streams of the simulator: one generator for each physical effect, frame and block.

A stream depends only on ``(seed, effect, frame, block)``. Adding an effect therefore does not change other noise, and
any worker may make any frame with the same bytes. The table is append-only: numbers are never reused.
"""

from enum import IntEnum

import numpy as np


class Effect(IntEnum):
    """Numbers of the physical effects. They are part of the meaning of a seed: append only, and use no number twice."""

    POPULATION = 1  # which debris is met (frame 0)
    FAINT_STARS = 2  # synthetic stars; block is the HEALPix pixel
    CATALOGUE_ERRORS = 3  # displacement of the true sky from the catalogue
    JITTER = 4  # attitude jitter; block is the axis
    ATTITUDE_ERROR = 5  # star-tracker noise of each frame
    OBSERVER_ERROR = 6  # GPS position and velocity noise of each frame
    TIME_TAG = 7  # clock jitter of each frame
    LIGHT_CURVE = 8  # tumbling periods, phases and glints (frame 0)
    SCINTILLATION = 9  # of each frame
    CLOUDS = 10  # cloud layer
    SENSOR_MAP = 11  # fixed pattern of a sensor (frame 0)
    DEFECTS = 12  # hot, warm, dead and telegraph pixels (frame 0)
    TELEGRAPH = 13  # state of telegraph pixels in each frame
    SHOT_AND_READ = 14  # block is the row block
    ROW_COLUMN_NOISE = 16
    RADIATION = 17  # particle hits of each frame
    CALIBRATION = 18  # noise of dark and flat calibration frames
    TURBULENCE = 19  # brightness and place of an object during a frame; block is the object
    WAVEFRONT = 20  # errors of the wavefront (frame 0)
    AS_BUILT = 21  # departures of the built camera (frame 0)
    ROW_STRUCTURE = 22  # row and column structure of each frame
    BLACK_LEVEL = 23  # drift of the black level
    COMPANIONS = 24  # binaries and variables of the sky
    SURVEY = 25  # passages of a block of a survey; block is the size class, 0 the instants
    FLAT_ERRORS = 26  # what flats of another date and lamp get wrong
    BREAKUP = 27  # pieces of a break-up (frame: its number in the scenario)
    ASTEROIDS = 28  # orbits of the main belt
    GALAXIES = 29  # galaxies; block is the HEALPix pixel
    CIRRUS = 30  # structure of the unresolved light
    CLUSTERS = 31  # members of globular clusters; block is the NGC number


def generator(seed: int, effect: Effect | int, frame: int = 0, block: int = 0) -> np.random.Generator:
    """The stream of one effect in one frame and block.

    PCG64DXSM seeded by ``SeedSequence(seed, spawn_key=(effect, frame, block))`` (independent streams by hashing).
    """
    sequence = np.random.SeedSequence(seed, spawn_key=(int(effect), int(frame), int(block)))
    return np.random.Generator(np.random.PCG64DXSM(sequence))


def seed_word(seed: int, effect: Effect | int, frame: int = 0, block: int = 0) -> int:
    """A 64-bit word of the same stream, for kernels that carry their own counter-based generator."""
    sequence = np.random.SeedSequence(seed, spawn_key=(int(effect), int(frame), int(block)))
    return int(sequence.generate_state(1, np.uint64)[0])
