"""The motor in a handful of lines, as an engineer asks for it first: R_s, L_d, L_q, flux, torque, saliency.

Torque is that of the delivered map, T = 3/2 p (psi_d i_q - psi_q i_d), at the best angle of the rated current (MTPA).
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from orchestrator.flux_maps import ROOM_C
from orchestrator.flux_maps.exporting import mtpa, saliency
from orchestrator.formatting.quantities import fixed, number, percent, quantity, vector
from orchestrator.formatting.results import UNCHANGED, resistance, resistance_course
from orchestrator.numerics.tables import cubic_value_at
from plugins.streams.report._collect import Material
from plugins.streams.report._content import Line, inductance_line, motor_of
from protocols import EstimationReport, FluxbenchError, FluxMap, Motor, RealArray, ResistanceEstimate

TORQUE_HEAD = ("torque", "i_d", "i_q", "|i|", "angle from d", "")
RESISTANCE_HEAD = ("R_s", "by", "why it differs from the one above")
SAME_RESISTANCE_RATIO: float = 0.005
"""Change of R_s between two models below which it hides nothing that a picture or a table shows."""
COPPER_COEFFICIENT_PER_K = 0.00393
"""Relative change of copper's resistance a kelvin, at 20 degrees Celsius."""


def motor_lines(material: Material) -> Iterator[Line]:
    """Label and text; nothing of what was not measured."""
    report, motor = material.estimates, motor_of(material)
    if report is not None and report.resistance is not None:
        stated = motor.stator_resistance_ohm if motor is not None else None
        nameplate = "" if stated is None else f"; nameplate {quantity(stated, 'ohm', 4)}"
        yield Line(
            "R_s",
            resistance(report.resistance)
            + (" at 0 s, by the model" if report.resistance.is_of_model else "")
            + nameplate,
        )
        yield Line("R_s at 20 °C", _at_20_c(report.resistance, material))
    shown = material.maps.get(report.method) if report is not None and report.method is not None else None
    if shown is not None and motor is not None:
        yield from _of_map(shown, motor, _magnet_by_emf(report))
    yield from inductance_line(material)


def resistance_rows(material: Material) -> list[tuple[str, str, str]]:
    """The other values of R_s in this directory, each with its source and why it differs; see `RESISTANCE_HEAD`."""
    report, rows = material.estimates, list[tuple[str, str, str]]()
    if report is None or report.resistance is None:
        return rows
    delivered, alone = report.resistance, report.estimators.resistance if report.estimators is not None else None
    read = alone if delivered.is_of_model and alone is not None else delivered
    if (course := resistance_course(read)) != UNCHANGED:
        source = "the model" if read.is_of_model else "the readings at constant current"
        rows.append((course, source, "the winding was as warm as at that time"))
    if delivered.is_of_model and alone is not None:
        whole = "the mean over the run, in which the current warmed the winding"
        rows.append((resistance(alone), "the estimators, all readings together", whole))
    first = material.diagnosis.steps[0].resistance if material.diagnosis and material.diagnosis.steps else None
    if first is not None and len(first.model_ohm):
        bare_ohm = float(first.model_ohm.min())
        if abs(bare_ohm / delivered.value_ohm - 1.0) > SAME_RESISTANCE_RATIO:
            why = "what the missing effects take along the current is counted as resistance"
            rows.append((quantity(bare_ohm, "ohm", 4), "the model before any effect was added", why))
    return rows


def _magnet_by_emf(report: EstimationReport | None) -> tuple[float, float] | None:
    """psi_M and its standard deviation [Wb], where a rotor has turned."""
    for remark in report.remarks if report is not None else ():
        flux, std = remark.values.get("flux_wb"), remark.values.get("std_wb")
        if remark.code == "spin.magnet_flux" and isinstance(flux, float) and isinstance(std, float):
            return flux, std
    return None


def _at_20_c(estimate: ResistanceEstimate, material: Material) -> str:
    """By copper's coefficient, from the model's value before any heat, or else from the first reading."""
    ambient_c = None if material.record is None else material.record.procedure.about.ambient_c
    logged_c = next(iter(material.paths.temperature_c[:, 1]), None)
    if ambient_c is not None:
        start_c, why = ambient_c, f"if the winding was as warm as the room, {ambient_c:g} °C, when the run began"
    elif logged_c is not None:
        start_c, why = float(logged_c), f"by the first logged temperature, {logged_c:.1f} °C"
    else:
        start_c = ROOM_C
        is_import = material.record is None
        how = (
            "`temperature` in the import's mapping names a logged one" if is_import else "`run --ambient 23` stores it"
        )
        why = f"assuming {ROOM_C:g} °C when the run began, as its temperature is not known; {how}"
    start_ohm = estimate.value_ohm if estimate.is_of_model else estimate.first_ohm
    cold = start_ohm / (1.0 + COPPER_COEFFICIENT_PER_K * (start_c - 20.0))
    return f"{quantity(cold, 'ohm', 4)}, {why}"


