"""UT1 and polar motion against astropy's reader of the same IERS tables."""

import numpy as np
import pytest
from astropy.time import Time
from astropy.utils import iers

from sboc_e2e.icd import tai
from simulator.platform import earth_orientation

BESIDE_LEAP_SECOND = (57753.9999, 57754.0001)
"""UTC days around the end of 2016."""


@pytest.fixture(scope="module")
def table() -> iers.IERS:
    return iers.earth_orientation_table.get()


def test_ut1_and_pole_agree_with_astropy(table):
    last = earth_orientation.daily_values().mjd[-1]
    days = np.concatenate([np.random.default_rng(1).uniform(41684.0, last, 300), BESIDE_LEAP_SECOND])
    for day in days:
        time = Time(day, format="mjd", scale="utc")
        found = earth_orientation.at(tai.from_jd_parts(time.tai.jd1, time.tai.jd2))
        reference = time.ut1
        assert abs((found.ut1[0] - reference.jd1) + (found.ut1[1] - reference.jd2)) * 86400.0 < 1e-7
        x, y = table.pm_xy(time.jd1, time.jd2)
        assert abs(found.x_rad - x.to_value("rad")) < 5e-12  # 1 microarcsecond
        assert abs(found.y_rad - y.to_value("rad")) < 5e-12


def test_the_table_is_daily_and_ends_with_predictions(table):
    days = earth_orientation.daily_values().mjd
    assert np.all(np.diff(days) == 1.0)
    assert days[0] == table["MJD"][0].value
    assert days[-1] == table["MJD"][-1].value
