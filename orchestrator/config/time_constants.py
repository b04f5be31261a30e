"""Says where a winding is too fast for its samples, or where its resistance hides its inductance.

Two numbers decide how well an inductance is known from sampled current. Between two rows a current decays by
exp(-h R / L), and a straight line between them is wrong by x^2 / 3 with x = h R / 2 L. In a ripple of angular frequency
omega, R takes R / (omega L) of what L takes, and a relative error of the voltage, or an error of its phase [rad], comes
back as that many times as large an error of L.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from orchestrator.config import Plan
from protocols import Capabilities, Injection, Manifest, Motor

LINE_ERROR = 0.01
"""Of a straight line between two rows, from which on it is spoken of."""
RESISTANCE_OVER_REACTANCE = 1.0
"""Of a ripple, from which on the voltage's error is larger in the inductance than in the voltage."""


def time_constant_notes(
    motor: Motor, sampling_frequency_hz: float, injection_hz: Iterable[float] = ()
) -> tuple[str, ...]:
    """One line for each of the two that is in the way; none where R or L is not known.

    Parameters
    ----------
    motor : Motor
        Nameplate, or what was found.
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
        tau_s, kept = inductance / ohm, math.exp(-1.0 / rows)
        enough_hz = float(f"{3.0 * sampling_frequency_hz / rows:.3g}")
        notes.append(
            f"L / R is {rows:.2g} of a sample ({tau_s:.2g} s at {sampling_frequency_hz:g} Hz): between rows a current "
            f"decays to {kept:.0%}, so slopes and flux loops tell little of L; sample at {enough_hz:.0f} Hz or more, "
            "or log the control's own rows"
        )
    slowest = min(injection_hz, default=None)
    if slowest:
        ratio = ohm / (2.0 * math.pi * slowest * inductance)
        if ratio > RESISTANCE_OVER_REACTANCE:
            notes.append(
                f"R is {ratio:.2g} times omega L at the injected {slowest:g} Hz: 1 % of the voltage, or of its phase "
                f"in rad, is {ratio:.2g} % of L; inject at up to {0.25 * sampling_frequency_hz:g} Hz"
            )
    return tuple(notes)


def plan_notes(plan: Plan, capabilities: Capabilities) -> tuple[str, ...]:
    """The same of a plan, by its nameplate."""
    injected = {p.excitation.frequency_hz for p in plan.points if isinstance(p.excitation, Injection)}
    return time_constant_notes(plan.procedure.motor, capabilities.sampling_frequency_hz, injected)


def recording_notes(manifest: Manifest) -> tuple[str, ...]:
    """The same of a recording, by its nameplate."""
    frequencies = [segment.settings.get("frequency_hz") for segment in manifest.segments]
    injected = {float(one) for one in frequencies if isinstance(one, int | float) and one > 0.0}
    return time_constant_notes(manifest.motor, manifest.drive.sampling_frequency_hz, injected)
