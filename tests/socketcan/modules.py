"""Kernel modules in the order in which they have to be loaded. Reads files; loads nothing."""

from __future__ import annotations

import lzma
import re
from collections.abc import Iterable
from pathlib import Path

_DEPENDS = re.compile(rb"\0depends=([^\0]*)\0")


class NoModule(Exception):
    """A kernel without a module that is needed."""


def with_dependencies(names: Iterable[str], folder: Path) -> list[tuple[str, bytes]]:
    """File names and contents of these modules and of all that they need, those first; what is built in is left out.

    Raises `NoModule`.
    """
    files = {_name(path.name): path for path in folder.glob("kernel/**/*.ko*")}
    listed = folder / "modules.builtin"
    built_in = {_name(Path(line).name) for line in listed.read_text().splitlines()} if listed.exists() else set()
    loaded: dict[str, bytes] = {}

    def visit(name: str) -> None:
        if name in loaded or name in built_in:
            return
        if name not in files:
            raise NoModule(name)
        content = _content(files[name])
        found = _DEPENDS.search(content)
        for needed in found.group(1).decode().split(",") if found else ():
            if needed:
                visit(_name(needed))
        loaded[name] = content

    for name in names:
        visit(_name(name))
    return [(f"{name}.ko", content) for name, content in loaded.items()]


def _name(file: str) -> str:
    return file.split(".ko")[0].replace("-", "_")


def _content(path: Path) -> bytes:
    content = path.read_bytes()
    return lzma.decompress(content) if path.suffix == ".xz" else content
