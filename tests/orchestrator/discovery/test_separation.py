"""Two places that a recording does not tell apart are told apart by what differs between them."""

from __future__ import annotations

import pytest

from orchestrator.discovery.report import RankedHypothesis
from orchestrator.discovery.separation import least_alike, separating_measurement


def row(place: str, quantity: str, phase: str = "", kind: str = "odd", share: float = 0.9) -> RankedHypothesis:
    return RankedHypothesis(place=place, quantity=quantity, phase=phase, kind=kind, log_evidence=100.0, share=share)


OF_A = row("leg_voltage", "phase_currents", "a")


@pytest.mark.parametrize(
    ("other", "words"),
    [
        (row("leg_voltage", "phase_currents", "b"), "second angle"),
        (row("pulse_voltage", "phase_currents", "a"), "second PWM frequency"),
        (row("reading", "phase_currents", "a"), "reference ammeter"),
        (row("leg_voltage", "phase_voltages", "a"), "second bus voltage"),
        (row("reading", "current_slopes", "a"), "ripple of a second frequency"),
        (row("resistance", "time"), "anchor: true"),
        (row("leg_voltage_by_heat", "phase_currents"), "warms the winding"),
        (row("angle", "rotor_angle"), "second angle"),
        (row("voltage_gain", "power"), ""),
    ],
)
def test_what_differs_names_the_measurement(other: RankedHypothesis, words: str) -> None:
    measurement = separating_measurement(OF_A, other)
    assert words in measurement
    assert bool(words) == bool(measurement) or other.phase != OF_A.phase


def test_heat_and_time_part_in_a_pause_and_a_lag_and_a_play_at_another_frequency() -> None:
    assert "pause" in separating_measurement(row("resistance", "time"), row("resistance", "heat"))
    lag, play = (row("magnetising", "phase_fluxes", kind=kind) for kind in ("lag", "play"))
    assert "second frequency" in separating_measurement(lag, play)


def test_the_best_rival_that_can_be_told_apart_is_taken_and_a_weak_one_is_not() -> None:
    same, rival = row("leg_voltage", "phase_currents", "a", "even"), row("leg_voltage", "time", "a", share=0.6)
    found = least_alike([OF_A, same, rival], 0.5)
    assert found is not None
    assert found[0] is rival
    assert least_alike([OF_A, same, row("leg_voltage", "time", "a", share=0.2)], 0.5) is None
