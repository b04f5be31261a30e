"""A scripted run as messages, for the stream kit: every kind, plausible numbers, no drive."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from protocols import (
    AxisPercent,
    Capture,
    Compared,
    CompareReport,
    Diagnosed,
    DiagnosisReport,
    DiagnosisStep,
    DiagnosisWords,
    DriveRecord,
    EstimationReport,
    ExperimentProposed,
    FluxMap,
    FluxMapEstimate,
    FluxPoints,
    LawLearned,
    Limits,
    LockChecked,
    Manifest,
    MapChecks,
    MapEstimated,
    Message,
    Motor,
    NoiseFloor,
    Note,
    OperatorAnswered,
    OperatorAsked,
    PointDone,
    PointStarted,
    ResistanceEstimate,
    ResistanceEstimated,
    ResistanceReading,
    RunEnded,
    Rung,
    RunStarted,
    SamplesCaptured,
    Segment,
    SegmentStage,
    StageEntry,
    StagesAppended,
    StageStarted,
    StageSufficed,
    StateChanged,
    Unexplained,
)

MOTOR = Motor(name="kit's motor", pole_pairs=2, rated_current_rms_a=1.66, stator_resistance_ohm=4.25)
POINTS = 20
SAMPLING_FREQUENCY_HZ = 10000.0


def a_manifest() -> Manifest:
    """The manifest of a run that has measured nothing yet."""
    return Manifest(
        format="fluxbench-recording",
        version=1,
        name="kit",
        created="2026-01-01T00:00:00Z",
        motor=MOTOR,
        drive=DriveRecord(name="kit", sampling_frequency_hz=SAMPLING_FREQUENCY_HZ, dc_bus_voltage_v=540.0),
        segments=(),
    )


def a_run(run: Path) -> list[Message]:
    """A short run from its start to its end."""
    opening: list[Message] = [
        _started(run),
        StateChanged(source="idle", target="connecting"),
        StateChanged(source="connecting", target="sweeping_kit"),
        StageStarted(index=0, stage="kit_sweep", title="the kit's sweep", points=POINTS),
    ]
    middle: list[Message] = []
    for k, done in enumerate(points_done(run, POINTS)):
        middle += [_point_started(k), next(iter(samples(run, 1))), done]
    others = [m for m in one_of_each(run) if m.kind not in {"run_started", "run_ended", "state_changed"}]
    return [*opening, *middle, *others, _ended(run)]


def one_of_each(run: Path) -> list[Message]:
    """One message of every kind."""
    return [
        _started(run),
        StateChanged(source="sweeping_kit", target="stopping", reason="all points are done"),
        StageStarted(index=3, stage="kit_sweep", title="the kit's sweep", points=POINTS),
        _point_started(0),
        next(iter(points_done(run, 1))),
        next(iter(samples(run, 1))),
        OperatorAsked(prompt="Engage the brake."),
        OperatorAnswered(answer="yes", by="procedure"),
        LockChecked(
            locked=True, confidence=0.999, moved_rad=0.001, moved_std_rad=0.0005, twist_rad=0.002, summary="ok"
        ),
        ResistanceEstimated(estimate=_resistance()),
        MapEstimated(estimate=_map()),
        Compared(report=_comparison()),
        _diagnosis_step(),
        Diagnosed(round=0, report=_diagnosis(), words=_WORDS),
        LawLearned(
            sentence="A voltage that each leg loses, as a function of its own current.",
            formula="a tanh(i / b)",
            x_label="i [A]",
            y_label="leg voltage [V]",
            x=np.linspace(-1.0, 1.0, 5),
            y=np.linspace(-0.1, 0.1, 5),
            y_std=np.full(5, 0.01),
            y_form=None,
        ),
        ExperimentProposed(
            round=0,
            stage={"kind": "kit_sweep", "duration_s": 2.0},
            separates=("something", "something_else"),
            minutes=0.1,
            accepted=True,
        ),
        StagesAppended(by=4, stages=(StageEntry(kind="kit_sweep", duration_s=2.0),)),
        StageSufficed(index=3, points_spared=4, seconds_spared=2.5),
        Note(level="warning", text="the bus sags by 2 %"),
        _ended(run),
    ]


_WORDS = DiagnosisWords(**dict.fromkeys(DiagnosisWords.model_fields, "in words"))


def _comparison() -> CompareReport:
    return CompareReport(
        recording="kit",
        model="saturated",
        noise_floor=NoiseFloor(rms_v=0.004),
        chi2=12.5,
        stages=(),
        worst=(),
        parity=AxisPercent(d_percent=0.1, q_percent=None),
        reciprocity_percent=0.2,
        crossings=AxisPercent(d_percent=None, q_percent=None),
    )


def _diagnosis() -> DiagnosisReport:
    return DiagnosisReport(
        recording="kit",
        noise_floor=NoiseFloor(rms_v=0.004),
        verdict="explained",
        effects=(),
        traces=(),
        joint=(),
        ladder=(Rung(added=None, chi2=12.5, rms_v=0.05, heldout_rms_v=None, current_rms_a=None),),
        unexplained=Unexplained(fraction=0.0, shape=()),
        next_experiment=None,
        seconds=1.5,
    )


def _diagnosis_step() -> DiagnosisStep:
    n = 8
    current = np.stack([np.linspace(-1.0, 1.0, n), np.zeros(n)], axis=1)
    phases = current @ np.array([[1.0, -0.5, -0.5], [0.0, 0.866, -0.866]])
    return DiagnosisStep(
        index=0,
        added=None,
        effects=(),
        chi2=12.5,
        rms_v=0.05,
        heldout_rms_v=None,
        current_rms_a=None,
        noise_rms_v=0.004,
        stage=("resistance",) * n,
        time_s=np.arange(float(n)),
        i_dq=current,
        residual_dq_v=0.05 * np.sign(current),
        noise_v=np.full(n, 0.004),
        i_abc=phases,
        residual_abc_v=0.05 * np.sign(phases),
    )


def samples(run: Path, count: int) -> Iterator[Message]:
    """Blocks of half a second, each in arrays of its own."""
    t = np.arange(5000) / SAMPLING_FREQUENCY_HZ
    for k in range(count):
        wave = np.stack([np.cos(2 * np.pi * t), np.sin(2 * np.pi * t)], axis=1)
        capture = Capture(
            start_s=0.5 * k,
            sampling_frequency_hz=SAMPLING_FREQUENCY_HZ,
            i_ab=wave,
            v_ab=4.0 * wave,
            v_dc=np.full(len(t), 540.0),
        )
        yield SamplesCaptured(segment=f"injection-{k:03d}", rotor_angle_rad=0.0, capture=capture)


def points_done(run: Path, count: int) -> Iterator[Message]:
    """Points, one after the other."""
    for k in range(count):
        segment = Segment(id=f"injection-{k:03d}", stage=SegmentStage.INJECTION, start_s=0.5 * k, samples=5000)
        yield PointDone(
            id=segment.id,
            stage_index=0,
            segment=segment,
            achieved_d_a=0.98,
            achieved_q_a=-0.51,
            points_done=min(k + 1, POINTS),
            points=POINTS,
            seconds_left=max(0.0, 0.5 * (POINTS - k - 1)),
        )


def _started(run: Path) -> RunStarted:
    return RunStarted(
        run=str(run),
        name="kit",
        motor=MOTOR,
        limits=Limits(current_a=3.5, voltage_v=200.0),
        drive="kit",
        stages=1,
        points=POINTS,
        points_done=0,
        seconds=0.5 * POINTS,
    )


def _point_started(k: int) -> PointStarted:
    return PointStarted(id=f"injection-{k:03d}", stage_index=0, target_d_a=1.0, target_q_a=-0.5, seconds=0.5)


def _ended(run: Path) -> RunEnded:
    estimates = EstimationReport(
        resistance=None,
        method="injection",
        crossings=None,
        parity=None,
        reciprocity_percent=None,
        classical_against_injection_percent=None,
        usable=True,
    )
    return RunEnded(outcome="finished", reason="all stages are done", run=str(run), estimates=estimates)


def _resistance() -> ResistanceEstimate:
    readings = tuple(ResistanceReading(start_s=float(k), value_ohm=4.3 + 0.01 * k, std_ohm=0.005) for k in range(3))
    return ResistanceEstimate(value_ohm=4.31, low=4.30, high=4.32, first_ohm=4.30, last_ohm=4.32, readings=readings)


def _map() -> FluxMapEstimate:
    axis = np.linspace(-3.0, 3.0, 7)
    i_d, i_q = np.meshgrid(axis, axis, indexing="ij")
    grids = {
        "psi_d": 0.3 + 0.043 * i_d - 0.001 * i_d**2,
        "psi_q": 0.069 * i_q - 0.001 * i_q**3,
        "l_dd": 0.043 - 0.002 * i_d,
        "l_dq": -0.001 * i_q,
        "l_qq": 0.069 - 0.003 * i_q**2,
    }
    stds = {f"{name}_std": np.full_like(grid, 1e-4) for name, grid in grids.items()}
    points = FluxPoints(i_dq=np.array([[1.0, 0.0]]), psi_dq=np.array([[0.34, 0.0]]), segment=("injection-000",))
    checks = MapChecks(crossings=AxisPercent(d_percent=0.4, q_percent=0.9), reciprocity_percent=0.5)
    return FluxMapEstimate(
        map=FluxMap(method="injection", i_d=axis, i_q=axis, **grids, **stds), points=points, checks=checks
    )
