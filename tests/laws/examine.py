"""Make a recording, diagnose it, discover, add what was written, and keep what was printed."""

from __future__ import annotations

import json
import time
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from tests.laws.baselines import thresholded_terms
from tests.laws.subjects import Subject, subject


@dataclass(frozen=True)
class Answer:
    """What was printed of one recording.

    Attributes
    ----------
    kind : str
        Label of the subject.
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
    usable_before, usable_after : bool
        Whether nothing is stated against these maps.
    diagnose_s, discover_s : float
        CPU seconds.
    baseline : dict
        What other methods find of the same leftover, by their names.
    ranked : list of (str, str, str)
        Place, quantity and phase of the best flexible law.
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
    usable_before: bool | None = None
    usable_after: bool | None = None
    ranked: list[str] = field(default_factory=list)


def examine(label: str, seed: int, folder: Path) -> Answer:
    """Go through the commands of the page; recordings that are in the folder are not made again."""
    import fluxbench

    hidden = subject(label, seed)
    place = recording_in(folder, label)
    law = place.with_name(f"{place.name.replace('-', '_')}_law.py")
    if not (place / "recording.json").exists():
        hidden.record(place)
    law.unlink(missing_ok=True)
    start = time.process_time()
    verdict = fluxbench.diagnose(place, without=hidden.without).report.verdict
    diagnosed = time.process_time()
    map_before = map_error(fluxbench.map_of(place), hidden) if (place / "model.json").exists() else None
    usable_before = is_usable(place) if map_before is not None else None
    begin = time.process_time()
    found = fluxbench.discover(place, write=law, without=hidden.without)
    discovered = time.process_time()
    map_after = usable_after = None
    if found.outcome == "law":
        fluxbench.add(place, *(one.name for one in found.laws), effects=law)
        map_after, usable_after = map_error(fluxbench.map_of(place), hidden), is_usable(place)
    best = [[one.place, one.quantity, one.phase] for one in found.ranking[:1]]
    return Answer(
        label, seed, verdict, found.outcome, found.reason,
        [[one.place, one.quantity, one.phase] for one in found.laws],
        [_with_constants(one.forms[0]) for one in found.laws],
        found.before, found.after, map_before, map_after, diagnosed - start, discovered - begin, {},
        usable_before, usable_after, best[0] if best else [],
    )  # fmt: skip


def with_baseline(answer: Answer, folder: Path) -> Answer:
    """The answer with what other methods find of the same recording."""
    from orchestrator.recording import open_recording

    recording = open_recording(recording_in(folder, answer.kind))
    return replace(answer, baseline=thresholded_terms(recording))


def recording_in(folder: Path, label: str) -> Path:
    """The recording of a label in a folder of recordings."""
    return folder / label.replace(":", "-")


def map_error(found: Any, hidden: Subject) -> float:
    """rms error of the flux where the map has values, in percent of the rated flux."""
    error = []
    for k, i_d in enumerate(found["i_d"].values):
        for m, i_q in enumerate(found["i_q"].values):
            psi_d, psi_q = float(found["psi_d"][k, m]), float(found["psi_q"][k, m])
            if np.isfinite(psi_d):
                true_d, true_q = hidden.flux(float(i_d), float(i_q))
                error.append((psi_d - hidden.magnet_wb - true_d, psi_q - true_q))
    return 100.0 * float(np.sqrt(np.mean(np.square(error)))) / hidden.rated_wb


def is_usable(place: Path) -> bool:
    """Whether nothing is stated against the map that a recording's results hold."""
    from orchestrator.estimation import load_estimates
    from protocols import Usability

    return load_estimates(place).usability is Usability.USABLE


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
