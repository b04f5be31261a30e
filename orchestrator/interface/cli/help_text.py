"""Help in plain words: commands in groups, and the names of arguments without the types that typer adds."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import typer.core

MEASURE, DIAGNOSE, USE = "Measure", "Estimate and find what is missing", "Use the results"
RECORDINGS, LOOK_UP, TRY = "Recordings and runs", "Look up and extend", "Try and prove"
OTHERS = "Others"
GROUPS = (MEASURE, DIAGNOSE, USE, RECORDINGS, LOOK_UP, TRY, OTHERS)
"""Titles of the list of commands, in order; a command without one of them is among the others."""
HELP_NAMES = {"help_option_names": ["-h", "--help"]}
"""Settings of a command's context: the names of the option that prints its help."""
_TYPE = re.compile(r" <([^>]*)>$")
_VALUES = {"path": "PATH", "int": "N", "int range": "N", "float": "NUMBER", "float range": "NUMBER"}
"""What an option's value is called, by typer's word for its type."""
_BRACES = re.compile(r"[{}]")


class PlainCommand(typer.core.TyperCommand):
    """A command whose help names its arguments as ``RUN``, not as ``{RUN}`` or ``RUN <path>``."""

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """The pieces of the usage line."""
        return [_plain(piece) for piece in super().collect_usage_pieces(ctx)]

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the sections of arguments and of options."""
        parameters = self.get_params(ctx)
        for kind, title in (("argument", "Arguments"), ("option", "Options")):
            records = [p.get_help_record(ctx) for p in parameters if p.param_type_name == kind]
            rows = [(_named(record[0], kind), record[1]) for record in records if record is not None]
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)


def write_commands(commands: Sequence[tuple[str, Any]], formatter: Any) -> None:
    """Write the commands (name, command) with their summaries, a section for each group."""
    widest = max((len(name) for name, _ in commands), default=0)
    limit = formatter.width - 6 - widest
    grouped: dict[str, list[tuple[str, str]]] = {title: [] for title in GROUPS}
    for name, command in commands:
        group = getattr(command, "rich_help_panel", None)
        grouped[group if group in grouped else OTHERS].append((name.ljust(widest), command.get_short_help_str(limit)))
    for title, rows in grouped.items():
        if rows:
            with formatter.section(title):
                formatter.write_dl(rows)


def _named(name: str, kind: str) -> str:
    """An argument without its type; an option with a name for its value."""
    if kind == "argument":
        return _TYPE.sub("", name).upper()
    return _TYPE.sub(lambda match: " " + _VALUES.get(match[1], "TEXT"), name)


def _plain(piece: str) -> str:
    return _BRACES.sub("", piece).replace("[[", "[").replace("]]", "]").replace("......", "...").upper()


def with_plain_help(app: typer.Typer) -> typer.Typer:
    """The application, its commands with this help, by `-h` and `--help`."""
    app.info.context_settings = {**(app.info.context_settings or {}), **HELP_NAMES}
    for command in app.registered_commands:
        command.cls = PlainCommand
        command.context_settings = {**(command.context_settings or {}), **HELP_NAMES}
    for group in app.registered_groups:
        if group.typer_instance is not None:
            with_plain_help(group.typer_instance)
    return app
