"""What the commands of plugins share: how one becomes an entry point, and an option that most of them have."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated, Any

import typer

AsJson = Annotated[bool, typer.Option("--json", help="Print the result as one JSON object.")]


def entry_point(function: Callable[..., Any]) -> Callable[[Sequence[str]], int]:
    """The callable for the entry point of a command with the function's name: from its arguments to an exit code."""
    app = typer.Typer(add_completion=False, rich_markup_mode=None)
    app.command()(function)
    return group_entry_point(app, function.__name__)


def group_entry_point(app: typer.Typer, name: str) -> Callable[[Sequence[str]], int]:
    """The same for an application that may have sub-commands."""

    def command(arguments: Sequence[str]) -> int:
        return int(app(list(arguments), prog_name=f"fluxbench {name}", standalone_mode=False) or 0)

    return command
