"""Sound nameplates of very different machines, from 55 W to 55 kW."""

from __future__ import annotations

from pathlib import Path

from orchestrator.config import load_motor, load_procedure
from protocols import Motor

PAGES = Path(__file__).parents[3] / "docs" / "motors"
_FIELDS = (
    *("pole_pairs", "rated_power_w", "rated_voltage_rms_v", "rated_current_rms_a", "rated_frequency_hz"),
    *("rated_torque_nm", "stator_resistance_ohm", "d_inductance_h", "q_inductance_h", "pm_flux_wb"),
)


def _motor(name: str, *values: float) -> Motor:
    given = dict(zip(_FIELDS, values, strict=True))
    given["rated_speed_rpm"] = 60.0 * given["rated_frequency_hz"] / given["pole_pairs"]
    return Motor.model_validate({"name": name, **given})


SIX = {
    "coreless 55 W": _motor("coreless", 1, 55, 18.7, 2.3, 133.3, 0.066, 0.6, 65e-6, 65e-6, 0.0138),
    "servo 250 W": load_motor(PAGES / "servo-48v.yaml"),
    "demo 400 W": load_procedure("demo").motor,
    # motulator's example of a 2.2-kW machine (Aalto University, MIT).
    "surface 2.2 kW": _motor("2.2 kW", 3, 2.2e3, 370, 4.3, 75, 14, 3.6, 0.036, 0.051, 0.545),
    "interior 28 kW": load_motor(PAGES / "interior-magnet-28kw.yaml"),
    "interior 55 kW": _motor("55 kW", 4, 55e3, 320, 125, 200, 175, 0.018, 0.35e-3, 0.95e-3, 0.16),
}
SOUND = {
    **SIX,
    # Baldor ECS101M0H7EF4, as in motulator: a reluctance machine with magnets.
    "reluctance 5.5 kW": _motor("PM-SyRM", 2, 5.5e3, 370, 8.8, 60, 29.7, 0.63, 0.018, 0.11, 0.47),
    "outrunner 350 W": _motor("hub", 15, 350, 24, 11, 150, 5.6, 0.21, 300e-6, 330e-6, 0.0158),
}
