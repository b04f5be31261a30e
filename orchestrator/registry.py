"""Plugins by entry point: listed without importing, loaded one at a time, held against their contract when loaded.

A built-in plugin has no privilege here that a third-party one lacks, and a broken one costs
nothing until it is asked for.
"""

from __future__ import annotations

import importlib.util
import inspect
import sys
import typing
from collections.abc import Mapping
from enum import StrEnum
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, ClassVar, Literal, get_args, get_origin

from pydantic import BaseModel, ValidationError

from orchestrator._validation import first_problem, suggestion
from protocols import Drive, Effect, Estimator, FluxbenchError, NoOptions, PluginError, Stream, Strict


class PluginKind(StrEnum):
    """The four kinds; each is the entry-point group ``fluxbench.<kind>``."""

    DRIVES = "drives"
    ESTIMATORS = "estimators"
    EFFECTS = "effects"
    STREAMS = "streams"

    @property
    def group(self) -> str:
        """The entry-point group."""
        return f"fluxbench.{self.value}"


_CONTRACTS: Mapping[PluginKind, type] = {
    PluginKind.DRIVES: Drive,
    PluginKind.ESTIMATORS: Estimator,
    PluginKind.EFFECTS: Effect,
    PluginKind.STREAMS: Stream,
}


class PluginInfo(Strict):
    """What is known of a plugin without importing it."""

    kind: PluginKind
    name: str
    distribution: str
    version: str
    module: str
    """``module.path:Class``."""

    def __str__(self) -> str:
        return f"plugin {self.name!r} ({self.module}, from {self.distribution} {self.version})"


def installed(kind: PluginKind) -> list[PluginInfo]:
    """The installed plugins of a kind by name; none of them is imported."""
    found = {_info(kind, entry) for entry in entry_points(group=kind.group)}
    return sorted(found, key=lambda info: (info.name, info.distribution))


def load_plugin(kind: PluginKind, name: str) -> type[Any]:
    """Import a plugin's class and hold it against its contract.

    Raises
    ------
    PluginError
        Where no plugin has this name (the nearest is named), two distributions provide it, its
        import fails in whatever way, or it is not what `protocols` says such a plugin is.
    """
    by_info = {_info(kind, entry): entry for entry in entry_points(group=kind.group)}
    matching = [info for info in by_info if info.name == name]
    if not matching:
        raise PluginError(kind.value, name, f"no such plugin is installed; {_hint(kind, name)}")
    if len(matching) > 1:
        raise PluginError(kind.value, name, "provided twice: " + " and ".join(map(str, matching)))
    info = matching[0]
    plugin = _import(info, by_info[info])
    _check_contract(info, plugin)
    return plugin


def load_effects_file(path: Path) -> list[type[Any]]:
    """Run a Python file and take the classes in it that are effects.

    Raises
    ------
    PluginError
        Where the file does not run, holds no effect, or holds one that breaks its contract.
    """
    specification = importlib.util.spec_from_file_location(f"effects_of_{path.stem}", path)
    if specification is None or specification.loader is None or not path.is_file():
        raise PluginError(str(path), "", "expected a Python file with effects")
    module = importlib.util.module_from_spec(specification)
    # Dataclasses look their module up by its name.
    sys.modules[module.__name__] = module
    try:
        specification.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        raise PluginError(str(path), "", f"does not run: {_reason(error)}") from error
    own = [c for c in vars(module).values() if inspect.isclass(c) and c.__module__ == module.__name__]
    found = [c for c in own if hasattr(c, "correct")]
    if not found:
        raise PluginError(str(path), "", "holds no effect: a class with a method 'correct'")
    for plugin in found:
        name = str(getattr(plugin, "name", plugin.__name__))
        _check_contract(
            PluginInfo(kind=PluginKind.EFFECTS, name=name, distribution="?", version="?", module=str(path)), plugin
        )
    return found


def make_options(plugin: type[Any], raw: Mapping[str, Any], where: str) -> BaseModel:
    """Validate the options that were written for a plugin with its own `Options`.

    Parameters
    ----------
    plugin : type
        What `load_plugin` returned.
    raw : mapping
        The options as they were written.
    where : str
        File (and key path) that they are from, for the error.

    Raises
    ------
    PluginError
        In one line, with the nearest valid key where one is unknown.
    """
    options: type[BaseModel] = getattr(plugin, "Options", NoOptions)
    try:
        return options.model_validate(dict(raw))
    except ValidationError as error:
        problem = first_problem(error, options, raw)
        raise PluginError(where, problem.field, f"{problem.text} (option of {plugin.name!r})") from None


def _info(kind: PluginKind, entry: EntryPoint) -> PluginInfo:
    distribution, version = (entry.dist.name, entry.dist.version) if entry.dist else ("?", "?")
    return PluginInfo(kind=kind, name=entry.name, distribution=distribution, version=version, module=entry.value)


def _hint(kind: PluginKind, name: str) -> str:
    names = {info.name for info in installed(kind)}
    return suggestion(name, names) if names else f"none is registered in {kind.group}"


def _import(info: PluginInfo, entry: EntryPoint) -> type[Any]:
    try:
        plugin = entry.load()
    except (Exception, SystemExit) as error:
        # An import runs foreign code: it may raise anything, and what it raises is said, not hidden.
        raise PluginError(info.kind.value, str(info), f"does not load: {_reason(error)}") from error
    if not isinstance(plugin, type):
        raise PluginError(info.kind.value, str(info), f"expected a class, got {type(plugin).__name__}")
    return plugin


def _reason(error: BaseException) -> str:
    """One line; our own errors speak for themselves."""
    return str(error) if isinstance(error, FluxbenchError) else f"{type(error).__name__}: {error}".splitlines()[0]


def _check_contract(info: PluginInfo, plugin: type[Any]) -> None:
    contract = _CONTRACTS[info.kind]
    hints = {a: get_args(h)[0] for a, h in typing.get_type_hints(contract).items() if get_origin(h) is ClassVar}
    for attribute, definition in vars(contract).items():
        if isinstance(definition, property):
            hints[attribute] = typing.get_type_hints(definition.fget)["return"]
    for attribute, wanted in hints.items():
        problem = _attribute_problem(plugin, attribute, wanted)
        if problem:
            raise PluginError(info.kind.value, str(info), f"attribute {attribute!r} {problem}")
    for method, definition in vars(contract).items():
        if inspect.isfunction(definition) and not method.startswith("_"):
            problem = _method_problem(plugin, method, definition)
            if problem:
                raise PluginError(info.kind.value, str(info), f"method {method!r} {problem}")


def _attribute_problem(plugin: type[Any], attribute: str, wanted: Any) -> str | None:
    if not hasattr(plugin, attribute):
        return "is missing"
    value = getattr(plugin, attribute)
    origin = get_origin(wanted)
    if origin is type:
        base = get_args(wanted)[0]
        fits = isinstance(value, type) and issubclass(value, base)
        return None if fits else f"has to be a sub-class of {getattr(base, '__name__', base)}, is {value!r}"
    if origin is Literal:
        return None if value in get_args(wanted) else f"has to be one of {get_args(wanted)}, is {value!r}"
    expected = origin or wanted
    return None if isinstance(value, expected) else f"has to be a {expected.__name__}, is {value!r}"


def _method_problem(plugin: type[Any], method: str, definition: Any) -> str | None:
    found = getattr(plugin, method, None)
    if not callable(found):
        return "is missing"
    arguments = inspect.signature(definition).parameters
    try:
        inspect.signature(found).bind(*arguments)
    except TypeError:
        return f"cannot be called as {method}({', '.join(list(arguments)[1:])})"
    return None
