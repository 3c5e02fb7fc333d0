"""The object catalogue from the command line: what is in it, and what leaves it."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from ground.determination.forces import ForceModel
from ground.determination.precise import Ephemeris, free_orbit, read_cpf, read_sp3
from ground.products.epochs import utc_text
from ground.store.exports import messages, parquet_tables
from ground.store.store import ObjectStore, StoredOrbit
from sboc_e2e.icd.errors import UserError
from sboc_e2e.objects.texts import text_of

KINDS: Final = ("opm", "oem", "omm", "parquet")
MADE_BY: Final = "sboc objects add"
"""What the store's decisions name as their maker."""


def ephemerides_of(path: Path) -> dict[str, Ephemeris]:
    """Objects of an SP3 or CPF file."""
    if not path.is_file():
        raise UserError(f"{path}: no such file")
    raw = path.read_bytes()
    if raw.startswith((b"#", b"\x1f\x9d")):
        return read_sp3(raw, path.name)
    if raw[:6].upper() == b"H1 CPF":
        one = read_cpf(text_of(path), path.name)
        return {one.name: one}
    raise UserError(f"{path.name}: neither SP3 (also .Z) nor CPF")


def add_precise(url: str, path: Path, names: list[str]) -> list[str]:
    """Fit orbits to objects of a precise ephemeris and put them into the store; a line for each.

    An object that was merged is the one that it was merged into, and one that is lost or retired becomes active. Objects that no
    free orbit fits, and those whose orbit in the store is of later data, are left out, with a line that says so. UserError where
    that leaves none.
    """
    found = ephemerides_of(path)
    unknown = [n for n in names if n not in found]
    if unknown:
        raise UserError(f"{path.name}: no object {', '.join(unknown)}; there are {', '.join(sorted(found))[:200]}")
    store = ObjectStore(url)
    lines, left_out = [], []
    for name in names or sorted(found):
        try:
            solution = free_orbit(found[name], ForceModel(gravity_degree=20))
        except UserError as error:
            left_out.append(str(error))
            continue
        made = int(found[name].t_tai_ns[-1])
        try:
            row = _kept(store.objects(), name)
            _require_newer(store, row, name, made)
        except UserError as error:
            left_out.append(str(error))
            continue
        with store.transaction() as writer:
            number = row["object_id"] if row else writer.add_objects([name], made)[0]
            parameters = {p: solution.forces.value_of(p) for p in solution.parameters}
            writer.add_orbits([
                StoredOrbit(
                    object_id=number, epoch_tai_ns=solution.t0_tai_ns, state=solution.state,
                    covariance=solution.covariance, made_tai_ns=made, made_by=f"fit to {path.name}"[:64],
                    parameters=parameters, chi2_nu=solution.chi2_nu, n_used=int((solution.weights > 0.0).sum()),
                )
            ])  # fmt: skip
            if row and row["status"] != "active":
                writer.set_status(number, "active", by=MADE_BY, at_tai_ns=made, why="a precise ephemeris gives its orbit")
        whose = f"{name} (merged into {row['name']})" if row and row["name"] != name else name
        again = f", {row['status']} until now" if row and row["status"] != "active" else ""
        lines.append(f"{whose}: {len(found[name].t_tai_ns)} places, {173.2 * solution.rms:.2f} mm rms of 100 mm (3-D){again}")
    store.close()
    if not lines:
        raise UserError(f"{path.name}: no object is added: {left_out[0]}")
    return lines + [f"left out: {reason}" for reason in left_out]


def _kept(objects: Sequence[Mapping[str, Any]], name: str) -> Mapping[str, Any] | None:
    """The row of an object by name, or of the one that it was merged into; None for a new name."""
    by_number = {row["object_id"]: row for row in objects}
    row = next((row for row in objects if row["name"] == name), None)
    while row is not None and row["status"] == "merged":
        row = by_number.pop(row["merged_into"], None)
        if row is None:
            raise UserError(f"{name}: it was merged, and the store does not say into what")
    return row


def _require_newer(store: ObjectStore, row: Mapping[str, Any] | None, name: str, last_tai_ns: int) -> None:
    """UserError where the current orbit of an object is of later data than a table that ends at an epoch."""
    for orbit in store.orbits(row["object_id"]) if row else ():
        # an orbit of a table is made at its last place; the epoch of one of tracklets is at the last of them
        latest = orbit.epoch_tai_ns if "radiation" in orbit.parameters else orbit.made_tai_ns
        if latest > last_tai_ns:
            ends, has = utc_text([last_tai_ns, latest], 0)
            raise UserError(f"{name}: the table ends at {ends}, and its orbit in the store is of data up to {has}")


def state_lines(url: str) -> list[str]:
    """What a store holds."""
    if "://" not in url and not Path(url).is_file():
        raise UserError(f"{url}: no such store")
    store = ObjectStore(url)
    counts = store.counts()
    lines = [", ".join(f"{n} {name}" for name, n in counts.items())]
    names = {row["object_id"]: row for row in store.objects()}
    for orbit in store.orbits()[:50]:
        row = names[orbit.object_id]
        sigma_m = 1e3 * float((orbit.covariance[0, 0] + orbit.covariance[1, 1] + orbit.covariance[2, 2]) ** 0.5)
        lines.append(
            f"{orbit.object_id:6d} {row['name']:<20} {row['status']:<8} n {orbit.n_used:5d}  chi2/nu {orbit.chi2_nu:6.3f}  "
            f"position {sigma_m:.3g} m  {orbit.made_by}"
        )
    store.close()
    return lines


def export(url: str, kind: str, out: Path, originator: str, days: float) -> list[str]:
    """Write the store's orbits; a line of how many files, and one for each object that no message describes.

    UserError where that leaves none.
    """
    if kind not in KINDS:
        raise UserError(f'--as: expected {", ".join(KINDS)}, got "{kind[:20]}"')
    if "://" not in url and not Path(url).is_file():
        raise UserError(f"{url}: no such store")
    store = ObjectStore(url)
    left_out: list[str] = []
    if kind == "parquet":
        written = len(parquet_tables(store, out))
    else:
        texts, left_out = messages(store, kind, originator, days)
        if left_out and not texts:
            raise UserError(f"export: no orbit is written: {left_out[0]}")
        out.mkdir(parents=True, exist_ok=True)
        for name, text in texts.items():
            (out / name).write_text(text, encoding="utf-8")
        written = len(texts)
    store.close()
    return [f"{written} files in {out}", *(f"left out: {reason}" for reason in left_out)]
