"""The application: its group of commands, `--version`, and the text of a bare `fluxbench`."""

from __future__ import annotations

from typing import Annotated, Any

import typer
import typer.core

from orchestrator.interface.cli import _analysis_commands, _bench_commands, _file_commands
from orchestrator.interface.cli._foreign import is_foreign
from orchestrator.interface.cli.help_text import HELP_NAMES, with_plain_help, write_commands

ENERGISING = ("run", "resume")


class _Commands(typer.core.TyperGroup):
    """The group of commands; typer itself would end at Ctrl-C without a message.

    A callable object of the context is called with whether the command energises, before the command begins; for a
    plugin's command, when that is loaded.
    """

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        command = super().resolve_command(ctx, args)
        if callable(ctx.obj) and not is_foreign(command[0]):
            ctx.obj(command[0] in ENERGISING)
        return command

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the list of commands in groups."""
        commands = [(name, self.get_command(ctx, name)) for name in self.list_commands(ctx)]
        write_commands([(name, command) for name, command in commands if command and not command.hidden], formatter)

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            raise typer.Abort from None


app = typer.Typer(
    cls=_Commands,
    name="fluxbench",
    help="Commission a permanent-magnet synchronous motor: saturated current-flux relations, measured and checked.",
    add_completion=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings=dict(HELP_NAMES),
)

START = """fluxbench commissions a permanent-magnet synchronous motor. To begin with:

  fluxbench procedures            list the procedures
  fluxbench check demo            dry run of one; nothing is energised
  fluxbench run demo              run it on a simulated drive
  fluxbench diagnose runs/NAME    find the effect that the model lacks
  fluxbench explain runs/NAME     show the reasons of the diagnosis
  fluxbench probe                 drives on this machine's serial ports and CAN buses

fluxbench --help lists all commands, fluxbench COMMAND --help the options of one."""


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"fluxbench {version('fluxbench')}")
        raise typer.Exit


VersionOption = Annotated[
    bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
]


@app.callback(invoke_without_command=True)
def start(context: typer.Context, _version: VersionOption = False) -> None:
    """Commission a permanent-magnet synchronous motor: saturated current-flux relations, measured and checked."""
    if context.invoked_subcommand is None:
        typer.echo(START)


for _module in (_bench_commands, _analysis_commands, _file_commands):
    app.registered_commands += with_plain_help(_module.commands).registered_commands
