"""Plugins by entry point: listed without importing, loaded one at a time and validated then.

A built-in plugin has no privilege here that a third-party one lacks, and a broken one costs
nothing until it is loaded.
"""

from __future__ import annotations

import importlib.util
import inspect
import re
import sys
import typing
from collections.abc import Hashable, Iterable, Mapping
from enum import Enum, StrEnum
from functools import lru_cache
from importlib.metadata import Distribution, EntryPoint
from pathlib import Path
from types import UnionType
from typing import Any, ClassVar, Literal, cast, get_args, get_origin

from pydantic import BaseModel, ValidationError

from orchestrator.extras import how_to_install, missing_extra
from orchestrator.registry.entry_points import entries_of
from orchestrator.registry.plugin_methods import hook_problem, method_problem, misspelling
from orchestrator.validation.messages import first_problem, nearest, suggestion
from protocols import Drive, Effect, Estimator, FluxbenchError, NoOptions, PluginError, Stage, Stream, Strict


class PluginKind(StrEnum):
    """The five kinds; each is the entry-point group ``fluxbench.<kind>``."""

    DRIVES = "drives"
    STAGES = "stages"
    ESTIMATORS = "estimators"
    EFFECTS = "effects"
    STREAMS = "streams"

    @property
    def group(self) -> str:
        """The entry-point group."""
        return f"fluxbench.{self.value}"


_CONTRACTS: Mapping[PluginKind, type] = {
    PluginKind.DRIVES: Drive,
    PluginKind.STAGES: Stage,
    PluginKind.ESTIMATORS: Estimator,
    PluginKind.EFFECTS: Effect,
    PluginKind.STREAMS: Stream,
}


PLUGIN_NAME = re.compile(r"^[a-z][a-z0-9_]*$")
"""Names of plugins: a command line, a folder and a Python module can all have one."""
DISTRIBUTION = "fluxbench"
"""The distribution of the library's own plugins."""
UNKNOWN = "?"
"""Distribution and version of what no installed distribution provides."""


class PluginInfo(Strict):
    """Metadata of a plugin, without importing it."""

    kind: PluginKind
    name: str
    distribution: str
    version: str
    module: str
    """``module.path:Class``; of a file its path and the class's line."""

    def __str__(self) -> str:
        source = "" if self.distribution == UNKNOWN else f", from {self.distribution} {self.version}"
        return f"plugin {self.name!r} ({self.module}{source})"


def of_other_distributions(kind: PluginKind) -> frozenset[str]:
    """Names of the installed plugins of a kind that another distribution than fluxbench provides."""
    return frozenset(info.name for info in installed(kind) if info.distribution not in (DISTRIBUTION, UNKNOWN))


class Installed:
    """Installed plugins of a kind, searched once: a search takes longer than importing a small plugin."""

    def __init__(self, kind: PluginKind) -> None:
        self._kind = kind
        entries = entries_of(kind.group)
        named = {distribution: _named(distribution) for distribution in {entry.dist for entry in entries}}
        self._by_info = {_info(kind, entry, *named[entry.dist]): entry for entry in entries}

    @property
    def plugins(self) -> list[PluginInfo]:
        """Metadata by name; no plugin is imported."""
        return sorted(self._by_info, key=lambda info: (info.name, info.distribution))

    def load(self, name: str) -> type[Any]:
        """Import a plugin's class and hold it against its contract.

        Raises
        ------
        PluginError
            Where no plugin has this name (the nearest is named), two distributions provide it, its
            import fails in whatever way, or it is not what `protocols` says such a plugin is.
        """
        matching = [info for info in self._by_info if info.name == name]
        if not matching:
            names = {info.name for info in self._by_info}
            hint = suggestion(name, names) if names else f"none is registered in {self._kind.group}"
            raise PluginError(self._kind.value, name, f"no such plugin is installed; {hint}")
        if len(matching) > 1:
            raise PluginError(self._kind.value, name, "provided twice: " + " and ".join(map(str, matching)))
        info = matching[0]
        plugin = _import(info, self._by_info[info])
        _check_contract(info, plugin)
        return plugin


def installed(kind: PluginKind) -> list[PluginInfo]:
    """The installed plugins of a kind by name; none of them is imported."""
    return Installed(kind).plugins


