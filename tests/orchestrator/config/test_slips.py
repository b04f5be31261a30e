"""The slip that was made is named first, or as one of two, on machines of very different size."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import pytest

from orchestrator.config._nameplate import broken_relations, mismatch, stated_values
from orchestrator.config._slips import SLIPS, Slip, likely_slips, nameplate_doubts, root_two_question
from protocols import Motor
from tests.orchestrator.config.nameplates import SIX

Values = Mapping[str, float]
R, L_D, L_Q, PSI = "stator_resistance_ohm", "d_inductance_h", "q_inductance_h", "pm_flux_wb"
V, I_RMS, P, T = "rated_voltage_rms_v", "rated_current_rms_a", "rated_power_w", "rated_torque_nm"
F, N, PAIRS = "rated_frequency_hz", "rated_speed_rpm", "pole_pairs"


def times(factor: float, *fields: str) -> Callable[[Values], dict[str, float]]:
    return lambda values: {name: factor * values[name] for name in fields}


WRITTEN: dict[str, Callable[[Values], dict[str, float]]] = {
    "inductances in mH": times(1e3, L_D, L_Q),
    "L_d in mH": times(1e3, L_D),
    "L_q in mH": times(1e3, L_Q),
    "inductances in uH": times(1e6, L_D, L_Q),
    "R and L line to line": times(2.0, R, L_D, L_Q),
    "R line to line": times(2.0, R),
    "L line to line": times(2.0, L_D, L_Q),
    "inductances ten times too large": times(10.0, L_D, L_Q),
    "d and q exchanged": lambda v: {L_D: v[L_Q], L_Q: v[L_D]},
    "R in milliohm": times(1e3, R),
    "flux in mWb": times(1e3, PSI),
    "flux rms": times(math.sqrt(0.5), PSI),
    "flux of line to line": times(math.sqrt(3.0), PSI),
    "half the flux": times(0.5, PSI),
    "flux peak to peak": times(2.0, PSI),
    "current peak": times(math.sqrt(2.0), I_RMS),
    "current in mA": times(1e3, I_RMS),
    "voltage of a phase": times(1.0 / math.sqrt(3.0), V),
    "voltage peak": times(math.sqrt(2.0), V),
    "power in kW": times(1e-3, P),
    "torque in mNm": times(1e3, T),
    "speed in rad/s": times(math.pi / 30.0, N),
    "mechanical frequency": lambda v: {F: v[F] / v[PAIRS]},
    "poles": times(2.0, PAIRS),
}
TABLE = [(slip, motor) for slip in WRITTEN for motor in SIX]


def wrong(slip: str, motor: str) -> tuple[dict[str, float], dict[str, float]]:
    """The right values and the written ones."""
    right = stated_values(SIX[motor])
    return right, {**right, **WRITTEN[slip](right)}


def is_named(slip: str, motor: str) -> bool:
    right, written = wrong(slip, motor)
    named = [one.applied(written) for one in likely_slips(written)]
    assert len(named) <= 2
    return any(all(math.isclose(one[name], right[name], rel_tol=0.02) for name in right) for one in named)


def shows(slip: str, motor: str) -> bool:
    """Whether the numbers speak against it at all: a relation is broken, or what is written is the less usual one."""
    right, written = wrong(slip, motor)
    rarest = 2.0 * math.log(1.0 / 0.01)
    return written != right and (bool(broken_relations(written)) or mismatch(written) - mismatch(right) > rarest)


def test_of_the_slips_that_show_nine_in_ten_are_named_first_or_second() -> None:
    shown = [pair for pair in TABLE if shows(*pair)]
    missed = [pair for pair in shown if not is_named(*pair)]
    assert len(shown) >= 100
    assert len(missed) <= 0.1 * len(shown), missed


@pytest.mark.parametrize(
    ("slip", "words"),
    [
        ("poles", "the number of poles"),
        ("d and q exchanged", "d and q exchanged"),
    ],
)
def test_an_interior_magnet_machine_of_55_kw_is_reported_its_slip(slip: str, words: str) -> None:
    written = wrong(slip, "interior 55 kW")[1]
    stated = "\n".join(nameplate_doubts(Motor.model_validate({"name": "IPM", **written})))
    assert words in stated
    assert "in mH" not in stated


def test_a_resistance_from_line_to_line_is_requested_where_it_shows() -> None:
    assert is_named("R line to line", "servo 250 W")


def test_of_slips_that_fit_the_likeliest_is_first() -> None:
    written = wrong("flux of line to line", "demo 400 W")[1]
    first, second = likely_slips(written)
    scores = [mismatch(one.applied(written)) - 2.0 * math.log(one.probability) for one in (first, second)]
    assert scores == sorted(scores)


@pytest.mark.parametrize("slip", SLIPS, ids=lambda slip: f"{slip.fields} {slip.words}")
def test_a_slip_changes_its_own_fields_alone(slip: Slip) -> None:
    values = stated_values(SIX["demo 400 W"])
    assert set(slip.corrected(values)) == set(slip.fields)
    assert slip.applied(values) != values


SERVO = Motor(name="servo", pole_pairs=4, rated_current_rms_a=10.0, stator_resistance_ohm=0.2, pm_flux_wb=0.0155)


def test_a_usual_dc_bus_as_rated_voltage_is_questioned_where_nothing_else_judges_it() -> None:
    bus = SERVO.model_copy(update={"rated_voltage_rms_v": 48.0})
    assert any("33.94 V line to line rms" in doubt for doubt in nameplate_doubts(bus))
    assert not any("bus" in doubt for doubt in nameplate_doubts(SERVO.model_copy(update={"rated_voltage_rms_v": 32.0})))
    with_speed = bus.model_copy(update={"rated_speed_rpm": 4500.0})
    assert not any("usual DC bus" in doubt for doubt in nameplate_doubts(with_speed))


def test_poles_for_pole_pairs_are_asked_about_before_the_flux() -> None:
    values = {"rated_voltage_rms_v": 32.0, "rated_speed_rpm": 1000.0, "rated_torque_nm": 4.8}
    poles = SERVO.model_copy(update={**values, "pole_pairs": 40, "rated_current_rms_a": 15.0, "pm_flux_wb": 0.0085})
    asked = [doubt for doubt in nameplate_doubts(poles) if "would fit" in doubt]
    assert asked[0] == "motor.pole_pairs: 20 would fit: is the stated value the number of poles?"


AX_400 = {
    "name": "servo", "pole_pairs": 5, "rated_power_w": 400.0, "rated_speed_rpm": 3000.0, "rated_torque_nm": 1.27,
    "rated_current_rms_a": 9.6, "rated_voltage_rms_v": 27.0, "stator_resistance_ohm": 0.09, "d_inductance_h": 2e-4,
    "q_inductance_h": 2e-4, "pm_flux_wb": 0.01248,
}  # fmt: skip


def test_a_peak_current_that_agrees_with_flux_and_torque_after_a_division_by_root_two_is_asked_about() -> None:
    (question,) = root_two_question(Motor.model_validate({**AX_400, "rated_current_rms_a": 13.6}))
    assert question.startswith("motor.rated_current_rms_a: 9.617 would fit: is the stated value the peak")
    assert "make 1.8 Nm, 1.42 times rated_torque_nm" in question
    for current_a in (9.6, 12.0, 15.0):
        assert list(root_two_question(Motor.model_validate({**AX_400, "rated_current_rms_a": current_a}))) == []


def test_a_flux_that_is_a_root_of_two_too_large_is_asked_about_beside_the_current() -> None:
    values = {**AX_400, "pm_flux_wb": math.sqrt(2.0) * AX_400["pm_flux_wb"]}  # type: ignore[operator]
    (question,) = root_two_question(Motor.model_validate(values))
    assert (
        "motor.pm_flux_wb: 0.01248 would fit: is the stated value of a torque constant in Nm per ampere rms" in question
    )
    assert "motor.rated_current_rms_a: 6.788 would fit" in question


@pytest.mark.parametrize("motor", SIX.values(), ids=list(SIX))
def test_no_right_nameplate_is_asked_about_a_root_of_two(motor: Motor) -> None:
    assert list(root_two_question(motor)) == []
