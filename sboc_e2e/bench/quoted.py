"""Published figures of peers that cannot be installed from the package index, with their sources; quoted, not measured here."""

from typing import Final

QUOTED_PEERS: Final = (
    (
        "pyradon (fast Radon transform)",
        "34.8 CPU-s per 2048 x 2048 frame (8.3 s per Mpx); finds S/N 10 at 400 px, S/N 15 at 20 and 100 px",
        "run once with github.com/guynir42/pyradon at 1a430, threshold 7, stars masked; method: Nir et al. 2018, AJ 156, 229",
    ),
    (
        "ASTRiDE 0.3.8",
        "1.1 CPU-s per 2048 x 2048 frame; at 100 px nothing below S/N 50",
        "run once with github.com/dwkim78/ASTRiDE at 83d9bce",
    ),
    (
        "StreakDet",
        "about 90 % of streaks > 100 px at S/N > 1 per pixel; 13 s per 2048 x 2048 frame",
        "Virtanen et al. 2016, Advances in Space Research 57, 1607 (abstract)",
    ),
    (
        "ESA optical in-situ monitor, Difference Method",
        "peak S/N 2 per pixel; under 1 s for two frames",
        "Vives Vallduriola et al. 2018 (abstracts)",
    ),
    (
        "SBV on MSX",
        "metric accuracy goal of 4 arcsec met; 32 % of frame sets showed false streaks",
        "MIT Lincoln Laboratory, SBV software page and metric accuracy paper (abstracts)",
    ),
)
