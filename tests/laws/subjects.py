"""What may be learned from: a law of this suite, or a recording of the blind suite with all that names it rightly."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from tests.blind.hidden import Case, draw_case
from tests.laws.hidden import KINDS, draw
from tests.laws.plant import Machine

Name = tuple[str, str, str]
"""Place, quantity and phase."""
RATED_FLUX_WB = 0.3
"""Of this suite's machine, as its nameplate states it."""


@dataclass(frozen=True)
class Subject:
    """A recording to be made, and what is hidden in it.

    Attributes
    ----------
    label : str
        A kind of this suite, or the blind suite's ``class:index``.
    text : str
        What is hidden, as a person reads it.
    names : tuple of (str, str, str)
        Place, quantity and phase, by which a search may name it; none where a law would be wrong.
    record : callable
        Makes the recording in a folder.
    flux : callable
        Flux beyond that at rest [Wb] at (i_d, i_q) [A].
    magnet_wb, rated_wb : float
        Flux at rest by the nameplate, and the flux that errors are relative to.
    without : tuple of str
        Effects left out of the library.
    """

    label: str
    text: str
    names: tuple[Name, ...]
    record: Callable[[Path], object]
    flux: Callable[[float, float], tuple[float, float]]
    magnet_wb: float = RATED_FLUX_WB
    rated_wb: float = RATED_FLUX_WB
    without: tuple[str, ...] = ()


def subject(label: str, seed: int) -> Subject:
    """The subject of a label; it follows from the seed alone."""
    if label in KINDS:
        return _of_law(label, seed)
    kind, index = label.split(":")
    return _of_case(draw_case(kind, int(index), seed))


def _of_law(kind: str, seed: int) -> Subject:
    from tests.laws.bench import record

    hidden, machine = draw(kind, seed)
    constants = ", ".join(f"{c:g}" for c in hidden.constants)
    phase = f" ({hidden.phase})" if hidden.phase else ""
    return Subject(
        kind,
        f"{kind.replace('_', ' ')}: {hidden.formula}{phase}; {constants}",
        hidden.names,
        lambda folder: record(folder, hidden, seed, machine),
        partial(_flux_of_machine, machine),
    )


def _flux_of_machine(machine: Machine, i_d: float, i_q: float) -> tuple[float, float]:
    (psi_d, psi_q), (rest, _) = machine.flux(i_d, i_q), machine.flux(0.0, 0.0)
    return psi_d - rest, psi_q


def _of_case(case: Case) -> Subject:
    from tests.blind.campaign import record

    of = case.foreign or (case.truths[0].name if case.truths else "")
    names = tuple(_names(PLACES.get(of, ()), case))
    machine = case.bench.machine
    return Subject(
        f"{case.kind}:{case.index}",
        case.hidden.replace("_", " "),
        names if case.kind in ("foreign", "foreign_behind", "left_out") else (),
        lambda folder: record(case.bench, case.campaign, folder),
        partial(_flux_of_table, case),
        machine.pm_flux_wb,
        machine.rated_flux_wb,
        case.without,
    )


def _flux_of_table(case: Case, i_d: float, i_q: float) -> tuple[float, float]:
    """Of the part that is even in i_q: what is not belongs to the slots, an effect."""
    table = case.bench.table
    ahead, behind = table.flux(i_d, i_q), table.flux(i_d, -i_q)
    rest, _ = table.flux(0.0, 0.0)
    return 0.5 * (ahead[0] + behind[0]) - rest, 0.5 * (ahead[1] - behind[1])


def _names(places: Sequence[Name], case: Case) -> Iterator[Name]:
    plant = case.bench.plant
    for place, quantity, phase in places:
        if phase == "*":
            # The plant draws which phase has it.
            phase = "a" if plant.extra_a else "b"
        yield place, quantity, phase


_OWN, _SMOOTH, _TIME, _HEAT = "phase_currents", "smooth_currents", "time", "heat"
_LATE: Sequence[Name] = (("reading", "current_slopes", ""), ("leg_voltage", _SMOOTH, ""))
_LOST: Sequence[Name] = (("leg_voltage", _OWN, ""), ("pulse_voltage", _OWN, ""))
_TURNED: Sequence[Name] = (("angle", _TIME, ""), ("angle", _HEAT, ""), ("angle", "current_q", ""))
PLACES: Mapping[str, Sequence[Name]] = {
    "poor_contact": [("leg_voltage", _OWN, "a")],
    "resistance_step": [("resistance", _TIME, "")],
    "drifting_sensor": [("reading", _TIME, "a")],
    "sensor_gain_drift": [("reading_gain", _TIME, "a"), ("reading_by_time", _OWN, "a")],
    "saturating_sensor": [("reading", _OWN, "")],
    "sticky_quantiser": [("reading", _SMOOTH, "")],
    "mains_hum": [("reading", _TIME, phase) for phase in ("", "a", "b")],
    "sensor_crosstalk": [("reading", "next_phase_currents", "a")],
    "unlogged_bus_ripple": [("voltage_gain", _TIME, "")],
    "wandering_clock": [("voltage_gain", _TIME, ""), ("reading_gain", _TIME, "")],
    "coarse_pwm_counter": [("leg_voltage", "phase_voltages", "")],
    "warming_dead_time": [
        ("leg_voltage_by_time", _OWN, ""), ("pulse_voltage_by_time", _OWN, ""), *_LOST,
    ],
    "loose_phase": [("leg_resistance", _TIME, "b")],
    "brake_creep": [("angle", _TIME, "")],
    "brake_slip": [("angle", _TIME, "")],
    "magnetic_viscosity": [("magnetising", "phase_fluxes", "")],
    "dead_time": _LOST,
    "device_drop": _LOST,
    "bus_sag": [("voltage_gain", "power", "")],
    "voltage_delay": _LATE,
    "current_filter": _LATE,
    "current_gain_mismatch": [(p, of, x) for p, of in (("reading", _OWN), ("reading_gain", _TIME)) for x in "ab"],
    "phase_resistance_imbalance": [("leg_voltage", _OWN, "*"), ("leg_resistance", _TIME, "*")],
    "current_offset": [("reading", of, phase) for of in (_OWN, _TIME, "current") for phase in ("", "a", "b")],
    "voltage_bias": [("leg_voltage", of, phase) for of in (_OWN, _TIME) for phase in ("", "a", "b", "c")],
    "current_nonlinearity": [("reading", _OWN, ""), ("reading_gain", "current", "")],
    "winding_heating": [("resistance", _HEAT, ""), ("resistance", _TIME, "")],
    "skin_effect": [("leg_voltage", _SMOOTH, "")],
    "eddy_currents": [("magnetising", "phase_fluxes", "")],
    "hysteresis": [("magnetising", "phase_fluxes", "")],
    "rotor_misalignment": _TURNED,
    "brake_compliance": [("angle", "torque", ""), ("angle", "current_q", "")],
    "magnet_heating": [("magnetising_d", _TIME, ""), ("magnetising_d", _HEAT, "")],
}  # fmt: skip
"""By what a search may name the blind suite's foreign effects, and the library's own where they are left out. No place
has readings that alternate or repeat (``interleaved_adc``, ``lost_samples``), nor a map of slots (``slot_harmonics``).
"""
