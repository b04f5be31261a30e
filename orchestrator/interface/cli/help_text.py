"""Help in plain words: the names of arguments as they are in the usage, without the types that typer adds."""

from __future__ import annotations

import re
from typing import Any

import typer.core

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


def _named(name: str, kind: str) -> str:
    """An argument without its type; an option with a name for its value."""
    if kind == "argument":
        return _TYPE.sub("", name).upper()
    return _TYPE.sub(lambda match: " " + _VALUES.get(match[1], "TEXT"), name)


def _plain(piece: str) -> str:
    return _BRACES.sub("", piece).replace("[[", "[").replace("]]", "]").replace("......", "...").upper()


def with_plain_help(app: typer.Typer) -> typer.Typer:
    """The application, its commands with this help."""
    for command in app.registered_commands:
        command.cls = PlainCommand
    for group in app.registered_groups:
        if group.typer_instance is not None:
            with_plain_help(group.typer_instance)
    return app
