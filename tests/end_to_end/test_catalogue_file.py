"""A catalogue that the user builds from a Gaia table, through the command line, and what is said when it is not whole."""

from pathlib import Path

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest
from astropy.table import Table

from sboc_e2e import cli
from sboc_e2e.catalogue import CatalogueFlag, StarCatalogue
from sboc_e2e.catalogue.gaia import BP_RP_OF_B_V, G_MINUS_V
from sboc_e2e.run.pipeline import Run
from tests.end_to_end.conftest import tiny


def gaia_table(path: Path, ra_deg: float, dec_deg: float) -> int:
    """Stars of the embedded catalogue around a direction as Gaia would list them; returns their number."""
    stars = StarCatalogue.embedded().cone(ra_deg, dec_deg, 6.0, epoch_jyear=2016.0)
    whole = (stars.flags & (CatalogueFlag.NO_PROPER_MOTION | CatalogueFlag.ONE_BAND)) == 0
    bp_rp = np.polynomial.polynomial.polyval(np.clip(stars.b_v[whole], -0.3, 2.0), BP_RP_OF_B_V)
    table = Table(
        {
            "source_id": np.arange(whole.sum(), dtype=np.int64) + 10**15, "ra": stars.ra_deg[whole], "dec": stars.dec_deg[whole],
            "pmra": stars.pm_ra_mas_yr[whole], "pmdec": stars.pm_dec_mas_yr[whole],
            "phot_g_mean_mag": stars.v_mag[whole] + np.polynomial.polynomial.polyval(bp_rp, G_MINUS_V), "bp_rp": bp_rp,
            "ref_epoch": np.full(whole.sum(), 2016.0),
        }
    )  # fmt: skip
    if path.suffix == ".parquet":
        columns = {name: np.asarray(table[name]) for name in table.colnames}
        pyarrow.parquet.write_table(pyarrow.table(columns), path)
    else:
        table.write(path)
    return int(whole.sum())


def frames_of(run: Path) -> Table:
    return Table.read(run / "products" / "frames.ecsv", format="ascii.ecsv")


@pytest.mark.slow
def test_a_catalogue_built_from_a_gaia_table_solves_the_frames(
    finished: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = frames_of(finished.directory.path)
    n_stars = gaia_table(tmp_path / "gaia.fits", float(before["ra_app_deg"][0]), float(before["dec_app_deg"][0]))
    assert cli.run(["catalogue", "build", str(tmp_path / "gaia.fits"), "--out", str(tmp_path / "gaia.npz")]) == 0
    assert f"gaia.npz: {n_stars} stars" in capsys.readouterr().out
    made = tmp_path / "run"
    with_gaia = ["--set", f"ground.catalogue_file={tmp_path / 'gaia.npz'}"]
    assert cli.run(["run", str(tiny(tmp_path)), "--out", str(made), "--workers", "1", *with_gaia]) == 0
    after = frames_of(made)
    assert np.array_equal(after["solved"], before["solved"])
    assert np.all(after["solved"])
    # Directions agree to a fifth of a pixel of 36 arcsec; the stars are the same but for the few without motion or colour.
    apart_arcsec = np.hypot(
        (after["ra_app_deg"] - before["ra_app_deg"]) * np.cos(np.radians(before["dec_app_deg"])),
        after["dec_app_deg"] - before["dec_app_deg"],
    ) * 3600.0  # fmt: skip
    assert apart_arcsec.max() < 7.0
    assert np.all(np.abs(after["zero_point_mag"] - before["zero_point_mag"]) < 0.1)


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["ecsv", "parquet"])
def test_one_option_gives_both_halves_the_same_gaia_stars(
    finished: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str], suffix: str
) -> None:
    """`stars.catalogue_file`: the sky shines with the stars of a Gaia table, and ground solves frames with them."""
    before = frames_of(finished.directory.path)
    table = tmp_path / f"gaia.{suffix}"
    gaia_table(table, float(before["ra_app_deg"][0]), float(before["dec_app_deg"][0]))
    assert cli.run(["catalogue", "build", str(table), "--out", str(tmp_path / "gaia.npz")]) == 0
    made = tmp_path / "run"
    both = ["--set", f"stars.catalogue_file={tmp_path / 'gaia.npz'}", "--set", "output.keep_frames_every=0"]
    assert cli.run(["run", str(tiny(tmp_path)), "--out", str(made), "--workers", "1", *both]) == 0
    truth = Table.read(made / "truth" / "stars.ecsv", format="ascii.ecsv")
    assert len(truth) > 20
    assert np.all(truth["star_id"] >= 10**15)  # neither Tycho-2 nor drawn stars
    after = frames_of(made)
    assert np.all(after["solved"])
    assert np.all(after["n_stars"] > 10)


