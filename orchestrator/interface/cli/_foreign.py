"""Commands that belong to plugins: entry points of the group ``fluxbench.commands``, loaded when they are called.

Such an entry point names a callable that takes the arguments after the command's name and returns an exit code; its
errors are reported like any other command's. A true attribute `energises` marks a command that energises: signals then
end it from the first line on, until its run handles them itself. The list of commands shows the first line of its
module's docstring, which is parsed, not imported.
"""

from __future__ import annotations

import ast
import copy
import re
from collections.abc import Callable, Sequence
from importlib.machinery import PathFinder
from importlib.metadata import EntryPoint
from pathlib import Path

import typer

from orchestrator.registry.entry_points import entries_of

GROUP = "fluxbench.commands"


def with_plugin_commands(app: typer.Typer, arguments: Sequence[str] = ()) -> typer.Typer:
    """The application with one command more for each entry point; none of them is imported.

    Where the first argument names a command, with that one alone: describing all takes longer than some commands run.
    """
    whole, named = copy.copy(app), next(iter(arguments), "")
    entries = sorted(entries_of(GROUP), key=lambda entry: entry.name)
    foreign = [entry for entry in entries if entry.name == named]
    own = [] if foreign else [command for command in app.registered_commands if command.name == named]
    is_known = bool(own or foreign)
    whole.registered_commands = own if is_known else list(app.registered_commands)
    for entry in foreign if is_known else entries:
        settings = {"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []}
        summary, group = described(entry)
        add = whole.command(entry.name, help=summary, rich_help_panel=group, context_settings=settings)
        add(_command(entry))
    return whole


def is_foreign(name: str | None) -> bool:
    """Whether a command is a plugin's."""
    return any(entry.name == name for entry in entries_of(GROUP))


def described(entry: EntryPoint) -> tuple[str, str]:
    """A command's summary, and its group in the list.

    They are the first line of its module's docstring, without "`fluxbench NAME`:" before it, and the text that the
    module assigns to `HELP_GROUP`. The source is parsed, never run; where there is none, or no docstring in it, the
    distribution is named.
    """
    source = _source_of(entry.module)
    try:
        module = ast.parse(source.read_bytes()) if source is not None else ast.Module([], [])
    except (OSError, SyntaxError, ValueError):
        module = ast.Module([], [])  # the command itself reports the error
    docstring, group = ast.get_docstring(module), _assigned_text(module, "HELP_GROUP")
    if not docstring:
        return f"A plugin's, from {entry.dist.name if entry.dist else '?'}.", group
    line = re.sub(r"^[^`:]*`+fluxbench [^`]*`+: *", "", docstring.splitlines()[0])
    return line[:1].upper() + line[1:], group


def _assigned_text(module: ast.Module, name: str) -> str:
    """The text that a module assigns to a name; empty where it assigns none."""
    values = {
        target.id: node.value.value
        for node in module.body
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant)
        for target in node.targets
        if isinstance(target, ast.Name)
    }
    value = values.get(name)
    return value if isinstance(value, str) else ""


def _source_of(module: str) -> Path | None:
    """The file of a module, without importing the packages above it."""
    places: Sequence[str] | None = None
    origin: str | None = None
    parts = module.split(".")
    for depth in range(1, len(parts) + 1):
        spec = PathFinder.find_spec(".".join(parts[:depth]), places)
        if spec is None:
            return None
        places, origin = spec.submodule_search_locations, spec.origin
    return Path(origin) if origin is not None and origin.endswith(".py") else None


def _command(entry: EntryPoint) -> Callable[[typer.Context], int]:
    def call(context: typer.Context) -> int:
        from orchestrator.extras import how_to_install, missing_extra
        from protocols import PluginError

        try:
            command = entry.load()
        except Exception as error:
            # An import runs foreign code, which may raise anything; the error is reported, not hidden.
            extra = missing_extra(error)
            if extra is not None:
                raise PluginError("commands", entry.name, how_to_install(extra)) from None
            raise PluginError("commands", entry.name, f"does not load: {type(error).__name__}: {error}") from error
        settle = context.find_root().obj
        if callable(settle):
            settle(bool(getattr(command, "energises", False)))
        return int(command(context.args) or 0)

    return call
