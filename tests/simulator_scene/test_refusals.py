"""Input that no simulation can honour is refused in one line that names it, by the command itself."""

import numpy as np
import pytest

from sboc_e2e.catalogue import StarCatalogue
from sboc_e2e.cli.main import run

SMALL = ("frames=1", "instrument.rows=128", "instrument.cols=128", "population.classes=[]", "objects.passing=[]")
# Object 28872 of SGP4's verification set, which decays within the hour of its epoch in 2005.
DECAYED = (
    "1 28872U 05037B   05333.02012661  .25992681  00000-0  24476-3 0  153",
    "2 28872  96.4736 157.9986 0303955 244.0492 110.6523 16.46015938 1070",
)


def checksum(line):
    return f"{line}{sum(int(c) if c.isdigit() else c == '-' for c in line) % 10}"


def words_of(capsys, tmp_path, *overrides):
    arguments = [word for override in (*SMALL, *overrides) for word in ("--set", override)]
    assert run(["run", "smoke", "--out", str(tmp_path / "run"), *arguments]) == 2
    refusals = [line for line in capsys.readouterr().err.splitlines() if line.startswith("sboc: ")]
    assert len(refusals) == 1
    return refusals[0]


def test_an_element_set_that_sgp4_refuses(tmp_path, capsys):
    lines = [checksum(line.ljust(68, "0")) for line in DECAYED]
    file = tmp_path / "decayed.tle"
    file.write_text("0 DECAYED\n" + "\n".join(lines) + "\n")
    refusals = words_of(capsys, tmp_path, f'objects.satellites.file="{file}"', 'objects.satellites.names=["DECAYED"]')
    assert "satellite 'DECAYED'" in refusals
    assert "refused by SGP4" in refusals


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ('objects.orbit=[{name="deep",semi_major_axis="7000 km",eccentricity=0.3}]', "objects.orbit 'deep': perigee height"),
        ('objects.encounter=[{name="near",range="200000 km",heading="0 deg"}]', "objects.encounter 'near'"),
        ('objects.passing=[{name="gone",range="900000 km"}]', "objects.passing 'gone'"),
        ('epoch_utc="2099-01-01T00:00:00"', "2099-01-01 lies outside the Earth-orientation data"),
        ("epoch_utc=yesterday", "scenario smoke: epoch_utc: 'yesterday' is not an ISO-8601 date"),
        ('epoch_utc="1950-01-01T00:00:00"', "1950-01-01 lies outside the Earth-orientation data"),
    ],
)
def test_objects_and_epochs_that_cannot_be(override, words, tmp_path, capsys):
    assert words in words_of(capsys, tmp_path, override)
    assert not (tmp_path / "run").exists()


def test_a_catalogue_without_stars_in_the_field(tmp_path, capsys, monkeypatch):
    cone = StarCatalogue.cone

    def without_any(self, *place, **kwargs):
        stars = cone(self, *place, **kwargs)
        return stars.take(np.zeros(len(stars), dtype=bool))

    monkeypatch.setattr(StarCatalogue, "cone", without_any)
    refusals = words_of(capsys, tmp_path)
    assert "star catalogue Tycho-2" in refusals
    assert "covers the field" in refusals