def load_plugin(kind: PluginKind, name: str) -> type[Any]:
    """`Installed.load` for one plugin."""
    return Installed(kind).load(name)


def make_plugins(kind: PluginKind, names: Iterable[str] | None = None) -> list[Any]:
    """Instances of plugins that are made without arguments, of all installed ones where none is named.

    Raises
    ------
    PluginError
        As `Installed.load` raises.
    """
    plugins = Installed(kind)
    return [plugins.load(name)() for name in (names if names is not None else [info.name for info in plugins.plugins])]


_NO_EFFECT = (
    "holds no effect: a class with name, summary, signature, layer, needs, gauge, a class Parameters(EffectParameters) "
    "and a method correct(self, signals, parameters); `fluxbench new effect NAME` writes one"
)


def load_effects_file(path: Path) -> list[type[Any]]:
    """Run a Python file and take the classes in it that are effects.

    Raises
    ------
    PluginError
        Where the file does not run, holds no effect, or holds one that breaks its contract.
    """
    specification = importlib.util.spec_from_file_location(f"effects_of_{path.stem}", path)
    if specification is None or specification.loader is None or not path.is_file():
        problem = "expected a Python file (.py) with effects" if path.exists() else "no such file"
        raise PluginError(str(path), "", f"{problem}; `fluxbench new effect NAME` makes one")
    module = importlib.util.module_from_spec(specification)
    # Dataclasses look their module up by its name.
    sys.modules[module.__name__] = module
    try:
        specification.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        raise PluginError(str(path), "", f"does not run: {_reason(error)}") from error
    own = [c for c in vars(module).values() if inspect.isclass(c) and c.__module__ == module.__name__]
    # What effects share may stand in a base class, which is none by itself.
    bases = {base for c in own for base in c.__mro__[1:]}
    effects = [
        c for c in own if hasattr(c, "correct") or (inspect.isclass(getattr(c, "Parameters", None)) and c not in bases)
    ]
    if not effects:
        raise PluginError(str(path), "", _NO_EFFECT)
    for plugin in effects:
        name = str(getattr(plugin, "name", plugin.__name__))
        place = _place(path, plugin)
        info = PluginInfo(kind=PluginKind.EFFECTS, name=name, distribution=UNKNOWN, version=UNKNOWN, module=place)
        _check_contract(info, plugin)
    return effects


def _place(path: Path, plugin: type[Any]) -> str:
    """File and line of a class; the file alone where the class is not written out in it."""
    try:
        return f"{path}, line {inspect.getsourcelines(plugin)[1]}"
    except OSError:
        return str(path)


def make_options(plugin: type[Any], raw: Mapping[str, Any], where: str, on_missing: str = "") -> BaseModel:
    """Validate the options that were written for a plugin with its own `Options`.

    Parameters
    ----------
    plugin : type
        Result of `load_plugin`.
    raw : mapping
        The options as they were written.
    where : str
        File (and key path) that they are from, for the error.
    on_missing : str
        Advice where an option is missing, with ``{option}`` for its name and ``{example}`` for the first of its field's
        examples.

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
        advice = ""
        if problem.is_missing and on_missing:
            advice = "; " + on_missing.format(option=problem.field, example=_first_example(options, problem.field))
        raise PluginError(where, problem.field, f"{problem.text} (option of {plugin.name!r}){advice}") from None


def _first_example(options: type[BaseModel], field: str) -> str:
    """The first example of a field; a placeholder where it has none."""
    known = options.model_fields.get(field)
    return str(known.examples[0]) if known is not None and known.examples else "..."


@lru_cache(maxsize=64)  # reading its metadata takes longer than all the rest here
def _named(distribution: Distribution | None) -> tuple[str, str]:
    """Its name and version."""
    if distribution is None:
        return UNKNOWN, UNKNOWN
    metadata = distribution.metadata
    return metadata["Name"], metadata["Version"]


def _info(kind: PluginKind, entry: EntryPoint, distribution: str, version: str) -> PluginInfo:
    return PluginInfo(kind=kind, name=entry.name, distribution=distribution, version=version, module=entry.value)


def _import(info: PluginInfo, entry: EntryPoint) -> type[Any]:
    try:
        plugin = entry.load()
    except (Exception, SystemExit) as error:
        # An import runs foreign code: it may raise anything, and the error names it.
        extra = missing_extra(error)
        if extra is not None:
            raise PluginError(info.kind.value, str(info), how_to_install(extra)) from None
        raise PluginError(info.kind.value, str(info), f"does not load: {_reason(error)}") from error
    if not isinstance(plugin, type):
        raise PluginError(info.kind.value, str(info), f"expected a class, got {type(plugin).__name__}")
    return plugin


def _reason(error: BaseException) -> str:
    """One line; the project's own errors unchanged, and the names of a set of names where one is not among them."""
    known = getattr(error, "obj", None)
    if isinstance(error, AttributeError) and isinstance(known, type) and issubclass(known, Enum):
        members = [member.name for member in known]
        near = nearest(str(error.name), members)
        hint = f"; did you mean {near}? It" if near is not None else "; it"
        return f"{known.__name__} has no {error.name}{hint} has {', '.join(members)}"
    return str(error) if isinstance(error, FluxbenchError) else f"{type(error).__name__}: {error}".splitlines()[0]


