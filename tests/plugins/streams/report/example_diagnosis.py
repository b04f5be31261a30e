"""A diagnosis as a recording with dead time has it, made of formulas, for the tests of pictures and texts."""

from __future__ import annotations

from typing import Any

import numpy as np

from protocols import (
    AxisPercent,
    CompareReport,
    CurrentExcerpt,
    DiagnosisReport,
    DiagnosisStep,
    DiagnosisWords,
    FluxLoop,
    NoiseFloor,
    ResistanceCourse,
    StageError,
    WorstSegment,
)

STEP_V = 0.4
NOISE_V = 0.004
PHASES = np.array([[1.0, 0.0], [-0.5, np.sqrt(0.75)], [-0.5, -np.sqrt(0.75)]])


def a_diagnosis(**changes: Any) -> DiagnosisReport:
    """Explained by dead time, which a device drop may stand for."""
    report: dict[str, Any] = {
        "recording": "example",
        "noise_floor": {"rms_v": NOISE_V},
        "verdict": "explained",
        "effects": [
            {
                "name": "dead_time",
                "parameters": {
                    "voltage_v": {"value": 0.4, "low": 0.399, "high": 0.401, "unit": "V"},
                    "sharpness": {"value": -1.5e7, "low": None, "high": None, "unit": "1"},
                },
                "twins": ["device_drop"],
                "relative_size": 0.05,
                "typical": {"value": 8.0, "low": None, "high": None, "unit": "V"},
                "log_evidence": 5e5,
            }
        ],
        "traces": ["skin_effect"],
        "joint": [
            {"name": "dead_time", "relative_size": 0.05, "z": 9766.0},
            {"name": "bus_sag", "relative_size": 0.01, "z": -5.1},
            {"name": "hysteresis", "relative_size": 0.4, "z": 0.5},
        ],
        "ladder": [
            {"added": None, "chi2": 5489.0, "rms_v": 0.3, "heldout_rms_v": 0.35, "current_rms_a": 0.06},
            {"added": "dead_time", "chi2": 1.02, "rms_v": 0.0041, "heldout_rms_v": 0.0042, "current_rms_a": 0.005},
        ],
        "unexplained": {"fraction": 0.0014, "shape": [{"group": "odd_phase_current", "share": 0.98}]},
        "next_experiment": {
            "stage": {"kind": "resistance", "points_a": [[0.1, 0.0], [-0.1, 0.0]], "pwm_frequencies_hz": [1e4, 2e4]},
            "separates": ["dead_time", "device_drop"],
            "minutes": 0.27,
        },
        "notes": ["no gates-off reading: -3 +- 2 mV"],
        "seconds": 3.0,
    }
    return DiagnosisReport.model_validate(report | changes)


def a_comparison() -> CompareReport:
    """The bare model, which misses the dead time."""
    return CompareReport(
        recording="example",
        model="saturated",
        noise_floor=NoiseFloor(rms_v=0.00345),
        rms_v=1.73,
        chi2=5.489e4,
        stages=(
            StageError(stage="resistance", rms_v=2.1, chi2=9e4, current_rms_a=None),
            StageError(stage="injection", rms_v=1.7, chi2=4e4, current_rms_a=0.06),
        ),
        worst=(WorstSegment(segment="resistance-022", i_d_a=0.1, i_q_a=0.0, rms_v=1.48, noise_rms_v=0.00044),),
        parity=AxisPercent(d_percent=0.1, q_percent=0.2),
        reciprocity_percent=0.3,
        crossings=AxisPercent(d_percent=None, q_percent=None),
    )


WORDS = DiagnosisWords(
    where_it_fails="worst in resistance-002: 1.48e+03 mV rms",
    what_it_looks_like="An odd step in each phase current.",
    likely_cause="dead time (voltage_v 0.4 V, 95 % -0.399..0.401)",
    if_added="held-out error 350 -> 4.2 mV; R_s 4.6 -> 4.31 ohm",
    to_decide="resistance stage of 0.27 min",
)


