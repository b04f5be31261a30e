"""Takes from this process every package that an installation of the core does not bring."""

from __future__ import annotations

import re
import sys
import tomllib
from collections.abc import Sequence
from importlib.machinery import ModuleSpec, PathFinder
from importlib.metadata import PackageNotFoundError, packages_distributions, requires
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).parents[2]


def remove_extras() -> None:
    """Let nobody find them from now on."""
    core = core_distributions()
    brought = {module for module, owners in packages_distributions().items() if core & {*map(_plain, owners)}}
    others = packages_distributions().keys() - brought - {"protocols", "orchestrator", "plugins", "fluxbench"}
    sys.meta_path[sys.meta_path.index(PathFinder)] = _Hiding(frozenset(others))


def core_distributions() -> set[str]:
    """The packages that the project asks for without extras, and those that they ask for."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    known, new = set[str](), {_name(line) for line in project["dependencies"]}
    while new:
        known |= new
        new = {_name(line) for package in new for line in _asked_for_by(package)} - known
    return known


class _Hiding(PathFinder):
    def __init__(self, hidden: frozenset[str]) -> None:
        self._hidden = hidden

    def find_spec(  # type: ignore[override]  # of this instance, not of its class
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        return None if name.partition(".")[0] in self._hidden else PathFinder.find_spec(name, path, target)


def _asked_for_by(package: str) -> list[str]:
    try:
        return [line for line in requires(package) or () if "extra ==" not in line]
    except PackageNotFoundError:  # of another system
        return []


def _name(line: str) -> str:
    return _plain(re.split(r"[\[<>=!~; (]", line)[0])


def _plain(package: str) -> str:
    return re.sub(r"[-_.]+", "-", package).lower()
