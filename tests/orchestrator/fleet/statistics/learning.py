"""How much a fleet helps its next motor: a series is simulated and diagnosed, then each motor from a fifth of its data.

    python -m tests.orchestrator.fleet.statistics.learning --motors 20 --keep FOLDER

prints the table of docs/fleet-report.md. A motor of the series has an R_s and effects of its own, drawn from what all
have in common; priors of the other motors serve its diagnosis. Takes half a minute of one core a motor.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from orchestrator.config import load_procedure
from orchestrator.diagnosis import diagnose_recording
from orchestrator.fleet.statistics import fleet_of, priors_of
from orchestrator.interface.api import chosen_effects
from protocols import DiagnosisReport, FoundEffect, Procedure, RecordingReader, Segment, SegmentStage
from protocols.fleet import FleetEffect, FleetRow
from protocols.fleet_priors import FleetPriors
from tests.orchestrator.analysis.campaign import MemoryRecording
from tests.orchestrator.fleet.statistics.example_fleet import table_of
from tests.support.simulated import measure

Truth = Mapping[tuple[str, str], float]
MOTOR = "400 W test PMSM"
TWINS = {"device_drop": "dead_time", "voltage_bias": "current_offset"}
"""Effects that these recordings cannot separate: one PWM frequency, and no reading with gates off."""


@dataclass(frozen=True)
class Common:
    """One amplitude of an effect, as the motors of a series have it."""

    effect: str
    parameter: str
    mean: float
    std: float
    share: float = 1.0
    """Of the motors that have the effect."""


SERIES = (
    Common("dead_time", "voltage_v", 1.5, 0.15),
    Common("phase_resistance_imbalance", "extra_a_ohm", 0.040, 0.008),
    Common("phase_resistance_imbalance", "extra_b_ohm", 0.050, 0.008),
    Common("current_offset", "offset_a_a", 0.006, 0.002),
    Common("current_offset", "offset_b_a", -0.003, 0.002),
    Common("current_gain_mismatch", "gain_a_minus_b", 0.008, 0.002, share=0.5),
)
SHORT = {
    "stages.5.duration_s": 0.2,
    "stages.6.duration_s": 0.2,
    "stages.7.periods": 1,
    "stages.7.period_s": 0.4,
    "stages.8.duration_s": 0.1,
    "stages.9.duration_s": 0.2,
}
"""Settings of the procedure `quick` with which it holds some 0.1 million samples."""


def motor(number: int, noise_a: float) -> tuple[Procedure, Truth]:
    """A short procedure on a motor of the series, and what that motor has."""
    rng = np.random.default_rng([7, number])
    names = dict.fromkeys(common.effect for common in SERIES)
    there = {name: rng.random() < next(c.share for c in SERIES if c.effect == name) for name in names}
    truth = {
        (c.effect, c.parameter): c.mean + c.std * float(draw)
        for c, draw in zip(SERIES, rng.normal(size=len(SERIES)), strict=True)
        if there[c.effect]
    }
    effects: dict[str, dict[str, float]] = {}
    for (effect, parameter), value in truth.items():
        effects.setdefault(effect, {})[parameter] = value
    resistance = 4.25 * (1.0 + 0.01 * float(rng.normal()))
    plant = {"sensors": {"noise_a": noise_a}, "effects": effects, "resistance_ohm": resistance}
    settings: dict[str, object] = {"drive.plant": plant, "seed": number, **SHORT}
    return load_procedure("quick", overrides=[f"{key}={json.dumps(value)}" for key, value in settings.items()]), truth


def part_of(whole: MemoryRecording, every: int) -> MemoryRecording:
    """One of so many segments of each kind, the first of each in any case."""
    kept: list[Segment] = []
    for stage in SegmentStage:
        kept += [s for s in whole.manifest.segments if s.stage is stage][::every]
    kept.sort(key=lambda segment: segment.start_s)
    manifest = whole.manifest.model_copy(update={"segments": tuple(kept)})
    return MemoryRecording(manifest, {s.id: whole.captures[s.id] for s in kept})


@dataclass
class Score:
    """How a way of diagnosing did."""

    motors: int = 0
    right: int = 0
    """Motors of which all effects were named, and no other."""
    missed: int = 0
    wrong: int = 0
    held: int = 0
    intervals: int = 0
    cpu_s: float = 0.0

    def __post_init__(self) -> None:
        self.widths: list[float] = []
        self.errors: list[float] = []

    def count(self, report: DiagnosisReport, truth: Truth) -> None:
        """Hold one diagnosis against the truth."""
        named = {TWINS.get(effect.name, effect.name): effect for effect in (*report.effects, *report.minor)}
        there = {effect for effect, _ in truth}
        self.motors += 1
        self.missed += len(there - set(named))
        self.wrong += len(set(named) - there)
        self.right += set(named) == there
        spread = {(common.effect, common.parameter): common.std for common in SERIES}
        for (effect, parameter), value in truth.items():
            estimate = named[effect].parameters.get(parameter) if effect in named else None
            size = 0.0 if estimate is None or estimate.value is None else estimate.value
            self.errors.append((size - value) / spread[effect, parameter])
            if estimate is None or estimate.low is None or estimate.high is None:
                continue
            self.intervals += 1
            self.held += estimate.low <= value <= estimate.high
            self.widths.append(0.5 * (estimate.high - estimate.low) / spread[effect, parameter])

    def row(self, name: str) -> str:
        """One of the table's."""
        width, error = np.median(self.widths), np.sqrt(np.mean(np.square(self.errors)))
        held = f"{100.0 * self.held / self.intervals:.0f} % of {self.intervals}"
        names = f"{self.right} of {self.motors} | {self.missed} | {self.wrong}"
        return f"| {name} | {names} | {width:.2f} | {error:.2f} | {held} | {self.cpu_s / self.motors:.1f} |"


