"""Swappable steps by name: entry points of installed packages, or ``module:Class`` that the user typed or trusted.

The only module that imports dynamically. A scenario file may name installed entry points freely; a ``module:Class`` in
a file is loaded only when its module was trusted on the command line (``--plugin my_lab``), so that a scenario from
somebody else cannot run code.
"""

import dataclasses
import importlib
import re
import sys
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, Final

from sboc_e2e.icd import steps
from sboc_e2e.icd.errors import SbocError, UserError

GROUP_PREFIX: Final = "sboc_e2e."
DISTRIBUTION: Final = "sboc-e2e"
_CLASS_PATH: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(\.[A-Za-z_][A-Za-z0-9_]*)*:[A-Za-z_][A-Za-z0-9_]*")


@dataclass(frozen=True, kw_only=True)
class Seam:
    """A place where a step can be swapped: its Protocol, the methods that it asks for and the step used by default."""

    name: str
    protocol: type
    methods: tuple[str, ...]
    default: str


SEAMS: Final[dict[str, Seam]] = {
    seam.name: seam
    for seam in (
        Seam(name="onboard.background", protocol=steps.BackgroundEstimator, methods=("estimate",), default="mesh"),
        Seam(name="onboard.star_extractor", protocol=steps.StarExtractor, methods=("extract",), default="matched"),
        Seam(name="onboard.detector", protocol=steps.Detector, methods=("detect",), default="line_integral"),
        Seam(name="onboard.tracker", protocol=steps.Tracker, methods=("initial_state", "track"), default="none"),
        Seam(name="onboard.codec", protocol=steps.Encoder, methods=("encode",), default="planes"),
        Seam(name="ground.decoder", protocol=steps.Decoder, methods=("decode",), default="planes"),
        Seam(name="ground.streak_fitter", protocol=steps.StreakFitter, methods=("fit",), default="trailed_psf"),
        Seam(name="ground.vetter", protocol=steps.Vetter, methods=("probability",), default="likelihood"),
        Seam(name="ground.astrometry", protocol=steps.Astrometer, methods=("initial_state", "solve"), default="camera_fit"),
        Seam(name="ground.photometry", protocol=steps.Photometer, methods=("calibrate",), default="zero_point"),
        Seam(name="ground.linker", protocol=steps.Linker, methods=("link",), default="motion"),
        Seam(name="ground.orbit", protocol=steps.OrbitDeterminer, methods=("estimate",), default="range_scan"),
    )
}


@dataclass(frozen=True, kw_only=True)
class Registry:
    """Finds step classes. `trusted_modules`: modules (with all below them) that the user trusts to be imported."""

    trusted_modules: tuple[str, ...] = field(default=())

    def names(self, seam: str) -> tuple[str, ...]:
        """Names of the installed steps of a seam."""
        return tuple(sorted(_installed(_seam(seam).name)))

    def resolve(self, seam: str, name: str, *, typed: bool = False) -> type:
        """The step class of a name or ``module:Class``.

        typed : the user typed the name on the command line, which is trust enough for ``module:Class``.
        Raises `UserError` for unknown names, duplicates, broken imports and classes that do not fit the seam.
        """
        place = _seam(seam)
        if ":" in name:
            found = self._load_class(place, name, typed=typed)
        else:
            found = _load_installed(place, name)
        _fits(place, name, found)
        return found

    def decoder_for(self, name: str, codec: Any) -> Any | None:
        """The decoder that comes with a codec: installed under the codec's name, or of its module, with its codec number.

        name : what the codec was asked for by. None when there is none.
        """
        candidates: list[type] = []
        if ":" in name:
            module = sys.modules[type(codec).__module__]
            classes = (kind for kind in vars(module).values() if isinstance(kind, type))
            candidates = [kind for kind in classes if _is_step(SEAMS["ground.decoder"], kind)]
        elif name in self.names("ground.decoder"):
            candidates = [self.resolve("ground.decoder", name)]
        made = (_made(kind) for kind in candidates)
        return next((step for step in made if step is not None and step.number == codec.number), None)

    def load_class(self, path: str) -> type:
        """A class that the user typed as ``module:Class``, for `sboc check`."""
        return self._load_class(None, path, typed=True)

    def _load_class(self, seam: Seam | None, path: str, *, typed: bool) -> type:
        where = seam.name if seam else "plug-in"
        if not _CLASS_PATH.fullmatch(path):
            raise UserError(f'{where}: "{path[:80]}" is not of the form module:Class, such as my_lab.nets:StreakNet')
        module, _, attribute = path.partition(":")
        if not typed and not self._trusts(module):
            top = module.partition(".")[0]
            raise UserError(
                f'{where}: "{path}" is not loaded from a scenario file: trust its module with --plugin {top}, '
                f"or name an installed step: {', '.join(self.names(where)) or 'none'}"
            )
        return _import_class(where, path, module, attribute)

    def _trusts(self, module: str) -> bool:
        return any(module == trusted or module.startswith(trusted + ".") for trusted in self.trusted_modules)


