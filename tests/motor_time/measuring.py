"""Runs of the shipped procedures on benches whose truth is known, and what their maps err by."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from orchestrator.analysis import flux_at, injected_points, known_map
from orchestrator.config import load_motor, load_procedure
from orchestrator.engine import AbsentOperator, Interrupts, RunServices, start_run
from orchestrator.flux_maps import load_map
from orchestrator.numerics.types import Array
from orchestrator.recording import open_recording
from orchestrator.runs import RunDirectory
from plugins.drives.simulated import SimulatedOptions, TrueMagnetics, true_flux
from protocols import PointStarted, Procedure, SegmentStage

MOTORS = Path(__file__).parents[2] / "docs" / "motors"
PLANS = ("demo", "quick", "paper")
TARGETS = (0.2, 0.1)
"""Of `commission --until`, in percent."""


@dataclass(frozen=True)
class Bench:
    """A motor and an inverter.

    Attributes
    ----------
    words : str
    motor : str or None
        A file of docs/motors; None: the procedures' own.
    inverter : str
        Of the simulated plant.
    dead_time_v : float
        Lost in each phase; the servo's injected wave has 1.4 V.
    """

    words: str
    motor: str | None
    inverter: str = "averaged"
    dead_time_v: float = 0.8


BENCHES = (
    Bench("400 W, averaged", None),
    Bench("400 W, switched", None, "switched"),
    Bench("48 V servo, averaged", "servo-48v", dead_time_v=0.08),
    Bench("48 V servo, switched", "servo-48v", "switched", dead_time_v=0.08),
    Bench("28 kW, averaged", "interior-magnet-28kw"),
    Bench("28 kW, switched", "interior-magnet-28kw", "switched"),
)


@dataclass(frozen=True)
class Known:
    """A map and what it cost.

    Attributes
    ----------
    how : str
        Procedure, or target.
    seconds : float
        Of motor time: what all excitations take on the drive's clock, settling included.
    points : int
        Of injection.
    rms, worst : float
        Distance from the plant's flux, in percent of the rated flux.
    method : str
        Of the map; "stage" for what the adaptive stage knows while it goes on.
    band : (float, float) or None
        Half of the 95 % band that the stage claims then, rms and at worst, in percent.
    """

    how: str
    seconds: float
    points: int
    rms: float
    worst: float
    method: str
    band: tuple[float, float] | None = None


def procedure_on(bench: Bench, name: str, *, loss_rise: float = 0.105) -> Procedure:
    """A shipped procedure on a bench.

    Parameters
    ----------
    bench : Bench
    name : str
        Of the procedure; the settings of `paper` are scaled by the rated current, its frequency and voltage derived.
    loss_rise : float
        By how much R_s has risen in the end at the rated copper loss.
    """
    file = None if bench.motor is None else MOTORS / f"{bench.motor}.yaml"
    own = load_procedure(name)
    motor = own.motor if file is None else load_motor(file)
    rated_a, ohm = motor.rated_current_a, motor.stator_resistance_ohm
    assert rated_a
    assert ohm
    assert own.motor.rated_current_a
    effects = {
        "dead_time": {"voltage_v": bench.dead_time_v},
        "winding_heating": {"rise_per_watt": loss_rise / (1.5 * ohm * rated_a**2), "time_constant_s": 300.0},
    }
    settings = [
        f"drive.plant.effects={json.dumps(effects)}",
        f"drive.plant.inverter={bench.inverter}",
        "drive.watchdog_s=60.0",
    ]
    if name == "paper" and file is not None:
        settings += _scaled(rated_a / own.motor.rated_current_a)
    return load_procedure(name, overrides=settings, motor=file)


def _scaled(ratio: float) -> Iterator[str]:
    """The paper's currents for another motor; what else is absolute in it is derived from the nameplate."""

    def amperes(value: float) -> float:
        return float(f"{ratio * value:.4g}")

    held = json.dumps([amperes(value) for value in range(-3, 4)])
    yield from (f"stages.{stage}.held_a={held}" for stage in (4, 5))
    yield from (f"stages.4.amplitude_a={amperes(3.0)}", f"stages.5.range_a={amperes(3.0)}")
    yield f"stages.5.step_a={amperes(0.1)}"
    derived = (
        "1.current_a",
        "3.torque_current_a",
        "3.amplitude_v",
        "3.frequency_hz",
        "5.amplitudes_v",
        "5.frequency_hz",
    )
    yield from (f"stages.{field}=null" for field in derived)
    yield from (f"limits.current_a={amperes(5.5)}", "limits.energy_j=null")