def diagnosed(recording: MemoryRecording, folder: Path, name: str, priors: FleetPriors | None = None) -> Kept:
    """A diagnosis, kept in a file: it is made once."""
    path = folder / f"{name}.json"
    if not path.is_file():
        began = time.process_time()
        reader: RecordingReader = recording
        diagnosis = diagnose_recording(reader, chosen_effects(), out=folder, priors=priors)  # type: ignore[arg-type]
        kept = {"cpu_s": time.process_time() - began, "report": json.loads(diagnosis.report.model_dump_json())}
        path.write_text(json.dumps(kept))
    kept = json.loads(path.read_text())
    return Kept(DiagnosisReport.model_validate(kept["report"]), kept["cpu_s"])


@dataclass(frozen=True)
class Kept:
    """A diagnosis and what it took."""

    report: DiagnosisReport
    cpu_s: float


def row_of(number: int, report: DiagnosisReport) -> FleetRow:
    """A motor's row of the fleet's table."""
    effects = [one for effect in (*report.effects, *report.minor) for one in sizes(effect)]
    return FleetRow(
        key=str(number),
        source=str(number),
        serial=str(number),
        motor=MOTOR,
        verdict=report.verdict,
        effects=tuple(effects),
    )


def sizes(effect: FoundEffect) -> Iterator[FleetEffect]:
    """The parameters in the first one's unit."""
    unit = next(iter(effect.parameters.values())).unit
    for name, p in effect.parameters.items():
        if p.unit == unit:
            size = {"size": p.value, "low": p.low, "high": p.high, "unit": unit}
            yield FleetEffect(name=effect.name, parameter=name, probability=effect.probability, **size)


def compared(motors: int, noise_a: float, folder: Path, every: int = 5) -> dict[str, Score]:
    """Each motor from all of its data, from a part, and from the part with what the others let expect."""
    folder.mkdir(parents=True, exist_ok=True)
    recordings = {}
    for number in range(motors):
        procedure, truth = motor(number, noise_a)
        recordings[number] = measure(procedure).recording, truth
    whole = {number: diagnosed(recording, folder, f"{number}-all") for number, (recording, _) in recordings.items()}
    rows = {number: row_of(number, kept.report) for number, kept in whole.items()}
    scores = {name: Score() for name in ("all of the data", "a fifth", "a fifth, and the fleet")}
    for number, (recording, truth) in recordings.items():
        others = fleet_of(table_of([row for k, row in rows.items() if k != number]), "the others")
        part = part_of(recording, every)
        bare = diagnosed(part, folder, f"{number}-part")
        helped = diagnosed(part, folder, f"{number}-helped", priors_of(others))
        for score, kept in zip(scores.values(), (whole[number], bare, helped), strict=True):
            score.count(kept.report, truth)
            score.cpu_s += kept.cpu_s
    return scores


def main(words: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--motors", type=int, default=20)
    parser.add_argument("--noise", type=float, default=0.1, help="of each phase current's reading [A]")
    parser.add_argument("--keep", type=Path, default=Path("runs/learning"))
    given = parser.parse_args(words)
    print(
        "| diagnosed from | all names right | missed | wrong | half width | error | 95 % intervals that hold | CPU s |"
    )
    print("| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |")
    for name, score in compared(given.motors, given.noise, given.keep).items():
        print(score.row(name))


if __name__ == "__main__":
    main()
