"""`python -m tests.orchestrator.importing.bring`: strangers' logs of the blind plant, from import to diagnosis.

Each shape of `shapes` is written four times: of a plant with nothing wrong, and with a lag, a sensor's gain or an
inverter's drop. The first says how good the map is that `estimate` makes of it, the others what is reported of it.
"""

from __future__ import annotations

import argparse
import io
import json
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from orchestrator.flux_maps import load_map
from orchestrator.interface.cli._running import run_app
from protocols import FluxMap
from tests.blind.campaign import Bench, Campaign, _manifest, record
from tests.blind.hidden import draw_case
from tests.blind.stepping import STATES_BUS_V, record_states, record_steps, usual
from tests.orchestrator.importing import shapes
from tests.orchestrator.importing.shapes import Shape
from tests.orchestrator.importing.strangers import Desk, Log, log_of

HEADING = "## From a stranger's log to the map"
FAULTS: Mapping[str, Mapping[str, Any]] = {
    "nothing": {},
    "lag": {"delay_samples": 1.0},
    "gain": {"gain_a": 1.02},
    "drop": {"drop_v": 1.0, "drop_a": 0.05},
}
CAMPAIGN = Campaign(
    second_pwm=False, anchors=False, second_amplitude=False, period_s=0.6, injection_s=0.3, dwell_s=0.15
)


@dataclass(frozen=True)
class Brought:
    """One shape: in words, how it was measured, and how it is written."""

    words: str
    measured: str
    write: Shape


SHAPES = (
    Brought("duties, times a bus of its own column", "campaign", shapes.duties),
    Brought("switching states, times the bus", "states", shapes.switching),
    Brought("line-to-line voltages", "campaign", shapes.line_to_line),
    Brought("raw counts of a 16-bit converter", "campaign", shapes.counts),
    Brought("ticks of a counter that wraps", "campaign", shapes.ticks),
    Brought("an epoch in microseconds", "campaign", shapes.epoch),
    Brought("dq values, an encoder's angle of the shaft", "campaign", shapes.shaft),
    Brought("voltage steps, of those on d the d axis alone", "steps", shapes.one_axis),
    Brought("the same, of those on q the q axis alone", "steps", shapes.each_axis_alone),
    Brought("a file a stage, with names and units of its own", "campaign", shapes.a_file_a_stage),
    Brought("a file a channel, as of a scope", "campaign", shapes.scope_channels),
    Brought("two loggers with clocks of their own", "campaign", shapes.two_loggers),
    Brought("MATLAB structs, sine injection", "sine", shapes.matlab_struct),
)


MEASURED: Mapping[str, Callable[[Bench, Path], object]] = {
    "campaign": lambda bench, folder: record(bench, CAMPAIGN, folder),
    "sine": lambda bench, folder: record(bench, replace(CAMPAIGN, sine=True), folder),
    "steps": lambda bench, folder: record_steps(bench, usual(bench, 60.0, 0.08), folder),
    "states": record_states,
}


@dataclass(frozen=True)
class Outcome:
    """Result of one log.

    Attributes
    ----------
    map_percent, std_percent : float
        Error of the map's flux and what it states, both rms over its nodes, of the flux at the rated current.
    reported : tuple of str
        Faults that the commands reported.
    """

    lines: int
    map_percent: float
    std_percent: float
    reported: Sequence[str]


class Laboratory:
    """A bench, measured once for each way and fault, and the commands run on its logs."""

    def __init__(self, seed: int, folder: Path) -> None:
        drawn = draw_case("clean", 1, seed).bench
        self.bench = replace(drawn, drive_delay_samples=0.0)
        self._folder = folder
        self.log = cache(self._log)

    def _log(self, measured: str, fault: str) -> Log:
        at = self._folder / f"{measured}-{fault}"
        MEASURED[measured](replace(self.bench, plant=self.bench.plant._replace(**FAULTS[fault])), at)
        return log_of((), at)

    def outcome(self, brought: Brought, fault: str, diagnosed: bool = True) -> Outcome:
        """Write the log, import it, and ask the commands."""
        with tempfile.TemporaryDirectory(dir=self._folder) as name:
            desk = Desk(Path(name), plate=self._plate(brought.measured))
            brought.write(desk, self.log(brought.measured, fault))
            out = str(desk.folder / "recording")
            report = _run_command("import", str(desk.write_mapping()), *map(str, desk.files), "--out", out)
            estimated = _run_command("estimate", out)
            off = self.off_percent(load_map(Path(out)))
            reported = (*_imported(report), *_estimated(estimated))
            if diagnosed:
                reported += tuple(_diagnosed(_run_command("diagnose", out)))
        return Outcome(len(desk.mapping.splitlines()), *off, reported)

    def _plate(self, measured: str) -> str:
        """What the stranger knows: the nameplate, and R_s to a percent where nothing will rest."""
        about = _manifest(self.bench, "", [])
        motor, drive = about["motor"], about["drive"]
        if measured in ("steps", "states"):
            ohm = self.bench.plant.resistance
            motor |= {"stator_resistance_ohm": 1.01 * ohm, "stator_resistance_std_ohm": 0.01 * ohm}
        del drive["sampling_frequency_hz"], drive["pwm_frequency_hz"]
        if measured == "states":
            drive["dc_bus_voltage_v"] = STATES_BUS_V
        return yaml.safe_dump(json.loads(json.dumps({"motor": motor, "drive": drive}, default=float)))

    def off_percent(self, found: FluxMap) -> tuple[float, float]:
        grid = np.stack(np.meshgrid(found.i_d, found.i_q, indexing="ij"), axis=-1).reshape(-1, 2).astype(np.float64)
        psi = np.column_stack([found.psi_d.ravel() - self.bench.machine.pm_flux_wb, found.psi_q.ravel()])
        std = np.column_stack([found.psi_d_std.ravel(), found.psi_q_std.ravel()])
        there = np.isfinite(psi).all(axis=1)
        table = self.bench.table
        zero = np.array(table.flux(0.0, 0.0))
        off = psi[there] - (np.array([table.flux(*i) for i in grid[there]]) - zero)
        rated = float(np.linalg.norm(table.flux(0.0, 2**0.5 * self.bench.machine.rated_current_rms_a) - zero))
        error, stated = (100.0 / rated * float(np.sqrt((x**2).sum(axis=1).mean())) for x in (off, std[there]))
        return error, stated


