"""`fluxbench fleet`: many recordings as one table, and its statistics."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
import typer.core

from plugins.command_line import AsJson, group_entry_point
from plugins.commands.fleet._damage import SkipDamaged, exit_code
from plugins.commands.fleet._report import report
from plugins.commands.fleet._run import run

HELP_GROUP = "Recordings and runs"
"""Its place in the list of commands."""


class _RunUnlessNamed(typer.core.TyperGroup):
    """A group that passes arguments without a command's name to `run`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if not args or args[0] not in (*self.commands, *ctx.help_option_names):
            args = ["run", *args]
        return list(super().parse_args(ctx, args))


def priors(
    table: Annotated[
        str, typer.Argument(help="A fleet's table: a Parquet file, or a folder of them.", metavar="TABLE")
    ],
    out: Annotated[
        Path, typer.Option(help="JSON file to write; `fluxbench diagnose RUN --priors FILE` takes it.", metavar="FILE")
    ],
    motor: Annotated[
        str | None, typer.Option(help="Nameplate's name, where the table has several kinds of motor.", metavar="NAME")
    ] = None,
    skip_damaged: SkipDamaged = False,
    as_json: AsJson = False,
) -> int:
    """Priors for the next motor of the fleet: frequency and size of each effect, R_s, L_d and L_q."""
    from orchestrator.fleet.statistics import prior_rows, priors_of, read_fleet
    from orchestrator.formatting.sentences import shown, text_table, visible
    from orchestrator.recording import replace_file

    fleet = read_fleet(table)
    document = priors_of(fleet, motor)
    text = visible(document.model_dump_json(indent=2))
    replace_file(out, (text + "\n").encode("utf-8"))
    if as_json:
        print(text)
        return exit_code(fleet.damaged, skip_damaged)
    rows = prior_rows(document)
    print(shown(text_table(rows[0], rows[1:], numbers=False)))
    print(shown(str(out)))
    return exit_code(fleet.damaged, skip_damaged)


app = typer.Typer(cls=_RunUnlessNamed, add_completion=False, rich_markup_mode=None)
app.command("run", epilog="Example: fluxbench fleet run recordings --out table")(run)
app.command("report", epilog="Example: fluxbench fleet report table")(report)
app.command("priors", epilog="Example: fluxbench fleet priors table --out priors.json")(priors)


@app.callback()
def fleet() -> None:
    """Many recordings as one table, and its statistics.

    `fluxbench fleet SOURCE... --out TABLE` is `fluxbench fleet run SOURCE... --out TABLE`.
    """


command = group_entry_point(app, "fleet")
