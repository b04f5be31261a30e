"""`fluxbench fleet`: many recordings as one table, and what it tells."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import typer
import typer.core

from plugins.commands.fleet._priors import priors
from plugins.commands.fleet._report import report
from plugins.commands.fleet._run import run


class _RunUnlessNamed(typer.core.TyperGroup):
    """What names no command of the group is what `run` is to be done with."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if not args or args[0] not in (*self.commands, *ctx.help_option_names):
            args = ["run", *args]
        return list(super().parse_args(ctx, args))


app = typer.Typer(cls=_RunUnlessNamed, add_completion=False, rich_markup_mode=None)
app.command("run")(run)
app.command("report")(report)
app.command("priors")(priors)


@app.callback()
def fleet() -> None:
    """Many recordings as one table, and what it tells.

    `fluxbench fleet SOURCE... --out TABLE` is `fluxbench fleet run SOURCE... --out TABLE`.
    """


def command(arguments: Sequence[str]) -> int:
    """Entry point of the command."""
    return int(app(list(arguments), prog_name="fluxbench fleet", standalone_mode=False) or 0)
