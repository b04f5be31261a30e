"""The page: the paper's figures and tables, with its printed numbers beside those of a run."""

from __future__ import annotations

import time
from importlib.resources import files
from pathlib import Path

from orchestrator.formatting.names import PAPER_CROSSINGS
from orchestrator.formatting.quantities import UNKNOWN, fixed, number, percent, quantity
from orchestrator.formatting.sentences import markdown_table
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
        "8 V of dead time in each phase. Right: less the inverter's share, estimated from the loops, and averaged."
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


_BESIDE = """Here fluxbench evaluates. What the paper's own formulas make of the same samples, what makes their errors,
and everything in which the two differ is on [a page of its own](literal.md)."""


def write_page(material: Material, folder: Path, *, literal: bool = False) -> Path:
    """Write the page and its figures into a folder; returns the page's path.

    With `literal` it links to the literal page.
    """
    folder.mkdir(parents=True, exist_ok=True)
    names = draw_all(material, folder)
    page = folder / PAGE_NAME
    replace_file(page, _text(material, names, literal).encode())
    return page


def _text(material: Material, names: tuple[str, ...], literal: bool) -> str:
    figures = "\n\n".join(f"![{name.removesuffix('.png')}]({name})\n\n*{_CAPTIONS[name]}*" for name in names)
    values = {
        "day": time.strftime("%Y-%m-%d", time.gmtime()),
        "million_samples": number(material.samples / 1e6, 3),
        "beside": f"{_BESIDE}\n\n" if literal else "",
        "motor": _motor_table(material),
        "numbers": _number_table(material),
        "rated_flux": quantity(material.rated_wb, "Wb", 4),
        "truth": _truth_table(material),
        "figures": figures,
    }
    return (files(__package__) / "page.md").read_text(encoding="utf-8").format(**values)


def _motor_table(material: Material) -> str:
    motor = material.motor
    rows = [
        ("rated power", "400 W", quantity(motor.rated_power_w, "W", 5)),
        ("rated voltage (rms)", "139.3 V", quantity(motor.rated_voltage_rms_v, "V", 5)),
        ("rated current (rms)", "1.66 A", quantity(motor.rated_current_rms_a, "A", 5)),
        ("rated frequency", "60 Hz", quantity(motor.rated_frequency_hz, "Hz", 5)),
        ("rated speed", "1800 rpm", quantity(motor.rated_speed_rpm, "rpm", 5)),
        ("rated torque", "2.12 Nm", quantity(motor.rated_torque_nm, "Nm", 5)),
        ("pole pairs", "2", str(motor.pole_pairs)),
        ("R_s", "4.25 Ω", quantity(motor.stator_resistance_ohm, "ohm", 5)),
        ("L_d", "43.25 mH", quantity(motor.d_inductance_h, "H", 5)),
        ("L_q", "69.05 mH", quantity(motor.q_inductance_h, "H", 5)),
    ]
    return markdown_table(("", "paper, table 1", "nameplate of the run"), rows)


def _number_table(material: Material) -> str:
    injection, classical = (material.estimates[name].checks for name in ("injection", "classical"))
    first, last = material.resistance_ohm
    rows = [("R_s over the classical sweep", "4.5 to 5.25 Ω", f"{fixed(first, 2)} to {fixed(last, 2)} Ω")]
    for axis in "dq":
        printed = percent(getattr(PAPER_CROSSINGS, f"{axis}_percent"))
        rows.append((f"psi_{axis} where paths cross, largest difference", printed, _percent(injection.crossings, axis)))
    for axis, word in (("d", "even"), ("q", "odd")):
        ours = f"{_percent(injection.parity, axis)} (classical: {_percent(classical.parity, axis)})"
        rows.append((f"psi_{axis} {word} in i_q, largest departure", '"satisfied"', ours))
    difference = material.difference_percent
    rows.append(("injection against classical", "small differences", f"{_two_decimals(difference)} rms"))
    points = len(material.estimates["injection"].points.i_dq)
    rows.append(("operating points of the injection, 5 s each", "about 0.1 A apart", f"{points}"))
    return markdown_table(("", "paper", "here"), rows)


def _truth_table(material: Material) -> str:
    methods = {
        "classical": "integrating the voltage, inverter and R_s(t) estimated from the loops",
        "injection": "inductances at each point, flux by least squares over all paths",
        "energy": "one energy for fluxes and derivatives: the map that fluxbench recommends",
    }
    rows = []
    for method, what in methods.items():
        rms, worst = material.error_percent(method)
        rows.append((method, what, f"{fixed(rms, 3)} %", f"{fixed(worst, 3)} %"))
    return markdown_table(("map", "how", "rms", "worst"), rows)


def _percent(figures: AxisPercent | None, axis: str) -> str:
    return _two_decimals(None if figures is None else getattr(figures, f"{axis}_percent"))


def _two_decimals(value: float | None) -> str:
    """A percentage with two decimals, as in the paper."""
    return UNKNOWN if value is None else f"{fixed(value, 2)} %"
