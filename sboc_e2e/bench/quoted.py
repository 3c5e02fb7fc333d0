"""Published figures of peers that cannot be installed from the package index, with their sources; quoted, not measured here."""

from typing import Final

QUOTED_PEERS: Final = (
    ("pyradon (fast Radon transform)", "34.8 CPU-s per 2048 x 2048 frame (median 8.3 s per Mpx), S/N half about 8.5-12",
     "measured with github.com/guynir42/pyradon at 1a430, threshold 7, stars masked; method: Nir et al. 2018, AJ 156, 229"),
    ("ASTRiDE 0.3.8", "1.1 CPU-s per 2048 x 2048 frame; finds nothing below 3 sigma per pixel (L = 100: S/N 50 to 100)",
     "measured with github.com/dwkim78/ASTRiDE at 83d9bce"),
    ("StreakDet", "90 % of streaks > 100 px at S/N > 1 per pixel; 13 s per 2048 x 2048", "Virtanen et al. 2016, Adv. Space Res. 57, 1607"),
    ("ESA optical in-situ monitor", "peak S/N 2 per pixel; below 1 s for two frames", "Vives Vallduriola et al. 2018, ARCS"),
    ("SBV on MSX", "metric accuracy 4 arcsec (2 after attitude correction); 32 % of frame sets with false streaks",
     "MIT Lincoln Laboratory SBV publications"),
)  # fmt: skip
