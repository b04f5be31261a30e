"""`model.json`: a motor's model, whole, so that it can be evaluated, refitted, exported or simulated from the file.

SI units, peak-valued vectors; docs/model.md says how the spline is evaluated.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from protocols._base import Strict
from protocols._diagnosis_report import Rung
from protocols._motor import Motor, Positive
from protocols._remarks import Number

SPLINE_DEGREE = 5
"""Degree of the co-energy's B-splines: inductances are then three times differentiable."""

MapStep = Literal["saturation", "cross_saturation"]


class Nameplate(Strict):
    """The ladder started from constant inductances; `freed` says how far the map was let go since, in order."""

    kind: Literal["nameplate"] = "nameplate"
    freed: tuple[MapStep, ...] = ()

    @property
    def title(self) -> str:
        return " + ".join(["linear", *self.freed])


class Saturated(Strict):
    """The map is free."""

    kind: Literal["saturated"] = "saturated"

    @property
    def title(self) -> str:
        return "saturated"


class GivenMap(Strict):
    """A given map, kept unchanged: only R_s and effects are fitted."""

    kind: Literal["map"] = "map"
    method: str
    """Name of the map."""

    @property
    def title(self) -> str:
        return f"map:{self.method}"


Baseline = Annotated[Nameplate | Saturated | GivenMap, Field(discriminator="kind")]


class CoEnergySpline(Strict):
    """Co-energy W(i) without the magnet's share: quintic B-splines on uniform knots, even in i_q."""

    d_low_a: float
    d_high_a: float
    q_high_a: Positive
    """The rectangle: d_low_a..d_high_a by -q_high_a..q_high_a; beyond it the flux goes on linearly."""
    d_intervals: Annotated[int, Field(ge=1)]
    q_intervals: Annotated[int, Field(ge=1)]
    coefficients_j: tuple[float, ...]
    """Row by row along i_d; of the mirror images along i_q the first is kept."""
    kink_j: tuple[float, ...] = ()
    """Along i_d, the coefficients of ((2 - |u|)_+^5 - 16 (1 - |u|)_+^5) / 120, u = i_q in intervals: a kink of L_q at
    i_q = 0; none without."""
    measured_hull_a: tuple[tuple[float, float], ...] = ()
    """Corners (i_d, i_q) of what was measured, counterclockwise; elsewhere the map is a continuation."""
    roughness: tuple[tuple[Positive, ...], ...] = ((1.0,),)
    """How much rougher than usual the map was let be when it was fitted: rows along i_d, from i_q = 0 outwards."""

    @field_validator("roughness", mode="before")
    @classmethod
    def _same_everywhere(cls, value: object) -> object:
        return ((value,),) if isinstance(value, int | float) else value

    @model_validator(mode="after")
    def _sizes_agree(self) -> CoEnergySpline:
        if self.d_high_a <= self.d_low_a:
            raise ValueError(f"d_high_a {self.d_high_a:g} is not above d_low_a {self.d_low_a:g}")
        wanted = (self.d_intervals + SPLINE_DEGREE) * ((self.q_intervals + SPLINE_DEGREE + 1) // 2)
        if len(self.coefficients_j) != wanted:
            raise ValueError(f"expected {wanted} coefficients_j, got {len(self.coefficients_j)}")
        if self.kink_j and len(self.kink_j) != self.d_intervals + SPLINE_DEGREE:
            raise ValueError(f"expected {self.d_intervals + SPLINE_DEGREE} or no kink_j, got {len(self.kink_j)}")
        if self.kink_j and (self.q_intervals % 2 or self.q_intervals < 4):
            raise ValueError(f"expected an even number of four or more q_intervals with kink_j, got {self.q_intervals}")
        return self


class ModelParameter(Strict):
    """One parameter of an effect in the model."""

    value: float
    low: Number
    high: Number
    """95 % interval; null where the parameter was not fitted."""
    unit: str
    fitted: bool


class ModelEffect(Strict):
    """An effect in the model, with every one of its parameters."""

    name: str
    parameters: dict[str, ModelParameter]
    twins: tuple[str, ...] = ()
    relative_size: Number
    log_evidence: Number
    helps: bool | None = None
    """Whether it helped when `add` put it in, on stages that were not fitted; null for an effect of the diagnosis."""
    file: str | None = None
    """The Python file that the effect is from, as it was given; None where it is installed."""


class ModelNoise(Strict):
    """Noise beyond that of the readings."""

    offset_scatter_a: Annotated[float, Field(ge=0)] = 0.0
    """Variation of the current readings' zero between segments (rms)."""
    voltage_scatter_v: Annotated[float, Field(ge=0)] = 0.0
    """Independent error of each held voltage per axis (rms), at the drive's own PWM frequency."""

    @model_validator(mode="before")
    @classmethod
    def _without_former_fields(cls, values: object) -> object:
        """Files of earlier versions have two more fields, which are read and not used."""
        former = ("variance_factors", "dithered")
        return {k: v for k, v in values.items() if k not in former} if isinstance(values, dict) else values

    @property
    def scatters(self) -> bool:
        """Whether something differs from segment to segment by chance."""
        return self.offset_scatter_a > 0.0 or self.voltage_scatter_v > 0.0


class TimerPhases(Strict):
    """Phases of a modulator's timer steps at one PWM frequency."""

    pwm_frequency_hz: Positive
    rise: Annotated[float, Field(ge=0, lt=1)]
    fall: Annotated[float, Field(ge=0, lt=1)]
    """Commands of a leg that its rising, and its falling, edge meets exactly: parts of a step above a whole number."""


class ModulatorTimer(Strict):
    """Timer that rounds a modulator's edges, estimated from a recording."""

    step_s: Positive
    """The timer's; it moves a leg's mean voltage by 2 step_s f_pwm V_dc where both edges of a pulse move."""
    centred: bool
    """Whether the legs' commands are centred, half the sum of the largest and the least taken off all three."""
    phases: tuple[TimerPhases, ...]


class MotorModel(Strict):
    """The model of a recording: what `fluxbench diagnose`, `add` and `remove` keep as `model.json`."""

    format: Literal["fluxbench-model"] = "fluxbench-model"
    version: Literal[2] = 2
    recording: str
    """Name of the recording that it was fitted to."""
    motor: Motor
    """The nameplate."""
    baseline: Baseline
    r_s_ohm: float
    """At the start of the experiment."""
    pm_flux_wb: float
    noise: ModelNoise = ModelNoise()
    timer: ModulatorTimer | None = None
    magnetics: CoEnergySpline
    effects: tuple[ModelEffect, ...]
    """Effects in the order in which they were added."""
    ladder: Annotated[tuple[Rung, ...], Field(min_length=1)]
    """The last rung is this model's."""

    @property
    def title(self) -> str:
        """The model in one line: where the ladder started, and what was added."""
        return " + ".join([self.baseline.title, *(e.name for e in self.effects)])