def inverter_residual(i_abc: np.ndarray, step_v: float = STEP_V) -> np.ndarray:
    """The residual that an odd step in each phase current leaves, its zero sequence hidden."""
    errors = step_v * np.tanh(i_abc / 0.05)
    return np.asarray(errors - errors.mean(axis=1, keepdims=True))


def some_steps() -> tuple[DiagnosisStep, ...]:
    """The ladder's two rungs: the step in each phase, and noise alone."""
    return _step(0, None, STEP_V), _step(1, "dead_time", 0.0)


def _step(index: int, added: str | None, step_v: float) -> DiagnosisStep:
    rng = np.random.default_rng(7)
    n = 600
    i_dq = rng.uniform(-3.0, 3.0, (n, 2))
    i_abc = i_dq @ PHASES.T
    noise = rng.normal(0.0, NOISE_V, (n, 2))
    residual_abc = inverter_residual(i_abc, step_v) + noise @ PHASES.T
    return DiagnosisStep(
        index=index,
        added=added,
        effects=() if added is None else (added,),
        chi2=5489.0 if added is None else 1.02,
        rms_v=0.3 if added is None else 0.0041,
        heldout_rms_v=0.35 if added is None else 0.0042,
        current_rms_a=0.06,
        noise_rms_v=NOISE_V,
        stage=("gates_off",) * 5 + ("classical",) * (n - 5),
        time_s=np.arange(n) * 0.1,
        i_dq=i_dq,
        residual_dq_v=2.0 / 3.0 * residual_abc @ PHASES,
        noise_v=np.full(n, NOISE_V),
        i_abc=i_abc,
        residual_abc_v=residual_abc,
        excerpts=(_ripple(20.0, step_v), _ripple(40.0, step_v), _sweep(step_v)),
        loops=(_loop("d", step_v), _loop("q", step_v), _loop("dq", step_v)),
        resistance=_course(step_v),
    )


def _ripple(volts: float, step_v: float) -> CurrentExcerpt:
    time = np.arange(41) * 1e-4
    wave = np.abs((time / 2e-3) % 1.0 - 0.5)[:, None] * np.array([0.05 * volts, 0.0])
    return CurrentExcerpt(
        segment="injection-001",
        stage="injection",
        i_d_a=-0.01,
        i_q_a=0.0,
        amplitude_v=volts,
        time_s=time,
        measured_a=wave,
        predicted_a=(1.0 + 0.1 * step_v) * wave,
    )


def _sweep(step_v: float) -> CurrentExcerpt:
    time = np.linspace(0.0, 2.0, 201)
    wave = np.stack([np.sin(np.pi * time), np.cos(np.pi * time)], axis=1)
    return CurrentExcerpt(
        segment="classical-010",
        stage="classical",
        i_d_a=0.0,
        i_q_a=0.0,
        amplitude_v=None,
        time_s=time,
        measured_a=wave,
        predicted_a=wave + 0.2 * step_v,
    )


def _loop(axis: str, step_v: float) -> FluxLoop:
    angle = np.linspace(0.0, 2.0 * np.pi, 200)
    current = 3.0 * np.stack([np.sin(angle), np.sin(angle)], axis=1)
    psi = 0.05 * current
    return FluxLoop.model_validate(
        {
            "segment": f"classical-{axis}",
            "swept_axis": axis,
            "i_dq": current,
            "psi_measured": psi + 0.01 * step_v * np.cos(angle)[:, None],
            "psi_model": psi,
        }
    )


def _course(step_v: float) -> ResistanceCourse:
    heat = np.linspace(0.0, 3000.0, 12)
    return ResistanceCourse(
        time_s=heat / 30.0, heat_j=heat, measured_ohm=4.3 + step_v / (1.0 + heat / 500.0), model_ohm=np.full(12, 4.3)
    )