def _of_map(grid: FluxMap, motor: Motor, magnet: tuple[float, float] | None) -> Iterator[Line]:
    l_d, l_q = (_at(grid, getattr(grid, name), 0.0, 0.0) for name in ("l_dd", "l_qq"))
    if l_d is not None and l_q is not None:
        yield Line("L_dd, L_qq at no current", f"{quantity(l_d, 'H', 4)}, {quantity(l_q, 'H', 4)}, incremental (∂ψ/∂i)")
    if magnet is not None:
        measured = f"{quantity(magnet[0], 'Wb', 4)} ± {quantity(1.96 * magnet[1], 'Wb', 1)} (95 %), by the back-EMF"
        nameplate = "" if motor.pm_flux_wb is None else f"; nameplate {quantity(motor.pm_flux_wb, 'Wb', 4)}"
        yield Line("ψ of the magnet", measured + nameplate)
    elif motor.pm_flux_wb is not None:
        why = "nameplate: a locked rotor does not show it"
        yield Line("ψ of the magnet", f"{quantity(motor.pm_flux_wb, 'Wb', 4)} ({why})")
    rated_a = motor.rated_current_a
    if rated_a is None:
        return
    saturated = [_at(grid, getattr(grid, name), 0.0, rated_a) for name in ("l_dd", "l_qq")]
    if saturated[0] is not None and saturated[1] is not None:
        sizes = ", ".join(quantity(one, "H", 4) for one in saturated)
        yield Line("L_dd, L_qq at rated i_q", f"{sizes}, incremental (∂ψ/∂i)")
    yield from _apparent(grid, rated_a)
    yield from _torque(grid, motor, rated_a)
    ratios = saliency(grid).ratio
    at_rest, loaded = _at(grid, ratios, 0.0, 0.0), _at(grid, ratios, 0.0, rated_a)
    parts = [f"{number(r, 3)} {where}" for r, where in ((at_rest, "at no current"), (loaded, "at rated i_q")) if r]
    if parts:
        yield Line("Saliency", f"{', '.join(parts)} (largest over smallest inductance)")


def _apparent(grid: FluxMap, rated_a: float) -> Iterator[Line]:
    """The chords of the map, as a flux observer and a torque equation with constant inductances use them."""
    parts = []
    for axis, i_dq in (("d", (-rated_a, 0.0)), ("q", (0.0, rated_a))):
        table = getattr(grid, f"psi_{axis}")
        flux, at_rest = _at(grid, table, *i_dq), _at(grid, table, 0.0, 0.0)
        if flux is not None and at_rest is not None:
            current = sum(i_dq)
            parts.append(
                f"L_{axis} {quantity((flux - at_rest) / current, 'H', 4)} at i_{axis} = {quantity(current, 'A')}"
            )
    if parts:
        yield Line("Apparent", f"{', '.join(parts)} ((ψ − ψ(0, 0)) / i)")


def _torque(grid: FluxMap, motor: Motor, rated_a: float) -> Iterator[Line]:
    try:
        best = mtpa(grid, motor.pole_pairs, np.array([rated_a]))
    except FluxbenchError:  # a map without i_q > 0, or of a single line
        return
    torque = float(best.torque_nm[0])
    if motor.pm_flux_wb is None or not math.isfinite(torque):
        return
    where = vector(float(best.i_dq[0, 0]), float(best.i_dq[0, 1]))
    edge = "" if best.interior[0] else "; the best lies at the edge of what was measured"
    stated = "" if motor.rated_torque_nm is None else f"; nameplate {quantity(motor.rated_torque_nm, 'Nm', 3)}"
    magnet_nm = 1.5 * motor.pole_pairs * motor.pm_flux_wb * float(best.i_dq[0, 1])
    rests = f"; {percent(100.0 * magnet_nm / torque, 3)} of it is 3/2 p ψ_M i_q with the nameplate's ψ_M, not measured"
    yield Line("Torque at rated current", f"{quantity(torque, 'Nm', 3)} at {where}{edge}{stated}{rests}")


def torque_rows(grid: FluxMap, motor: Motor) -> list[tuple[str, ...]]:
    """The best currents for round torques up to the greatest that was measured; see `TORQUE_HEAD`.

    None where the magnet's flux is not known, of which most of the torque is. The last column marks what is beyond
    the nameplate's torque or current.
    """
    if motor.pm_flux_wb is None:
        return []
    try:
        best = mtpa(grid, motor.pole_pairs)
    except FluxbenchError:  # a map without i_q > 0, or of a single line
        return []
    known = np.isfinite(best.torque_nm) & best.interior
    torque, i_dq = best.torque_nm[known], best.i_dq[known]
    rising = np.concatenate([[True], np.diff(np.maximum.accumulate(torque)) > 0.0]) if torque.size else known[:0]
    torque, i_dq = torque[rising], i_dq[rising]
    if torque.size < 2 or torque[-1] <= 0.0:
        return []
    rows = []
    step_nm = _round_step(float(torque[-1]))
    for torque_nm in step_nm * np.arange(1, int(torque[-1] / step_nm) + 1):
        d, q = (float(np.interp(torque_nm, torque, i_dq[:, axis])) for axis in (0, 1))
        length, angle = math.hypot(d, q), math.degrees(math.atan2(q, d))
        currents = (f"{fixed(x, 2)} A" for x in (d, q, length))
        beyond = _beyond_rated(motor, float(torque_nm), length)
        rows.append((quantity(torque_nm, "Nm"), *currents, f"{fixed(angle, 1)}°", beyond))
    return rows


def _beyond_rated(motor: Motor, torque_nm: float, current_a: float) -> str:
    if motor.rated_torque_nm is not None and torque_nm > motor.rated_torque_nm:
        return f"beyond the rated torque of {quantity(motor.rated_torque_nm, 'Nm', 3)}"
    if motor.rated_current_a is not None and current_a > motor.rated_current_a:
        return f"beyond the rated current of {quantity(motor.rated_current_a, 'A', 3)}"
    return ""


def _round_step(largest: float) -> float:
    """One, two or five times a power of ten, of which four to ten are in the largest value."""
    power = 10.0 ** math.floor(math.log10(largest / 4.0))
    return max(step * power for step in (1.0, 2.0, 5.0) if step * power <= largest / 4.0)


def _at(grid: FluxMap, values: RealArray, i_d: float, i_q: float) -> float | None:
    return cubic_value_at((grid.i_d, grid.i_q), values, i_d, i_q)
