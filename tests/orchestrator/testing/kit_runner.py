"""Runs a kit's checks without a pytest session of their own, and says which of them fail."""

from __future__ import annotations

import inspect
import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest


def failures(kit: object, directory: Path, only: str = "") -> dict[str, str]:
    """Checks that fail, with what they say; skipped ones do not.

    Parameters
    ----------
    kit : instance of a subclass of a kit
    directory : Path
        Each check gets a directory of its own in it.
    only : str
        Part of the names of the checks to run.
    """
    failed = {}
    for number, (name, arguments) in enumerate(_cases(kit)):
        if only not in name:
            continue
        tmp_path = directory / f"{number:03d}"
        tmp_path.mkdir(parents=True)
        wanted = inspect.signature(getattr(kit, name)).parameters
        try:
            fixtures = {key: _fixture(kit, key, tmp_path) for key in wanted if key not in arguments}
            getattr(kit, name)(**arguments, **fixtures)
        except pytest.skip.Exception:
            continue
        except (Exception, pytest.fail.Exception) as error:
            failed[f"{name}{_label(arguments)}"] = f"{type(error).__name__}: {error}"
    return failed


def _cases(kit: object) -> Iterator[tuple[str, dict[str, Any]]]:
    for name in sorted(n for n in dir(kit) if n.startswith("test_")):
        rows = []
        for mark in getattr(getattr(kit, name), "pytestmark", []):
            keys = [mark.args[0]] if isinstance(mark.args[0], str) and "," not in mark.args[0] else mark.args[0]
            rows.append([dict(zip(keys, v if len(keys) > 1 else (v,), strict=True)) for v in mark.args[1]])
        for combination in itertools.product(*rows):
            yield name, {key: value for part in combination for key, value in part.items()}


def _fixture(kit: object, name: str, tmp_path: Path) -> Any:
    """A directory, or what a fixture of the kit's own class makes."""
    return tmp_path if name == "tmp_path" else inspect.unwrap(inspect.getattr_static(kit, name))(type(kit))


def _label(arguments: dict[str, Any]) -> str:
    return f"[{'-'.join(map(str, arguments.values()))}]" if arguments else ""
