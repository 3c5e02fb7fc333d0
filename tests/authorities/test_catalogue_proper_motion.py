"""Proper motion against ERFA's starpm (the rigorous model of stellar motion in space)."""

import erfa
import numpy as np

from sboc_e2e.catalogue.proper_motion import propagate

MICROARCSEC_DEG = 1.0 / 3.6e9


def test_positions_and_motions_agree_with_erfa_over_the_whole_sky():
    rng = np.random.default_rng(8)
    n = 300
    ra_deg = rng.uniform(0.0, 360.0, n)
    dec_deg = np.degrees(np.arcsin(rng.uniform(-1.0, 1.0, n)))
    dec_deg[:2] = 89.9999, -89.9999
    pm_ra, pm_dec = rng.normal(0.0, 300.0, (2, n))
    pm_ra[5], pm_dec[5] = -801.0, 10_362.0  # Barnard's star
    years = 27.0
    jd0 = 2451545.0
    # ERFA takes dRA/dt without cos(dec), and needs a parallax: 1e-3 arcsec keeps the transverse speed below its limit of 0.5 c
    ra, dec, dra, ddec, _, _ = erfa.starpm(
        np.radians(ra_deg),
        np.radians(dec_deg),
        np.radians(pm_ra / 3.6e6) / np.cos(np.radians(dec_deg)),
        np.radians(pm_dec / 3.6e6),
        0.1,
        0.0,
        jd0,
        0.0,
        jd0 + years * 365.25,
        0.0,
    )
    got_ra, got_dec, got_pm_ra, got_pm_dec = propagate(ra_deg, dec_deg, pm_ra, pm_dec, years)
    d_ra = ((got_ra - np.degrees(ra)) + 180.0) % 360.0 - 180.0
    assert np.abs(d_ra * np.cos(dec)).max() < 10 * MICROARCSEC_DEG
    assert np.abs(got_dec - np.degrees(dec)).max() < 10 * MICROARCSEC_DEG
    assert np.abs(got_pm_ra - np.degrees(dra) * np.cos(dec) * 3.6e6).max() < 0.01
    assert np.abs(got_pm_dec - np.degrees(ddec) * 3.6e6).max() < 0.01
