"""Make a law's recording, diagnose it, discover, add what was written, and keep what was printed."""

from __future__ import annotations

import json
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tests.laws.baselines import thresholded_terms
from tests.laws.bench import record
from tests.laws.hidden import draw
from tests.laws.plant import Machine

RATED_FLUX_WB = 0.3
"""Of the machine on the bench, as its nameplate states it."""


@dataclass(frozen=True)
class Answer:
    """What was printed of one hidden law.

    Attributes
    ----------
    verdict : str
        The diagnosis' without the law.
    outcome, reason : str
        Of the search.
    places : list of (str, str, str)
        Place, quantity and phase of each law that was written.
    formulas : list of str
        Of these, with constants.
    before, after : float
        Held-out rms in units of its noise.
    map_before, map_after : float
        rms error of the map without and with the law, in percent of the rated flux.
    diagnose_s, discover_s : float
        CPU seconds.
    baseline : dict
        Fields of `Thresholded`: what thresholded least squares finds of the same leftover.
    """

    kind: str
    seed: int
    verdict: str
    outcome: str
    reason: str
    places: list[list[str]]
    formulas: list[str]
    before: float
    after: float
    map_before: float | None
    map_after: float | None
    diagnose_s: float
    discover_s: float
    baseline: dict[str, Any] = field(default_factory=dict)


def examine(kind: str, seed: int, folder: Path) -> Answer:
    """Go through the commands of the page; recordings that are in the folder are not made again."""
    import fluxbench
    from orchestrator.recording import open_recording

    hidden, machine = draw(kind, seed)
    place, law = folder / kind, folder / f"{kind}_law.py"
    if not (place / "recording.json").exists():
        record(place, hidden, seed, machine)
    law.unlink(missing_ok=True)
    start = time.process_time()
    verdict = fluxbench.diagnose(place).report.verdict
    diagnosed = time.process_time()
    map_before = map_error(fluxbench.map_of(place), machine)
    begin = time.process_time()
    found = fluxbench.discover(place, write=law)
    discovered = time.process_time()
    map_after = None
    if found.outcome == "law":
        fluxbench.add(place, *(one.name for one in found.laws), effects=law)
        map_after = map_error(fluxbench.map_of(place), machine)
    return Answer(
        kind, seed, verdict, found.outcome, found.reason,
        [[one.place, one.quantity, one.phase] for one in found.laws],
        [_with_constants(one.forms[0]) for one in found.laws],
        found.before, found.after, map_before, map_after, diagnosed - start, discovered - begin,
        asdict(thresholded_terms(open_recording(place))),
    )  # fmt: skip


def map_error(found: Any, machine: Machine) -> float:
    """rms error of the flux where the map has values, in percent of the rated flux."""
    error = []
    rest = machine.flux(0.0, 0.0)[0]
    for k, i_d in enumerate(found["i_d"].values):
        for m, i_q in enumerate(found["i_q"].values):
            psi_d, psi_q = float(found["psi_d"][k, m]), float(found["psi_q"][k, m])
            if np.isfinite(psi_d):
                true_d, true_q = machine.flux(float(i_d), float(i_q))
                error.append((psi_d - RATED_FLUX_WB - (true_d - rest), psi_q - true_q))
    return 100.0 * float(np.sqrt(np.mean(np.square(error)))) / RATED_FLUX_WB


def _with_constants(form: Any) -> str:
    return f"{form.formula}: " + ", ".join(f"{c.name} {c.value:.4g}" for c in form.constants)


def keep(file: Path, answer: Answer) -> None:
    """Append an answer to a file of JSON lines."""
    with file.open("a", encoding="utf-8") as lines:
        lines.write(json.dumps(asdict(answer)) + "\n")


def kept(file: Path, seed: int) -> dict[str, Answer]:
    """The answers of a seed in such a file, by kind; the last of each."""
    if not file.exists():
        return {}
    rows = (json.loads(line) for line in file.read_text(encoding="utf-8").splitlines())
    return {row["kind"]: Answer(**row) for row in rows if row["seed"] == seed}
