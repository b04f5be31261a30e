"""The page: each figure and table of the paper with its printed numbers beside those of a run."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from orchestrator.recording import replace_file
from plugins.commands.reproduction._figures import draw_all
from plugins.commands.reproduction._material import Material
from protocols import AxisPercent

PAGE_NAME = "README.md"

_CAPTIONS = {
    "trajectories.png": (
        "The current trajectories: on q with i_d held, on d with i_q held, on both axes (the paper's figure 1)."
    ),
    "processing.png": (
        "The classical method's sensitivity (figure 2). Left: ten periods integrated with nothing but R_s i taken out, "
        "8 V of dead time in each phase. Right: with the inverter's share told from the loops taken out, and averaged."
    ),
    "classical.png": "Current-flux relations by the classical method (figure 3).",
    "paths.png": (
        "Currents that were really reached during injection, settled under control and then left open loop (figure 4)."
    ),
    "injection.png": "Current-flux relations by signal injection, at every point (figure 5).",
    "inductances.png": (
        "The inductance matrix over the flux plane (figure 6): L_dd and L_qq even in psi_q, L_dq odd; the saturation, "
        "and the cross-saturation."
    ),
    "comparison.png": (
        "Classical (dashed) and injection (solid), at three currents of the other axis (figure 7). Where one line is "
        "seen, they lie on each other."
    ),
}


def write_page(material: Material, folder: Path) -> Path:
    """Write the page and its figures into a folder; returns the page's path."""
    folder.mkdir(parents=True, exist_ok=True)
    names = draw_all(material, folder)
    page = folder / PAGE_NAME
    replace_file(page, _text(material, names).encode())
    return page


def _text(material: Material, names: tuple[str, ...]) -> str:
    figures = "\n\n".join(f"![{name.removesuffix('.png')}]({name})\n\n*{_CAPTIONS[name]}*" for name in names)
    return f"""# The paper, reproduced

P. Combes, F. Malrait, P. Martin and P. Rouchon, *Obtaining the Current-Flux Relations of the Saturated PMSM by Signal
Injection*: their experiment, setting by setting, on a simulated motor of the same nameplate with the imperfections
that they describe (uncompensated dead time, a winding that warms up) and sensor noise. The simulated motor saturates
as such motors do; it is not theirs, so shapes and checks compare, and single fluxes do not.

Written by `fluxbench reproduce` on {time.strftime("%Y-%m-%d", time.gmtime())} from
{material.samples / 1e6:.1f} million samples.

## The motor

{_motor_table(material)}

## The numbers

{_number_table(material)}

What the paper could not know, the distance of each map from the motor's true one, in per cent of the rated flux
(|psi(rated i_q) - psi(0, 0)| = {1e3 * material.rated_wb:.1f} mWb), over the whole map:

{_truth_table(material)}

## The figures

{figures}
"""


def _motor_table(material: Material) -> str:
    motor = material.motor
    rows = [
        ("rated power", "400 W", _quantity(motor.rated_power_w, "W")),
        ("rated voltage (rms)", "139.3 V", _quantity(motor.rated_voltage_rms_v, "V")),
        ("rated current (rms)", "1.66 A", _quantity(motor.rated_current_rms_a, "A")),
        ("rated frequency", "60 Hz", _quantity(motor.rated_frequency_hz, "Hz")),
        ("rated speed", "1800 rpm", _quantity(motor.rated_speed_rpm, "rpm")),
        ("rated torque", "2.12 Nm", _quantity(motor.rated_torque_nm, "Nm")),
        ("pole pairs", "2", str(motor.pole_pairs)),
        ("R_s", "4.25 ohm", _quantity(motor.stator_resistance_ohm, "ohm")),
        ("L_d", "43.25 mH", _quantity(1e3 * (motor.d_inductance_h or 0.0), "mH")),
        ("L_q", "69.05 mH", _quantity(1e3 * (motor.q_inductance_h or 0.0), "mH")),
    ]
    return _table(("", "paper, table 1", "nameplate of the run"), rows)


def _number_table(material: Material) -> str:
    injection, classical = (material.estimates[name].checks for name in ("injection", "classical"))
    first, last = material.resistance_ohm
    rows = [("R_s over the classical sweep", "4.5 to 5.25 ohm", f"{first:.2f} to {last:.2f} ohm")]
    for axis, printed in (("d", "1.3 %"), ("q", "2.9 %")):
        rows.append((f"psi_{axis} where paths cross, largest difference", printed, _percent(injection.crossings, axis)))
    for axis, word in (("d", "even"), ("q", "odd")):
        ours = f"{_percent(injection.parity, axis)} (classical: {_percent(classical.parity, axis)})"
        rows.append((f"psi_{axis} {word} in i_q, largest departure", '"satisfied"', ours))
    apart = material.difference_percent
    rows.append(("injection against classical", "small differences", "-" if apart is None else f"{apart:.2f} % rms"))
    points = len(material.estimates["injection"].points.i_dq)
    rows.append(("operating points of the injection, 5 s each", "about 0.1 A apart", f"{points}"))
    return _table(("", "paper", "here"), rows)


def _truth_table(material: Material) -> str:
    told = {
        "classical": "integrating the voltage, inverter and R_s(t) told from the loops",
        "injection": "inductances at each point, flux by least squares over all paths",
        "energy": "one energy for fluxes and derivatives: the map that fluxbench recommends",
    }
    rows = []
    for method, what in told.items():
        rms, worst = material.error_percent(method)
        rows.append((method, what, f"{rms:.3f} %", f"{worst:.3f} %"))
    return _table(("map", "how", "rms", "worst"), rows)


def _table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    lines = [head, tuple("---" for _ in head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _percent(figures: AxisPercent | None, axis: str) -> str:
    value = None if figures is None else getattr(figures, f"{axis}_percent")
    return "-" if value is None else f"{value:.2f} %"


def _quantity(value: float | None, unit: str) -> str:
    return "-" if value is None else f"{value:g} {unit}"
