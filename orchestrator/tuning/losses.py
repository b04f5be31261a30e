"""An inverter's loss in words: which part a dead-time setting makes up for."""

from __future__ import annotations

from orchestrator.formatting.quantities import quantity

NO_DEAD_TIME = "this is no dead time, and no dead-time setting makes up for it"
NEGLIGIBLE_RATIO = 0.01
"""Part of the loss below which a part has no line."""


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
