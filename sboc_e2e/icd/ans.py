"""Asymmetric numeral systems: the numbers of `rans` blocks that coder and decoder agree on (ICD.md, section 4)."""

import struct
from typing import Final

HEAD = struct.Struct(">Bh")
"""Head of a `RANS` block: noise code, centre code; then the states of the coders and 16-bit words."""

STATES: Final = 4  # Interleaved coders of a block: a processor works on four at a time. Chosen; part of the format.
STATE_BYTES: Final = 5  # Bytes of a coder's state: states are below `LOWEST` * 2**16 = 2**40.
LOWEST: Final = 1 << 24  # Least state: 256 `SCALE`, so that rounding a state changes a probability by less than 1/256.
SCALE: Final = 1 << 16  # Sum of the frequencies of a class; the slot of a token is the lower 16 bits of the state.
TOKENS: Final = 81
"""Coders of a `RANS` block, bytes of each one's state, least state, sum of the frequencies of a class, tokens."""

PLAIN: Final = 32
"""Zigzag codes below this are tokens themselves. Of larger codes, some bits are sent without coding."""

ESCAPE: Final = TOKENS - 1
"""Token of a value sent as 32 bits."""

NEIGHBOUR_LIMIT: Final = 4095
"""Neighbours are clipped at this distance from the level, so that five of them fit into 16 bits."""

LEAST_SIGMA: Final = 0.0625  # Noise (ADU) of noise code 0; integers alone scatter by 0.29 ADU. Code 255 is 3,900 ADU.
CODES_PER_OCTAVE: Final = 16  # Noise codes per factor of two: a noise wrong by 2.2 % at most costs 7e-4 bits a pixel at most.
CENTRE_CODES_PER_SIGMA: Final = 16
"""Noise of noise code 0, noise codes per factor of two, centre codes per noise."""

LIMITS_SIGMA: Final = (-0.5, 0.4, 0.8, 1.2, 1.7, 2.5, 4.0, 8.0, 20.0, 80.0)
"""Limits of a pixel's class in `RANS` blocks: the weighted mean of its neighbours over the noise."""

CLASSES: Final = (
    (-0.05, 0.97, 0.024, 1.09, 0.0001),
    (-0.04, 0.98, 0.022, 1.34, 0.0001),
    (-0.05, 0.98, 0.037, 1.40, 0.0001),
    (0.03, 1.02, 0.104, 1.68, 0.0001),
    (-0.05, 0.97, 0.058, 1.60, 0.0001),
    (0.05, 0.98, 0.301, 1.70, 0.0001),
    (-0.05, 0.98, 0.147, 2.09, 0.0001),
    (0.56, 1.19, 0.185, 2.20, 0.0001),
    (-0.01, 1.02, 0.496, 2.79, 0.0001),
    (0.58, 1.01, 0.384, 2.23, 0.0001),
    (-0.27, 1.01, 0.908, 3.99, 0.0001),
    (1.68, 1.60, 0.243, 2.63, 0.0001),
    (5.37, 2.90, 0.533, 8.48, 0.0001),
    (3.77, 2.40, 0.324, 4.34, 0.0028),
    (11.7, 5.10, 0.509, 19.9, 0.0010),
    (10.4, 5.00, 0.494, 12.8, 0.0010),
    (32.6, 13.8, 0.528, 62.2, 0.0010),
    (39.4, 16.1, 0.662, 81.8, 0.0200),
    (129.0, 57.0, 0.597, 674.0, 0.0200),
)
"""Distribution of the values of each class about the centre, in units of the noise: mean and width of a Gaussian; share and scale
of an exponential above the centre (light that begins here); share of a flat distribution. Fitted to simulated frames of stars."""