def test_a_sky_that_cannot_be_read_is_named_by_its_key(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    key = f"stars.catalogue_file={tmp_path / 'none.npz'}"
    assert cli.run(["run", str(tiny(tmp_path)), "--out", str(tmp_path / "run"), "--set", key]) == 2
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("sboc: ")]
    assert "stars.catalogue_file: star catalogue" in line
    assert "no such file; make one with" in line


def empty(catalogue: Path, out: Path) -> None:
    """A whole, well-formed catalogue file without stars."""
    with np.load(catalogue) as archive:
        content = {key: archive[key] for key in archive.files}
    for key, values in content.items():
        if values.ndim == 2 and key != "fast_pm":
            content[key] = values[:, :0]
        elif key == "counts":
            content[key] = np.zeros_like(values)
        elif values.ndim:
            content[key] = values[:0]
    np.savez_compressed(out, **content)


def test_a_catalogue_that_is_missing_or_not_whole_is_one_line_before_any_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    gaia_table(tmp_path / "gaia.ecsv", 130.0, 18.0)
    good = tmp_path / "good.npz"
    assert cli.run(["catalogue", "build", str(tmp_path / "gaia.ecsv"), "--out", str(good)]) == 0
    (tmp_path / "cut.npz").write_bytes(good.read_bytes()[: good.stat().st_size // 2])
    (tmp_path / "text.npz").write_text("no catalogue")
    empty(good, tmp_path / "empty.npz")
    for name, words in (
        ("none.npz", "no such file; make one with"),
        ("cut.npz", "make it again"),
        ("text.npz", "make it again"),
        ("empty.npz", "holds no stars"),
    ):
        capsys.readouterr()
        out = tmp_path / "run"
        key = f"ground.catalogue_file={tmp_path / name}"
        assert cli.run(["run", str(tiny(tmp_path)), "--out", str(out), "--set", key]) == 2
        (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("sboc: ")]
        assert words in line
        assert not out.exists()


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("none.fits", None, "no such file"),
        ("table.txt", "ra dec", "expected .fits, .ecsv or .parquet"),
        ("cut.fits", "SIMPLE  =", "cannot be read"),
        ("cut.ecsv", "# %ECSV 1.0\n# ---\n", "cannot be read"),
        (
            "dark.ecsv",
            "# %ECSV 1.0\n# ---\n# datatype:\n# - {name: ra, datatype: float64}\n# - {name: dec, datatype: float64}\n"
            "# - {name: phot_g_mean_mag, datatype: float64}\nra dec phot_g_mean_mag\n10.0 20.0 nan\n",
            "none of 1 stars has a magnitude",
        ),
    ],
)
def test_a_gaia_table_that_cannot_be_read_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, content: str | None, words: str
) -> None:
    if content is not None:
        (tmp_path / name).write_text(content)
    assert cli.run(["catalogue", "build", str(tmp_path / name), "--out", str(tmp_path / "out.npz")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert words in line
    assert not (tmp_path / "out.npz").exists()
