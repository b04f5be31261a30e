"""Commands that belong to plugins: entry points of the group ``fluxbench.commands``, loaded when they are called.

Such an entry point names a callable that takes the words after the command's name and returns an
exit code; what it raises is explained as any other command's error is.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from importlib.metadata import EntryPoint, entry_points

import typer

GROUP = "fluxbench.commands"


def with_plugin_commands(app: typer.Typer) -> typer.Typer:
    """The application with one command more for each entry point; none of them is imported."""
    whole = copy.copy(app)
    whole.registered_commands = list(app.registered_commands)
    for entry in sorted(entry_points(group=GROUP), key=lambda entry: entry.name):
        origin = entry.dist.name if entry.dist else "?"
        settings = {"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []}
        add = whole.command(entry.name, help=f"A plugin's, from {origin}.", context_settings=settings)
        add(_command(entry))
    return whole


def _command(entry: EntryPoint) -> Callable[[typer.Context], int]:
    def call(context: typer.Context) -> int:
        from protocols import PluginError

        try:
            command = entry.load()
        except Exception as error:
            # An import runs foreign code: it may raise anything, and what it raises is said, not hidden.
            problem = f"does not load: {type(error).__name__}: {error}"
            raise PluginError("commands", entry.name, problem) from error
        return int(command(context.args) or 0)

    return call