def measured(bench: Bench, folder: Path, plans: Sequence[str] = PLANS) -> Iterator[Known]:
    """Procedures on a bench, and the adaptive one on its way to the last target; runs that are there are read."""
    for name in plans:
        yield _delivered(name, _run(procedure_on(bench, name), folder / name))
    for target in TARGETS:
        procedure = procedure_on(bench, "adaptive")
        at = next(k for k, stage in enumerate(procedure.stages) if stage.kind == "adaptive")
        stage = procedure.stages[at].model_copy(update={"until_percent": target})
        stages = (*procedure.stages[:at], stage, *procedure.stages[at + 1 :])
        run = _run(procedure.model_copy(update={"stages": stages}), folder / f"until-{target}")
        if target == TARGETS[-1]:
            yield from _on_the_way(run)
        yield _delivered(f"--until {target:g}%", run)


def _run(procedure: Procedure, path: Path) -> Path:
    if not (path / "results" / "flux_map.nc").is_file():
        result = start_run(procedure, path, RunServices(AbsentOperator(), Interrupts()))
        if result.outcome.error is not None:
            raise result.outcome.error
    return path


def _truth(run: Path) -> tuple[TrueMagnetics, float]:
    """The plant's magnetics, and its rated flux [Wb]."""
    procedure = RunDirectory.open(run).procedure()
    truth = true_flux(SimulatedOptions.model_validate(procedure.drive.options), procedure.motor)
    ends = truth.flux(np.array([[0.0, procedure.motor.rated_current_a or 1.0], [0.0, 0.0]]))
    return truth, float(np.linalg.norm(ends[0] - ends[1]))


def _error(run: Path, current: Array, psi: Array) -> tuple[float, float]:
    """rms and worst distance of psi(i) - psi(0) from the plant's, in percent of the rated flux."""
    truth, rated_wb = _truth(run)
    off = psi - truth.flux(current) + truth.flux(np.zeros((1, 2)))
    length = 100.0 / rated_wb * np.linalg.norm(off, axis=1)
    return float(np.sqrt(np.mean(length**2))), float(length.max())


def _delivered(how: str, run: Path) -> Known:
    """The map that a run delivers, over all of its nodes."""
    found = load_map(run)
    nodes = np.stack(np.meshgrid(found.i_d, found.i_q, indexing="ij"), axis=-1).reshape(-1, 2).astype(np.float64)
    psi = np.column_stack([found.psi_d.ravel(), found.psi_q.ravel()])
    inside = np.isfinite(psi).all(axis=1)
    rms, worst = _error(run, nodes[inside], psi[inside] - flux_at(found)(np.zeros((1, 2))))
    points = len(open_recording(run).segments(SegmentStage.INJECTION))
    return Known(how, sum(seconds for _, seconds in _excitations(run)), points, rms, worst, str(found.method))


def _excitations(run: Path) -> list[tuple[str, float]]:
    """Every excitation and what it took [s]."""
    messages = (record.message for record in RunDirectory.open(run).journal.read())
    return [(message.id, message.seconds) for message in messages if isinstance(message, PointStarted)]


def _on_the_way(run: Path, at_once: int = 4, first: int = 9) -> Iterator[Known]:
    """What the adaptive stage knew each time that it chose, over the disc of its currents."""
    recording, took = open_recording(run), _excitations(run)
    segments = recording.segments(SegmentStage.INJECTION)
    reach = max(float(np.hypot(*(s.settings[f"target_{axis}_a"] for axis in "dq"))) for s in segments)
    angle = np.linspace(0.0, 2.0 * np.pi, 36, endpoint=False)
    disc = np.concatenate([r * reach * np.stack([np.cos(angle), np.sin(angle)], 1) for r in np.linspace(0.1, 1.0, 10)])
    for count in range(first, len(segments) + 1, at_once):
        points, capture_s = injected_points(recording, segments[:count], voltage_delay_samples=_delay(run))
        known = known_map(points, capture_s, segments[0].rotor_angle_rad, reach)
        fit, share = known.fit, 100.0 / _truth(run)[1]
        last = next(k for k, (name, _) in enumerate(took) if name == segments[count - 1].id)
        rms, worst = _error(run, disc, fit.flux(disc)[0] - fit.flux(np.zeros((1, 2)))[0])
        usual, widest = (share * half for half in known.band_wb)
        seconds = sum(s for _, s in took[: last + 1])
        yield Known("on the way", seconds, count, rms, worst, "stage", (usual, widest))


def _delay(run: Path) -> float:
    return open_recording(run).manifest.drive.voltage_delay_samples or 0.0