def plugin_names(modules: Iterable[str]) -> tuple[str, ...]:
    """Checked module names of ``--plugin``."""
    names = tuple(modules)
    for name in names:
        if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*(\.[A-Za-z_][A-Za-z0-9_]*)*", name):
            raise UserError(f'--plugin: "{name[:80]}" is not the name of a Python module, such as my_lab or my_lab.nets')
    return names


def _seam(name: str) -> Seam:
    if name not in SEAMS:
        raise UserError(f'unknown seam "{name}"; known: {", ".join(SEAMS)}')
    return SEAMS[name]


@cache
def _all_points() -> Any:
    """What all installed packages announce; its type differs between versions of Python. To read it takes some milliseconds, and
    every seam asks.
    """
    return entry_points()


@cache
def _installed(seam: str) -> dict[str, tuple[EntryPoint, ...]]:
    """Entry points of a seam by name; more than one value for a name is a duplicate."""
    found: dict[str, dict[str, EntryPoint]] = {}
    for point in _all_points().select(group=GROUP_PREFIX + seam):
        found.setdefault(point.name, {})[point.value] = point
    return {name: tuple(points.values()) for name, points in found.items()}


def own_names(seam: str) -> tuple[str, ...]:
    """Names of the steps that this project itself ships."""
    return tuple(
        sorted(name for name, points in _installed(seam).items() if any(p.dist and p.dist.name == DISTRIBUTION for p in points))
    )


def _load_installed(seam: Seam, name: str) -> type:
    points = _installed(seam.name)
    if name not in points:
        raise UserError(f'{seam.name}: no step is called "{name[:80]}"; known: {", ".join(sorted(points)) or "none"}')
    if len(points[name]) > 1:
        owners = " and ".join(sorted(f"{p.value} of {p.dist.name if p.dist else '?'}" for p in points[name]))
        raise UserError(f'{seam.name}: two installed packages call a step "{name}": {owners}; uninstall or rename one')
    point = points[name][0]
    return _import_class(f"{seam.name}: {name}", point.value, point.module, point.attr)


def _import_class(where: str, path: str, module: str, attribute: str) -> type:
    """Import a class; everything that goes wrong in somebody's module becomes one line."""
    working_folder = str(Path.cwd())
    if working_folder not in sys.path:
        sys.path.append(working_folder)
    try:
        imported = importlib.import_module(module)
        found = getattr(imported, attribute)
    except SbocError:
        raise
    except AttributeError as error:
        if module in sys.modules and not hasattr(sys.modules[module], attribute):
            classes = [name for name, kind in vars(sys.modules[module]).items() if _is_own_class(kind, module)]
            raise UserError(
                f'{where}: {path} cannot be imported: AttributeError: {module} has no class "{attribute}"; '
                f"it has: {', '.join(sorted(classes)[:20]) or 'none'}"
            ) from error
        raise UserError(f"{where}: {path} cannot be imported: AttributeError: {_first_line(error)}") from error
    except ModuleNotFoundError as error:
        place = ""
        if error.name is not None and (module + ".").startswith(error.name + "."):
            place = f"; it is looked for in the working folder ({working_folder}) and among installed packages"
        raise UserError(f"{where}: {path} cannot be imported: ModuleNotFoundError: {_first_line(error)}{place}") from error
    except Exception as error:
        raise UserError(f"{where}: {path} cannot be imported: {type(error).__name__}: {_first_line(error)}") from error
    if not isinstance(found, type):
        raise UserError(f"{where}: {path} is a {type(found).__name__}; expected a class")
    return found


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0] if str(error) else "no reason given"


def _is_own_class(kind: object, module: str) -> bool:
    """Whether something in a module is a class that the module itself defines."""
    return isinstance(kind, type) and kind.__module__ == module


def _is_step(seam: Seam, found: type) -> bool:
    """Whether a class could be a step of a seam."""
    try:
        _fits(seam, found.__name__, found)
    except UserError:
        return False
    return True


def _made(kind: type) -> Any | None:
    """A step with default options; None for one that needs some."""
    try:
        return kind()
    except Exception:  # noqa: BLE001 - somebody else's class, which nobody has asked for by name
        return None


def _fits(seam: Seam, name: str, found: type) -> None:
    """Refuse classes that cannot be a step of this seam."""
    if not dataclasses.is_dataclass(found):
        raise UserError(f"{seam.name}: {name} is not a dataclass; a step is a frozen dataclass whose fields are its options")
    params: Any = getattr(found, "__dataclass_params__")  # noqa: B009 - not in the type of a class
    if not params.frozen:
        raise UserError(f"{seam.name}: {name} is not frozen; a step is a frozen dataclass whose fields are its options")
    missing = [method for method in seam.methods if not callable(getattr(found, method, None))]
    if missing:
        raise UserError(
            f"{seam.name}: {name} has no method {missing[0]}(); {seam.protocol.__name__} asks for {', '.join(seam.methods)}"
        )
    asked = [attribute for attribute, kind in vars(seam.protocol).items() if isinstance(kind, property)]
    options = {option.name for option in dataclasses.fields(found)}
    missing = [attribute for attribute in asked if attribute not in options and not hasattr(found, attribute)]
    if missing:
        wanted = ", ".join(asked)
        raise UserError(
            f"{seam.name}: {name} has no {missing[0]}; {seam.protocol.__name__} asks for {wanted} as fields or properties"
        )
