"""A run does not depend on the day it is made on: the installed Earth-orientation data serve whatever their age."""

import subprocess
import sys

IN_2040 = """
from astropy.time import Time
now = Time("2040-01-01")
Time.now = classmethod(lambda cls: now)
from simulator.platform import earth
print(earth.itrs_from_gcrs(earth.tai_ns_of_utc("2027-01-29T00:00:00")).tobytes().hex())
"""
TODAY = "from simulator.platform import earth\n" + IN_2040.strip().rpartition("\n")[2]


def printed(program: str) -> str:
    """Output of a process of its own: what other tests set in this one does not help it."""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_earth_is_oriented_alike_in_2040():
    assert printed(IN_2040) == printed(TODAY)
