"""The procedures that come with the package, as text: reading them is somebody else's trade."""

from __future__ import annotations

from importlib.resources import files


def shipped_procedures() -> tuple[str, ...]:
    """Names of the procedures in the package, in alphabetical order."""
    folder = files("protocols") / "procedures"
    return tuple(sorted(entry.name.removesuffix(".yaml") for entry in folder.iterdir() if entry.name.endswith(".yaml")))


def shipped_procedure(name: str) -> str:
    """YAML text of a shipped procedure; raises `KeyError` where there is none of that name."""
    if name not in shipped_procedures():
        raise KeyError(name)
    return (files("protocols") / "procedures" / f"{name}.yaml").read_text(encoding="utf-8")
