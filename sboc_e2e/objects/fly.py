"""One scenario from pixels to a catalogue: visits, tracklets, store, orbits, and a page that holds them against the truth."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from ground.store.store import ObjectStore
from sboc_e2e.files.atomic import write_json
from sboc_e2e.objects.against_truth import Truth, expected_visits, score, sections
from sboc_e2e.objects.page import write_page
from sboc_e2e.objects.places import place_of_ephemeris
from sboc_e2e.objects.upkeep import bring_up, observe
from sboc_e2e.objects.visits import visits_of
from sboc_e2e.registry import Registry
from sboc_e2e.run.pipeline import RunRequest, run
from sboc_e2e.run.progress import Progress
from sboc_e2e.scenario import Scenario
from simulator.platform import earth
from simulator.scene.sources import orbiting

STORE: Final = "objects.db"
PAGE: Final = "catalogue.html"
SCORE: Final = "catalogue.json"
WINDOW_DAYS: Final = 30.0
"""The most that an update looks back: all visits."""


def fly(found: Scenario, hours: Sequence[float], out: Path, registry: Registry, workers: int, progress: Progress) -> list[str]:
    """Fly the visits, bring the store up after each of them, score it; a line for each step.

    Visits that are done are not flown again, and the store takes no tracklet twice: the same call goes on after an interruption.
    """
    scenarios, orbits = visits_of(found, hours, registry)
    store, lines, folders = str(out / STORE), [], []
    ends = []
    for number, scenario in enumerate(scenarios):
        folder = out / f"visit-{number:02d}"
        run(RunRequest(scenario=scenario, out=folder, resume=folder.exists(), workers=workers), progress)
        start = earth.tai_ns_of_utc(scenario.simulator.epoch_utc)
        end = start + round(1e9 * (scenario.simulator.frames / scenario.simulator.frame_rate_hz + 1.0))
        products = folder / "products"
        place = place_of_ephemeris(products / "observer.oem")
        taken = observe(store, [products / "tracklets.tdm"], place, found.name, None)
        lines += [f"{folder.name}: {taken}", f"{folder.name}: {bring_up(store, earth.utc_text(end)[:-3], WINDOW_DAYS, 1)}"]
        folders.append(folder)
        ends.append(end)
    epoch = earth.tai_ns_of_utc(scenarios[0].simulator.epoch_utc)
    names = [o.name for o in orbits]
    truth = Truth(
        epoch_tai_ns=epoch,
        objects={o.name: orbiting(o, epoch) for o in orbits},
        expected=expected_visits(folders, names),
    )
    opened = ObjectStore(store)
    judged = score(opened, truth, ends[-1])
    opened.close()
    write_json(out / SCORE, judged.as_json())
    reports = {f"{hour:g} h": f"{folder.name}/report.html" for hour, folder in zip(hours, folders, strict=True)}
    page = write_page(store, earth.utc_text(ends[-1])[:-3], out / PAGE, tuple(sections(judged, reports)))
    return [*lines, str(page)]
