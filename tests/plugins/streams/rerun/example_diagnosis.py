"""A diagnosis as messages, made up: a dead time, a heating winding and a tilted frame, taken out one after another."""

from __future__ import annotations

import numpy as np

from protocols import (
    Compared,
    CurrentExcerpt,
    Diagnosed,
    DiagnosisStep,
    DiagnosisWords,
    ExperimentProposed,
    FluxLoop,
    Message,
    RealArray,
    ResistanceCourse,
)
from tests.plugins.streams.report.example_diagnosis import a_comparison
from tests.plugins.streams.report.example_diagnosis import a_diagnosis as reported

EFFECTS = ("dead_time", "winding_heating", "rotor_misalignment")
NOISE_V = 0.004
WINDOWS = 1500
TO_ABC = np.array([[1.0, 0.0], [-0.5, np.sqrt(0.75)], [-0.5, -np.sqrt(0.75)]])


def a_diagnosis(pictures: bool = True) -> list[Message]:
    """The comparison, one step for the bare model and one for each effect, the verdict, and what to measure next."""
    steps: list[Message] = [a_step(k, pictures) for k in range(len(EFFECTS) + 1)]
    effects = [{"name": n, "parameters": {}, "twins": [], "relative_size": 1.0, "log_evidence": 1.0} for n in EFFECTS]
    return [
        Compared(report=a_comparison()),
        *steps,
        Diagnosed(round=0, report=reported(effects=effects), words=WORDS),
        a_proposal(),
    ]


WORDS = DiagnosisWords(
    where_it_fails="At every operating point, most near zero current: 1.9 V rms against 4 mV of noise.",
    what_it_looks_like="Odd in the phase currents, as an inverter's errors are.",
    likely_cause="Dead time, 8.0 V (95 %: 7.9 to 8.1 V); device drop is indistinguishable from it here.",
    if_added="The held-out error falls from 1.9 V to 4.2 mV; the noise floor is 4 mV.",
    to_decide="Hold direct currents at two PWM frequencies: 0.4 min.",
)


def a_proposal() -> ExperimentProposed:
    stage = {"kind": "resistance", "pwm_frequencies_hz": [5000.0, 10000.0], "duration_s": 0.5}
    return ExperimentProposed(round=0, stage=stage, separates=("dead_time", "device_drop"), minutes=0.4, accepted=False)


def a_step(index: int, pictures: bool = True) -> DiagnosisStep:
    """The model with the first `index` effects added."""
    noise = np.random.default_rng(7)
    i_dq = noise.uniform(-3.0, 3.0, (WINDOWS, 2))
    i_abc = i_dq @ TO_ABC.T
    heat = np.linspace(0.0, 1.0, WINDOWS)
    parts = (
        1.9 * np.tanh(i_abc / 0.1) @ TO_ABC * (2.0 / 3.0),
        0.12 * heat[:, None] * i_dq,
        0.03 * i_dq[:, ::-1] * np.array([-1.0, 1.0]),
    )
    left = NOISE_V * noise.standard_normal((WINDOWS, 2)) + sum(parts[index:], np.zeros((WINDOWS, 2)))
    rms = float(np.sqrt(np.square(left).sum(axis=1).mean()))
    return DiagnosisStep(
        index=index,
        added=EFFECTS[index - 1] if index else None,
        effects=EFFECTS[:index],
        chi2=(rms / NOISE_V) ** 2,
        rms_v=rms,
        heldout_rms_v=1.08 * rms,
        current_rms_a=rms / 40.0,
        noise_rms_v=NOISE_V,
        stage=("injection",) * WINDOWS,
        time_s=np.linspace(0.0, 60.0, WINDOWS),
        i_dq=i_dq,
        residual_dq_v=left,
        noise_v=np.full(WINDOWS, NOISE_V),
        i_abc=i_abc,
        residual_abc_v=left @ TO_ABC.T,
        excerpts=tuple(_excerpt(k, rms) for k in range(4)) if pictures else (),
        loops=tuple(_loop(axis, rms) for axis in ("d", "q")) if pictures else (),
        resistance=_course(index) if pictures else None,
    )


def _excerpt(number: int, rms: float) -> CurrentExcerpt:
    t = np.linspace(0.0, 8e-3, 80)
    ripple = 0.4 * (2.0 * np.abs(2.0 * ((500.0 * t) % 1.0) - 1.0) - 1.0)
    measured = np.stack([1.45 + ripple, 0.5 * ripple], axis=1)
    return CurrentExcerpt(
        segment=f"injection-{number:03d}",
        stage="injection",
        i_d_a=1.45,
        i_q_a=0.0,
        amplitude_v=40.0,
        time_s=t,
        measured_a=measured,
        predicted_a=measured * (1.0 - 0.2 * rms),
    )


def _loop(axis: str, rms: float) -> FluxLoop:
    turn = np.linspace(0.0, 2.0 * np.pi, 200)
    swept = 3.0 * np.sin(turn)
    i_dq, model = np.zeros((200, 2)), np.zeros((200, 2))
    column = "dq".index(axis)
    i_dq[:, column] = swept
    model[:, column] = 0.06 * np.tanh(swept / 2.0) * 2.0
    measured: RealArray = model + 0.02 * rms * np.cos(turn)[:, None]
    return FluxLoop(
        segment=f"classical-{axis}",
        swept_axis="d" if axis == "d" else "q",
        i_dq=i_dq,
        psi_measured=measured,
        psi_model=model,
    )


def _course(index: int) -> ResistanceCourse:
    t = np.linspace(0.0, 60.0, 20)
    measured = 4.25 + 0.12 * t / 60.0
    return ResistanceCourse(
        time_s=t, heat_j=30.0 * t, measured_ohm=measured, model_ohm=measured if index >= 2 else np.full(20, 4.3)
    )
