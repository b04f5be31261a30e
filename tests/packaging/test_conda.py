"""The conda recipe asks for the packages that the project asks for, by conda's names."""

from __future__ import annotations

import re
import runpy
import tomllib
from collections.abc import Iterable
from pathlib import Path

import yaml

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
RECIPE = yaml.safe_load((ROOT / "packaging" / "conda" / "recipe.yaml").read_text(encoding="utf-8"))
OF_CONDA = {"matplotlib": "matplotlib-base"}


def plain(lines: Iterable[str]) -> set[str]:
    """Package and limits, in small letters and without blanks."""
    parts = [re.fullmatch(r"([\w.-]+)(.*)", line.lower().replace(" ", "")) for line in lines]
    return {OF_CONDA.get(part[1], part[1]) + part[2] for part in parts if part is not None}


def test_it_asks_for_what_the_core_needs() -> None:
    core = {*PROJECT["dependencies"], f"python{PROJECT['requires-python']}"}
    assert plain(RECIPE["requirements"]["run"]) == plain(core)


def test_it_limits_what_the_extras_bring() -> None:
    extras = PROJECT["optional-dependencies"]
    brought = [line for extra in ("viewer", "report", "serve") for line in extras[extra]]
    assert plain(RECIPE["requirements"]["run_constraints"]) == plain(brought)


def test_it_has_the_newest_version_and_the_project_s_command() -> None:
    newest = runpy.run_path(str(ROOT / "packaging" / "version.py"))["newest"]
    assert RECIPE["context"]["version"] == newest(ROOT)
    (command,) = RECIPE["build"]["python"]["entry_points"]
    assert command == f"fluxbench = {PROJECT['scripts']['fluxbench']}"
    assert (RECIPE["package"]["name"], RECIPE["about"]["license"]) == ("${{ name }}", PROJECT["license"])