def _check_contract(info: PluginInfo, plugin: type[Any]) -> None:
    problem = _contract_problem(info.kind, cast(Hashable, plugin))
    if problem:
        raise PluginError(info.kind.value, str(info), problem)


@lru_cache(maxsize=256)  # a procedure loads its stages' plugins again and again
def _contract_problem(kind: PluginKind, plugin: type[Any]) -> str | None:
    """Why a class is not what `protocols` says such a plugin is; None where it is."""
    contract = _CONTRACTS[kind]
    if issubclass(contract, BaseModel) and not issubclass(plugin, contract):
        return f"has to be a sub-class of {contract.__name__}"
    # A base class has what pydantic declares for itself as well, and properties of its own.
    is_base = issubclass(contract, BaseModel)
    own: dict[str, Any] = (
        inspect.get_annotations(contract, eval_str=True) if is_base else typing.get_type_hints(contract)
    )
    hints = {a: get_args(h)[0] for a, h in own.items() if get_origin(h) is ClassVar}
    for attribute, definition in vars(contract).items():
        if isinstance(definition, property) and not is_base:
            hints[attribute] = typing.get_type_hints(definition.fget)["return"]
    for attribute, wanted in hints.items():
        problem = _attribute_problem(plugin, attribute, wanted)
        if problem:
            hint = "" if hasattr(plugin, attribute) else misspelling(plugin, attribute, contract)
            return f"attribute {attribute!r} {problem}{hint}"
    for method, definition in vars(contract).items():
        if inspect.isfunction(definition) and not method.startswith("_"):
            problem = method_problem(plugin, method, contract)
            if problem:
                return f"method {method!r} {problem}"
    return hook_problem(plugin) if kind is PluginKind.EFFECTS else None


def _attribute_problem(plugin: type[Any], attribute: str, wanted: Any) -> str | None:
    if not hasattr(plugin, attribute):
        return f"is missing: write {_example(attribute, wanted)}"
    value = getattr(plugin, attribute)
    origin: Any = get_origin(wanted)
    if origin is type:
        base = get_args(wanted)[0]
        fits = isinstance(value, type) and issubclass(value, base)
        return None if fits else f"has to be a sub-class of {getattr(base, '__name__', base)}, is {value!r}"
    if origin is Literal:
        return None if value in get_args(wanted) else f"has to be one of {get_args(wanted)}, is {value!r}"
    expected = wanted if origin is UnionType else origin or wanted
    what = getattr(expected, "__name__", expected)
    return None if isinstance(value, expected) else f"has to be a {what}, is {value!r}"


def _example(attribute: str, wanted: Any) -> str:
    """An attribute of this type, as it could be written."""
    origin: Any = get_origin(wanted)
    if origin is type:
        base = getattr(get_args(wanted)[0], "__name__", "object")
        return f"class {attribute}({base}) in it"
    if origin is Literal:
        return f"{attribute} = {' or '.join(map(repr, get_args(wanted)))}"
    if isinstance(wanted, type) and issubclass(wanted, Enum):
        first, *others = wanted
        return f"{attribute} = {wanted.__name__}.{first.name} (or {', '.join(other.name for other in others)})"
    examples = {str: '"..."', bool: "True", int: "0", float: "0.0", tuple: "()"}
    return f"{attribute} = {examples.get(origin or wanted, '...')}"
