"""Packages that only some users need: which extra of an installation brings them, and the line where one is missing."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.util import find_spec

from protocols import InputError

EXTRAS: Mapping[str, tuple[str, ...]] = {
    "viewer": ("rerun",),
    "report": ("matplotlib", "jinja2"),
    "serve": ("starlette", "uvicorn"),
}
"""Modules that an extra brings, by its name in pyproject.toml; importers, drives and the fleet check for their own."""


class MissingExtraError(InputError):
    """A command that needs an extra which is not installed."""


def is_installed(extra: str) -> bool:
    """Whether all modules of an extra are there; none of them is imported."""
    return all(_is_there(module) for module in EXTRAS[extra])


def require(extra: str, what: str) -> None:
    """Raise `MissingExtraError` where `what` needs an extra that is not installed."""
    if not is_installed(extra):
        raise MissingExtraError(what, "", how_to_install(extra))


def how_to_install(extra: str) -> str:
    """One line that says how an extra is installed."""
    return f"this needs the extra `{extra}`: pip install 'fluxbench[{extra}]'"


def missing_extra(error: BaseException) -> str | None:
    """The extra without which an import failed; None where the error has another reason."""
    module = (error.name or "").partition(".")[0] if isinstance(error, ModuleNotFoundError) else ""
    return next((extra for extra, modules in EXTRAS.items() if module in modules), None)


def _is_there(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except ImportError:  # a package that an importer of its own refuses
        return False