def _run_command(command: str, *words: str) -> dict[str, Any]:
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = run_app([command, *words, "--json"])
    if code:
        raise RuntimeError(f"{command}: exit {code}: {err.getvalue()}")
    answer: dict[str, Any] = json.loads(out.getvalue())
    return answer


def _imported(report: dict[str, Any]) -> Iterator[str]:
    for note in report["notes"]:
        if "follows the commanded voltage by" in note:
            yield f"import: {note.split('voltage by ')[1].split(' samples')[0]} samples"


def _estimated(report: dict[str, Any]) -> Iterator[str]:
    for reason in report["reasons"]:
        if "the voltage acts" in reason:
            yield f"estimate: {reason.split('the voltage acts ')[1].split(' than')[0]}, not usable"
        for word in ("loses ", "keeps "):
            if word in reason and "up to" not in reason:
                yield f"estimate: {reason.split(word)[1].split(' V')[0]} V"


def _diagnosed(report: dict[str, Any]) -> Iterator[str]:
    if report.get("convention"):
        yield f"diagnose: {report['convention']['what'].split('the voltage acts ')[-1].split(' than')[0]}"
    for effect in report["effects"]:
        first = next(iter(effect["parameters"].values()))
        number = f"{100 * first['value']:.2f} %" if first["unit"] == "1" else f"{first['value']:.3g} {first['unit']}"
        twins = "".join(f" or {name.replace('_', ' ')}" for name in effect["twins"])
        yield f"diagnose: {effect['name'].replace('_', ' ')}{twins} {number}"
    if report["verdict"] not in ("explained", "clean", "convention"):
        yield f"diagnose: {report['verdict'].replace('_', ' ')}"


def section(outcomes: Mapping[tuple[str, str], Outcome], seed: int) -> str:
    """The table, as Markdown."""
    lines = [
        HEADING,
        "",
        "These logs are of a plant that shares no code with this project, written in the forms of other",
        "laboratories. The table has the map's error after `import`, `estimate` and `diagnose` (rms, of the flux",
        "at the rated current; in brackets the stated error). The last columns have what is reported where the",
        "voltage acts one sample late, sensor a reads 2 % too much, or each phase loses 1 V. Lines of mapping",
        "come in addition to the five of head, motor and drive.",
        f"`python -m tests.orchestrator.importing.bring --seed {seed} --log FILE`, {datetime.now(UTC):%Y-%m-%d}.",
        "",
        "| log | lines | map off (stated), % | nothing wrong | one sample late | 2 % gain of a | 1 V drop |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for brought in SHAPES:
        if (brought.words, "nothing") in outcomes:
            each = [outcomes[brought.words, fault] for fault in FAULTS]
            cells = ["; ".join(one.reported) or "nothing stated" for one in each]
            first = each[0]
            lines.append(
                f"| {brought.words} | {first.lines} | {first.map_percent:.3f} ({first.std_percent:.3f}) "
                f"| {' | '.join(cells)} |"
            )
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--only", nargs="*", type=int, default=range(len(SHAPES)), help="numbers of shapes")
    parser.add_argument("--log", type=Path, required=True, help="outcomes so far, which are not measured again")
    parser.add_argument("--write", type=Path, help="the page whose section is this table")
    options = parser.parse_args(arguments)
    kept = [json.loads(line) for line in options.log.read_text().splitlines()] if options.log.exists() else []
    outcomes = {(words, fault): Outcome(**one) for words, fault, one in kept}
    with tempfile.TemporaryDirectory(prefix="strangers-") as folder:
        laboratory = Laboratory(options.seed, Path(folder))
        for brought in (SHAPES[number] for number in options.only):
            for fault in FAULTS:
                if (brought.words, fault) not in outcomes:
                    outcomes[brought.words, fault] = one = laboratory.outcome(brought, fault)
                    with options.log.open("a") as file:
                        file.write(json.dumps([brought.words, fault, asdict(one)]) + "\n")
    page = section(outcomes, options.seed)
    print(page)
    if options.write is not None:
        before, _, rest = options.write.read_text(encoding="utf-8").partition(HEADING)
        _, mark, after = rest.partition("\n## ")
        options.write.write_text(before + page + "\n" + (mark and "\n## ") + after, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
