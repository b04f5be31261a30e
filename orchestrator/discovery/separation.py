"""The measurement that separates two hypotheses of a ranking, by what differs between them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from orchestrator.discovery.report import RankedHypothesis

_VARIABLES: Mapping[str, frozenset[str]] = {
    "time": frozenset({"time"}),
    "heat": frozenset({"heat"}),
    "slope": frozenset({"current_slopes", "phase_fluxes"}),
    "voltage": frozenset({"phase_voltages", "voltages_before", "voltage", "link_voltage"}),
    "angle": frozenset({"rotor_angle"}),
}
"""Quantities that an experiment varies together; all others are currents."""
SECOND_ANGLE = "the rotor locked at a second angle, where the phases share the current differently"
SECOND_FREQUENCY = "ripple of a second frequency at the same currents"
_BY_VARIABLES: Mapping[frozenset[str], str] = {
    frozenset({"time", "heat"}): "a pause without current between two equal holds",
    frozenset({"slope", "current"}): SECOND_FREQUENCY,
    frozenset({"voltage", "current"}): f"a second bus voltage, or {SECOND_FREQUENCY}",
    frozenset({"voltage", "slope"}): "the same ripple on a hold of another current",
}
_BY_ONE: Mapping[str, str] = {
    "angle": "the rotor locked at a second angle",
    "time": "the first points once more at the end (`anchor: true`)",
    "heat": "a long hold that warms the winding (`{kind: resistance, duration_s: 60}`)",
}
"""For a pair of which one is of this variable, where `_BY_VARIABLES` has no entry."""
_OF_PULSES = "direct currents at a second PWM frequency"
_OF_READINGS = f"a reference ammeter at one point, or {SECOND_FREQUENCY}"


def least_alike(ranking: Sequence[RankedHypothesis], least_share: float) -> tuple[RankedHypothesis, str] | None:
    """The best hypothesis beside the first that a measurement tells from it, and that measurement.

    Parameters
    ----------
    ranking : sequence of RankedHypothesis
        The best first.
    least_share : float
        Part of the error that a hypothesis has to remove, over the first one's.
    """
    for other in ranking[1:]:
        if other.share >= least_share * ranking[0].share and (text := separating_measurement(ranking[0], other)):
            return other, text
    return None


def separating_measurement(first: RankedHypothesis, second: RankedHypothesis) -> str:
    """The measurement in which two hypotheses differ; empty where none is known."""
    one, other = _variables(first), _variables(second)
    if one != other:
        pair = (one - other) | (other - one)
        if known := _BY_VARIABLES.get(pair):
            return known
        return next((text for variable, text in _BY_ONE.items() if variable in pair), "")
    if first.phase != second.phase:
        return SECOND_ANGLE
    if first.place != second.place:
        places = {first.place.partition("_by_")[0], second.place.partition("_by_")[0]}
        if "pulse_voltage" in places:
            return _OF_PULSES
        return _OF_READINGS if any(place.startswith("reading") for place in places) else ""
    return SECOND_FREQUENCY if {first.kind, second.kind} == {"lag", "play"} else ""


def _variables(one: RankedHypothesis) -> frozenset[str]:
    """What a law depends on, its place's factor included."""
    names = [one.quantity, *one.place.split("_by_")[1:]]
    return frozenset(next((key for key, of in _VARIABLES.items() if name in of), "current") for name in names)
