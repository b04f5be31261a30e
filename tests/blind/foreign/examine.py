"""Make a foreign case's recording and its truth, ask the diagnosis about it, and keep what it stated."""

from __future__ import annotations

import json
import resource
import shutil
import tempfile
import time
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from protocols import FluxMap, ResistanceEstimate
from tests.blind.delivered import Delivered
from tests.blind.examine import forget_peak
from tests.blind.foreign.cases import Case, draw_case
from tests.blind.foreign.record import measured_truth, record


@dataclass(frozen=True)
class Answer:
    """What the diagnosis stated of a case, and what the plant itself knows of it.

    Attributes
    ----------
    report : dict or None
        The JSON contract's object; None where there was an error instead.
    does : dict
        As from `measured_truth`.
    delivered : dict or None
        Fields of `Delivered`; None where nothing was.
    """

    case: Case
    report: dict[str, Any] | None
    error: str | None
    does: dict[str, Any]
    samples: int
    cpu_s: float
    peak_mb: float
    delivered: dict[str, Any] | None = None


def stored_recording(case: Case, folder: Path) -> Path:
    """The case's recording in a folder, made where it is missing; its truth lies beside it, for the judge alone."""
    path, truth = folder / f"{case.kind}-{case.index}", folder / f"{case.kind}-{case.index}.truth.json"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        unfinished = folder / f".{path.name}"
        shutil.rmtree(unfinished, ignore_errors=True)
        record(case.rig, unfinished)
        unfinished.rename(path)
    if not truth.exists():
        truth.write_text(json.dumps(_truth(case), indent=1), encoding="utf-8")
    return path


def _truth(case: Case) -> dict[str, Any]:
    rig = case.rig
    top = rig.motor.plate.top_a
    low, high = (top * end for end in rig.motor.span_d)
    nodes = [(float(d), float(q)) for d in np.linspace(low, high, 9) for q in np.linspace(-top, top, 9)]
    return {
        "hidden": case.hidden, "foreign": case.foreign, "machine": case.family, "sharp": rig.motor.sharp,
        "plan": rig.plan, "resistance_ohm": rig.plant.resistance,
        "effects": [{"name": t.name, "size": t.size, "amounts": t.amounts} for t in case.truths],
        "does": measured_truth(rig),
        "plant": rig.plant._asdict(),
        "map_a_wb": [[*node, *rig.motor.iron.flux(*node)] for node in nodes],
    }  # fmt: skip


def examine(case: Case, recordings: Path | None = None) -> Answer:
    """Diagnose a case's recording; by default it is made in a temporary place."""
    from orchestrator.diagnosis import diagnose_recording
    from orchestrator.recording import open_recording
    from orchestrator.registry.plugins import PluginKind, installed, load_plugin
    from protocols import FluxbenchError

    with tempfile.TemporaryDirectory(prefix="foreign-") as place:
        folder = Path(place) / "recordings" if recordings is None else recordings
        path = stored_recording(case, folder)
        does = json.loads((folder / f"{path.name}.truth.json").read_text(encoding="utf-8"))["does"]
        recording = open_recording(path)
        samples = sum(segment.samples for segment in recording.manifest.segments)
        library = [load_plugin(PluginKind.EFFECTS, info.name)() for info in installed(PluginKind.EFFECTS)]
        forget_peak()
        cpu = time.process_time()
        report, error, delivered = None, None, None
        try:
            found = diagnose_recording(recording, library, model="saturated", out=Path(place))
            report = found.report.model_dump(mode="json")
            if (made := found.delivery) is not None:
                delivered = asdict(held_against(case, made.map, made.resistance, not made.objections))
        except FluxbenchError as refused:
            error = str(refused)
        cpu = time.process_time() - cpu
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return Answer(case, report, error, does, samples, cpu, peak, delivered)


def held_against(case: Case, found: FluxMap, resistance: ResistanceEstimate, usable: bool) -> Delivered:
    """The delivered map beside the plant's own."""
    iron, plate = case.rig.motor.iron, case.rig.motor.plate
    rest_d, _ = iron.flux(0.0, 0.0)
    off, std = [], []
    for k, i_d in enumerate(found.i_d):
        for m, i_q in enumerate(found.i_q):
            if np.isfinite(found.psi_d[k, m]):
                psi_d, psi_q = iron.flux(float(i_d), float(i_q))
                off.append((found.psi_d[k, m] - plate.pm_flux_wb - psi_d + rest_d, found.psi_q[k, m] - psi_q))
                std.append((found.psi_d_std[k, m], found.psi_q_std[k, m]))
    error = np.array(off)
    return Delivered(
        map_percent=100.0 * float(np.sqrt(np.mean(error**2))) / plate.rated_flux_wb,
        inside=float(np.mean(np.abs(error) <= 1.96 * np.array(std))),
        resistance_percent=100.0 * abs(resistance.value_ohm / case.rig.plant.resistance - 1.0),
        usable=usable,
    )


def keep(file: Path | None, seed: int, answer: Answer) -> None:
    """Append an answer to a file of JSON lines; nowhere, where there is none."""
    if file is not None:
        row = {one.name: getattr(answer, one.name) for one in fields(Answer) if one.name != "case"}
        with file.open("a", encoding="utf-8") as lines:
            lines.write(json.dumps({"seed": seed, "case": [answer.case.kind, answer.case.index], **row}) + "\n")


def kept(file: Path | None, seed: int) -> dict[tuple[str, int], Answer]:
    """The answers in such a file that belong to this seed, by class and index."""
    if file is None or not file.exists():
        return {}
    answers = {}
    for line in file.read_text(encoding="utf-8").splitlines():
        row = json.loads(line)
        if row.pop("seed") == seed:
            kind, index = row.pop("case")
            answers[kind, index] = Answer(draw_case(kind, index, seed), **row)
    return answers
