"""`fluxbench new`: a package with a new plugin that passes its conformance kit from the start.

The name is checked first, then all files or none are written, from templates/.
"""

from __future__ import annotations

import keyword
import shutil
from importlib.resources import files
from pathlib import Path
from string import Template

from orchestrator.registry.plugins import PLUGIN_NAME, PluginKind, installed
from orchestrator.validation.messages import nearest
from protocols import InputError, PluginError, StorageError

KINDS = {
    "drive": PluginKind.DRIVES,
    "stage": PluginKind.STAGES,
    "estimator": PluginKind.ESTIMATORS,
    "effect": PluginKind.EFFECTS,
    "stream": PluginKind.STREAMS,
}


def write_package(kind: str, name: str, folder: Path) -> list[Path]:
    """Write a package with one plugin into a new folder.

    Parameters
    ----------
    kind : str
        One of `KINDS`.
    name : str
        The plugin's name: lower-case letters, digits and underscores.
    folder : Path
        Must not exist.

    Returns
    -------
    list of Path
        The files, the plugin's own first.

    Raises
    ------
    PluginError
        The kind does not exist, or the name is invalid or in use.
    InputError
        The folder exists already, or cannot be created.
    StorageError
        It cannot be written to.
    """
    if kind not in KINDS:
        near = nearest(kind, KINDS)
        hint = "" if near is None else f"; did you mean {near!r}?"
        raise PluginError("new", kind, f"no such kind of plugin; there are {', '.join(KINDS)}{hint}")
    if len(name) > 80:  # files and folders get this name
        raise PluginError(kind, f"{name[:12]}...", "a name has at most 80 letters")
    if not PLUGIN_NAME.match(name) or keyword.iskeyword(name):
        raise PluginError(
            kind, name, "a name has lower-case letters, digits and underscores, and is no keyword of Python"
        )
    if any(info.name == name for info in installed(KINDS[kind])):
        raise PluginError(kind, name, "is installed already; choose another name")
    texts = _texts(kind, name)
    try:
        folder.mkdir(parents=True)
    except FileExistsError:
        raise InputError(str(folder), "", "exists already; nothing was written") from None
    except OSError as error:
        why = f"cannot be created: {error.strerror or error}; --out names another folder"
        raise InputError(str(folder), "", why) from None
    try:
        for relative, text in texts.items():
            path = folder / relative
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
    except OSError as error:
        shutil.rmtree(folder, ignore_errors=True)
        raise StorageError(f"{folder}: cannot be written: {error.strerror or error}") from None
    return [folder / relative for relative in texts]


def _texts(kind: str, name: str) -> dict[str, str]:
    """Text of each file of the package, by its path."""
    words = {
        "name": name,
        "kind": kind,
        "group": f"fluxbench.{KINDS[kind].value}",
        "package": f"fluxbench_{name}",
        "words": name.replace("_", " "),
        "project": f"fluxbench-{name.replace('_', '-')}",
        "title": "".join(word.capitalize() for word in name.split("_")) + kind.capitalize(),
    }

    def text(template: str) -> str:
        source = (files("orchestrator.interface.scaffolding") / "templates" / template).read_text(encoding="utf-8")
        return Template(source).substitute(words)

    package = words["package"]
    further = {
        "drive": {"procedure.yaml": "procedure-drive.yaml.txt"},
        "effect": {"hide.py": "hide-effect.py.txt"},
    }.get(kind, {})
    return {
        f"{package}/{name}.py": text(f"{kind}.py.txt"),
        f"tests/test_{name}.py": text(f"test_{kind}.py.txt"),
        "pyproject.toml": text("pyproject.toml.txt"),
        "README.md": text(f"README-{kind}.md.txt"),
        f"{package}/__init__.py": text("init.py.txt"),
        f"{package}/py.typed": "",
        **{path: text(template) for path, template in further.items()},
    }
