"""Shared by the plugins' commands: entry points, and the options `--json` and `--quiet`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated, Any

import typer

from orchestrator.interface.cli.help_text import with_plain_help

AsJson = Annotated[bool, typer.Option("--json", help="Print the result as one JSON object.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")]


def entry_point(function: Callable[..., Any], epilog: str | None = None) -> Callable[[Sequence[str]], int]:
    """Entry point of a command named after the function; it maps arguments to an exit code.

    `epilog` is the last line of its help: ``Example:`` and a call, which errors of its arguments repeat.
    """
    app = typer.Typer(add_completion=False, rich_markup_mode=None)
    app.command(epilog=epilog)(function)
    return group_entry_point(app, function.__name__)


def group_entry_point(app: typer.Typer, name: str) -> Callable[[Sequence[str]], int]:
    """As `entry_point`, for an application that may have sub-commands."""
    with_plain_help(app)

    def command(arguments: Sequence[str]) -> int:
        return int(app(list(arguments), prog_name=f"fluxbench {name}", standalone_mode=False) or 0)

    return command
