"""Progress of a diagnosis: one step for each added effect, with data for plots."""

from __future__ import annotations

from typing import Annotated, Literal

from protocols._base import ArrayModel, Phases, RealArray, Samples, Shape, Strict, Vectors
from protocols._comparison_report import CompareReport
from protocols._diagnosis_report import DiagnosisReport, DiagnosisWords, NextExperiment

Curve = Annotated[RealArray, Shape(("m",))]


class CurrentExcerpt(ArrayModel):
    """A stretch of one segment, measured and as the model with its effects predicts it; believed dq frame."""

    segment: str
    stage: str
    i_d_a: float
    i_q_a: float
    """Mean current of the stretch."""
    amplitude_v: float | None
    """Amplitude of the injected voltage; None where nothing is injected."""
    time_s: Samples
    """From the start of the stretch, shape (n,)."""
    measured_a: Vectors
    """Shape (n, 2)."""
    predicted_a: Vectors


class FluxLoop(ArrayModel):
    """One period of a classical sweep: flux by integrating the corrected voltage, and by the map."""

    segment: str
    swept_axis: Literal["d", "q", "dq"]
    i_dq: Vectors
    """Shape (n, 2)."""
    psi_measured: Vectors
    """Less its value at the start of the loop [Wb]."""
    psi_model: Vectors
    noise_wb: float | None = None
    """Standard deviation of what the noise of the current readings adds to `psi_measured` in half a period."""


class ResistanceCourse(ArrayModel):
    """R_s over the heat that the winding took up."""

    time_s: Curve
    """Since the start of the experiment, shape (m,)."""
    heat_j: Curve
    measured_ohm: Curve
    """What each dwell asks for beside the rest of the model."""
    model_ohm: Curve


class DiagnosisStep(ArrayModel):
    """One rung of the error ladder: the model after one more effect, and its residual; time first.

    Rows of the residual are windows of the weak form: the mean residual over the window in volts, with the mean
    current in it.
    """

    kind: Literal["diagnosis_step"] = "diagnosis_step"
    index: int
    """0: the model that the ladder starts from."""
    added: str | None
    effects: tuple[str, ...]
    """All that the model holds now."""
    chi2: float
    """Per degree of freedom."""
    rms_v: float
    heldout_rms_v: float | None
    current_rms_a: float | None
    noise_rms_v: float
    stage: tuple[str, ...]
    """Stage of each row, n entries."""
    time_s: Samples
    """Since the start of the experiment, shape (n,)."""
    i_dq: Vectors
    """Believed frame, shape (n, 2)."""
    residual_dq_v: Vectors
    """Voltage of the recording less that of the model, v - (R_s i + d psi/dt) and what the effects add to it."""
    noise_v: Samples
    """Standard deviation that the sensors' noise gives each row, shape (n,)."""
    i_abc: Phases
    """Phase currents of the rows, shape (n, 3)."""
    residual_abc_v: Phases
    """Phase components of the residual, zero sum."""
    pwm_frequency_hz: Samples | None = None
    """Of each row, shape (n,); None in files of older versions."""
    excerpts: tuple[CurrentExcerpt, ...] = ()
    loops: tuple[FluxLoop, ...] = ()
    resistance: ResistanceCourse | None = None


class Compared(Strict):
    """The model compared with the measurements."""

    kind: Literal["compared"] = "compared"
    report: CompareReport


class Diagnosed(Strict):
    """A diagnosis is done."""

    kind: Literal["diagnosed"] = "diagnosed"
    round: int
    """0: with the procedure's measurements; n: after the n-th proposed experiment."""
    report: DiagnosisReport
    words: DiagnosisWords


class LawLearned(ArrayModel):
    """A law that no effect of the library has, over what it depends on."""

    kind: Literal["law_learned"] = "law_learned"
    sentence: str
    formula: str
    x_label: str
    y_label: str
    """With units."""
    x: Curve
    """Shape (m,)."""
    y: Curve
    """The flexible law."""
    y_std: Curve
    y_form: Curve | None
    """By the formula; None of a table."""


class ExperimentProposed(NextExperiment):
    """The experiment that would separate two effects, and whether this run performs it."""

    kind: Literal["experiment_proposed"] = "experiment_proposed"
    round: int
    accepted: bool
