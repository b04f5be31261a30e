"""`fluxbench fleet priors`: what a fleet's motors have in common, for the next one's diagnosis."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def priors(
    table: Annotated[str, typer.Argument(help="A fleet's table: a Parquet file, or a folder of them.")],
    out: Annotated[Path, typer.Option(help="JSON file to write; `fluxbench diagnose RUN --priors FILE` takes it.")],
    motor: Annotated[str | None, typer.Option(help="Of several kinds of motor, the nameplate's name.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as one JSON object.")] = False,
) -> int:
    """How often each effect is there and how large, R_s, L_d and L_q, as the next motor lets expect them."""
    from orchestrator.fleet.statistics import prior_rows, priors_of, read_fleet
    from orchestrator.formatting.sentences import shown, text_table, visible
    from orchestrator.recording import replace_file

    document = priors_of(read_fleet(table), motor)
    replace_file(out, (visible(document.model_dump_json(indent=2)) + "\n").encode("utf-8"))
    if as_json:
        print(visible(document.model_dump_json(indent=2)))
        return 0
    rows = prior_rows(document)
    print(shown(text_table(rows[0], rows[1:], numbers=False)))
    print(shown(str(out)))
    return 0
