"""Notes where a winding is too fast for its samples, or where its resistance dominates its reactance.

Two numbers limit the accuracy of an inductance from sampled current. Between two rows a current decays by
exp(-h R / L), and linear interpolation has an error of x^2 / 3 with x = h R / 2 L. In a ripple of angular frequency
omega, an error of 1 % in the voltage, or of 0.01 rad in its phase, becomes R / (omega L) % of L.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from orchestrator.config import Plan
from orchestrator.registry.plugins import PluginKind, load_plugin
from protocols import Capabilities, Injection, Manifest, Motor, NoOptions

LINE_ERROR = 0.01
"""Error of linear interpolation between rows above which a note is given."""
ROWS_PER_TIME_CONSTANT = 3.0
"""Rows in L / R with which that error is below 1 %."""
RESISTANCE_OVER_REACTANCE = 1.0
"""R / (omega L) above which the inductance's relative error exceeds the voltage's."""


def time_constant_notes(
    motor: Motor, sampling_frequency_hz: float, injection_hz: Iterable[float] = ()
) -> tuple[str, ...]:
    """A note for too few rows in L / R, and one for R above omega L; none where R or L is not known.

    Parameters
    ----------
    motor : Motor
        Nameplate, or estimates.
    sampling_frequency_hz : float
    injection_hz : iterable of float
        Frequencies of injected voltages.
    """
    known = [h for h in (motor.d_inductance_h, motor.q_inductance_h) if h]
    ohm = motor.stator_resistance_ohm
    if not known or not ohm:
        return ()
    inductance = min(known)
    rows = inductance / ohm * sampling_frequency_hz
    notes = []
    if (0.5 / rows) ** 2 / 3.0 > LINE_ERROR:
        tau_s, remainder = inductance / ohm, math.exp(-1.0 / rows)
        enough_hz = float(f"{ROWS_PER_TIME_CONSTANT * sampling_frequency_hz / rows:.3g}")
        notes.append(
            f"L / R is {rows:.2g} samples ({tau_s:.2g} s at {sampling_frequency_hz:g} Hz): between rows a current "
            f"decays to {remainder:.0%}, so slopes and flux loops hardly show L; sample at {enough_hz:.0f} Hz or more, "
            "or log the control's own rows"
        )
    slowest = min(injection_hz, default=None)
    if slowest:
        ratio = ohm / (2.0 * math.pi * slowest * inductance)
        if ratio > RESISTANCE_OVER_REACTANCE:
            notes.append(
                f"R is {ratio:.2g} times omega L at the injected {slowest:g} Hz: an error of 1 % in the voltage, or of "
                f"0.01 rad in its phase, becomes {ratio:.2g} % of L; "
                f"inject at up to {0.25 * sampling_frequency_hz:g} Hz"
            )
    return tuple(notes)


def plan_notes(plan: Plan, capabilities: Capabilities) -> tuple[str, ...]:
    """The notes on a plan, by its nameplate, each with the setting that remedies it where the procedure has one."""
    motor, sampling_hz = plan.procedure.motor, capabilities.sampling_frequency_hz
    injected = {p.excitation.frequency_hz: p.stage_index for p in plan.points if isinstance(p.excitation, Injection)}
    by_sampling = time_constant_notes(motor, sampling_hz)
    by_injection = time_constant_notes(motor, sampling_hz, injected)[len(by_sampling) :]
    notes = [note + _setting("drive.sampling_frequency_hz", _faster_hz(motor, sampling_hz)) for note in by_sampling]
    drive = load_plugin(PluginKind.DRIVES, plan.procedure.drive.name)
    if "sampling_frequency_hz" not in getattr(drive, "Options", NoOptions).model_fields:
        notes = list(by_sampling)
    for note in by_injection:
        index = injected[min(injected)]
        has_setting = "frequency_hz" in type(plan.stages[index]).model_fields
        notes.append(note + (_setting(f"stages.{index}.frequency_hz", 0.25 * sampling_hz) if has_setting else ""))
    return tuple(notes)


def _setting(field: str, value: float) -> str:
    return f" (`--set {field}={value:g}`)"


def _faster_hz(motor: Motor, sampling_hz: float) -> float:
    """The least multiple of the sampling frequency that is fast enough: what is injected still fits its rows."""
    inductance = min(h for h in (motor.d_inductance_h, motor.q_inductance_h) if h)
    rows = inductance / (motor.stator_resistance_ohm or 1.0) * sampling_hz
    return sampling_hz * math.ceil(ROWS_PER_TIME_CONSTANT / rows)


def recording_notes(manifest: Manifest) -> tuple[str, ...]:
    """The notes on a recording, by its nameplate."""
    frequencies = [segment.settings.get("frequency_hz") for segment in manifest.segments]
    injected = {float(value) for value in frequencies if isinstance(value, int | float) and value > 0.0}
    return time_constant_notes(manifest.motor, manifest.drive.sampling_frequency_hz, injected)
