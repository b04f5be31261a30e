"""What the figures of a tuning rest on, a sentence each, the same on the console and in the files."""

from __future__ import annotations

from orchestrator.formatting.quantities import number, quantity


def resistance_basis(r_s_ohm: float, at_c: float, is_assumed: bool) -> str:
    """R_s and the temperature of the winding at which it holds."""
    source = " (assumed: `run --ambient` states it)" if is_assumed else ""
    return f"{quantity(r_s_ohm, 'Ω', 4)} a phase with the winding at {number(at_c)} °C{source}"


def magnet_basis(magnet_wb: float) -> str:
    """A magnet's flux that the nameplate has, and what depends on it."""
    return f"{quantity(magnet_wb, 'Wb')}, copied from the nameplate, not from a measurement; torque and MTPA rest on it"


def loss_basis(
    lost_v: float, of_time_v: float, lost_time_s: float | None, pwm_hz: float | None
) -> list[tuple[str, str]]:
    """The part of a leg's loss that a dead-time setting makes up for, and the part that none does; with names.

    Parameters
    ----------
    lost_v, of_time_v : float
        Loss of a leg, and its part in proportion to the bus voltage [V].
    lost_time_s : float or None
        That part over bus voltage and PWM frequency [s].
    pwm_hz : float or None
    """
    if not lost_time_s:
        return [("at any bus voltage", f"all of it: {NO_DEAD_TIME}")]
    time = f"effective dead time {quantity(lost_time_s, 's')} at {quantity(pwm_hz, 'Hz')} PWM"
    rest_v = lost_v - of_time_v
    if abs(rest_v) < NEGLIGIBLE_RATIO * abs(lost_v):
        return [("in proportion to the bus", f"all of it: {time}")]
    return [
        ("in proportion to the bus", f"{quantity(of_time_v, 'V')}: {time}"),
        ("at any bus voltage", f"{quantity(rest_v, 'V')}: {NO_DEAD_TIME}"),
    ]


NO_DEAD_TIME = "this is no dead time, and no dead-time setting makes up for it"
NEGLIGIBLE_RATIO = 0.01
"""Part of the loss below which a part has no line."""


def in_ascii(text: str) -> str:
    """The text for a C source or a settings file."""
    for sign, word in ASCII.items():
        text = text.replace(sign, word)
    return text.encode("ascii", "replace").decode("ascii")


ASCII = {
    "°C": "degC",
    "°": " deg",
    "Ω": "ohm",
    "µ": "u",
    "−": "-",
    "ω": "omega",
    "√": "sqrt ",
    "\u202f": " ",
    "\u00a0": " ",
}
