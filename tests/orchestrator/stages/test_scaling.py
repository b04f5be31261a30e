"""Settings left out follow from nameplate and limits, for a motor of any size."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.config import check_plan, load_procedure, make_plan
from protocols import Capabilities, Procedure, ProcedureError, shipped_procedures
from tests.support.benches import PM400, SERVO, TRACTION, Bench, injections, trapezoids

Stages = Callable[[], list[dict[str, Any]]]


def scaled(procedure: Procedure, factor: float) -> Procedure:
    """The same machine at another scale of current: impedances and limits to fit, voltages as they were."""
    motor, limits = procedure.motor, procedure.limits
    assert motor.rated_current_rms_a
    assert motor.stator_resistance_ohm
    assert motor.d_inductance_h
    assert motor.q_inductance_h
    update = {
        "rated_current_rms_a": motor.rated_current_rms_a * factor,
        "stator_resistance_ohm": motor.stator_resistance_ohm / factor,
        "d_inductance_h": motor.d_inductance_h / factor,
        "q_inductance_h": motor.q_inductance_h / factor,
    }
    return procedure.model_copy(
        update={
            "motor": motor.model_copy(update=update),
            "limits": limits.model_copy(update={"current_a": limits.current_a * factor}),
        }
    )


def test_a_plan_of_everything_fits_limits_and_drive(bench: Bench, every_stage: Stages) -> None:
    procedure, capabilities = bench.procedure(*every_stage()), bench.capabilities()
    plan = make_plan(procedure, capabilities)
    summary = check_plan(plan, capabilities)
    rated = procedure.motor.rated_current_a
    assert rated is not None
    assert rated < summary.peak_current_a <= procedure.limits.current_a
    lock_check = 6 if procedure.motor.d_inductance_h == procedure.motor.q_inductance_h else 5
    assert len(plan.points) == 1 + 1 + lock_check + 18 + 11 + 25


@pytest.mark.parametrize("name", ["demo", "quick"])
@pytest.mark.parametrize("bench", [SERVO, TRACTION], ids=["48 V servo", "28 kW"])
def test_shipped_procedures_serve_other_motors_by_nameplate_and_limits_alone(name: str, bench: Bench) -> None:
    other = bench.procedure({"kind": "gates_off"})
    procedure = load_procedure(name).model_copy(update={"motor": other.motor, "limits": other.limits})
    check_plan(make_plan(procedure, bench.capabilities()), bench.capabilities())


@pytest.mark.parametrize("name", ["demo", "full"])
@pytest.mark.parametrize("of_rated", [0.2, 0.7, 0.72, 1.1])
def test_defaults_never_break_their_own_limits(name: str, of_rated: float) -> None:
    other = TRACTION.procedure({"kind": "gates_off"})
    current = of_rated * math.sqrt(2) * TRACTION.motor["rated_current_rms_a"]
    limits = other.limits.model_copy(update={"current_a": current})
    procedure = load_procedure(name).model_copy(update={"motor": other.motor, "limits": limits})
    check_plan(make_plan(procedure, TRACTION.capabilities()), TRACTION.capabilities())


def test_a_voltage_limit_that_the_resistance_takes_up_says_what_would_do(pm400: Bench) -> None:
    procedure = pm400.procedure({"kind": "injection"}, limits={"current_a": 5.0, "voltage_v": 20.0})
    with pytest.raises(ProcedureError) as caught:
        make_plan(procedure, None)
    assert "4.25 ohm x limits.current_a of 5 A = 21.25 V: raise it to 72 V" in str(caught.value)
    assert "or lower limits.current_a below 4.71 A" in str(caught.value)
    assert make_plan(pm400.procedure({"kind": "injection"}, limits={"current_a": 5.0, "voltage_v": 72.0}), None)


def test_the_400_w_machine_gets_about_the_papers_settings(pm400: Bench, every_stage: Stages) -> None:
    plan = make_plan(pm400.procedure(*every_stage()), pm400.capabilities())
    point = injections(plan)[0]
    assert point.amplitude_v == pytest.approx(40.0, rel=0.05)
    assert point.frequency_hz == 500.0
    assert point.settle_s == pytest.approx(0.25, rel=0.05)
    assert trapezoids(plan)[0].amplitude_a == pytest.approx(3.0, rel=0.05)
    assert trapezoids(plan)[0].control.bandwidth_hz == 25.0


@given(factor=st.floats(0.05, 50.0))
def test_currents_scale_with_the_motor_and_voltages_and_times_stay(factor: float) -> None:
    stages = [{"kind": "lock_check"}, {"kind": "classical"}, {"kind": "injection"}]
    motor = scaled(PM400.procedure(*stages), factor)
    point = injections(make_plan(motor, None), "lock_check")[1]
    rounding = 0.05  # settings have two significant digits
    assert point.target_q_a == pytest.approx(1.25 * 1.66 * math.sqrt(2) * factor, rel=rounding)
    assert point.amplitude_v == pytest.approx(4 * 500.0 * 0.2 * 1.66 * math.sqrt(2) * 0.04325, rel=rounding)
    assert point.settle_s == 0.25


def test_a_stage_without_its_own_control_has_the_procedures(pm400: Bench) -> None:
    procedure = pm400.procedure({"kind": "resistance"}, control={"bandwidth_hz": 60.0})
    assert make_plan(procedure, None).points[0].excitation.control.bandwidth_hz == 60.0


@pytest.mark.parametrize(
    ("field", "stage", "setting"),
    [
        ("rated_current_rms_a", {"kind": "alignment"}, "current_a"),
        ("rated_current_rms_a", {"kind": "classical"}, "amplitude_a"),
        ("rated_current_rms_a", {"kind": "resistance"}, "points_a"),
        ("stator_resistance_ohm", {"kind": "classical"}, "settle_s"),
        ("d_inductance_h", {"kind": "injection"}, "amplitudes_v"),
        ("d_inductance_h", {"kind": "lock_check"}, "amplitude_v"),
    ],
)
def test_a_missing_nameplate_value_names_the_setting_that_would_make_it_unnecessary(
    pm400: Bench, field: str, stage: dict[str, Any], setting: str
) -> None:
    motor = {key: value for key, value in pm400.motor.items() if key != field}
    with pytest.raises(ProcedureError) as caught:
        make_plan(pm400.procedure(stage, motor=motor), None)
    assert str(caught.value).startswith(f"bench: motor.{field}: missing")
    assert f"stages.0.{setting}" in str(caught.value)


def test_a_nameplate_of_nothing_but_a_name_will_do_where_everything_is_given() -> None:
    procedure = load_procedure("paper")
    bare = procedure.motor.model_validate({"name": "unknown", "pole_pairs": 2})
    plan = make_plan(procedure.model_copy(update={"motor": bare}), None)
    assert plan.points == make_plan(procedure, None).points
    summary = check_plan(plan, None)
    assert summary.energy_j is None
    assert summary.peak_voltage_v is None


@pytest.mark.parametrize("name", shipped_procedures())
def test_the_same_procedure_gives_the_same_plan_after_a_round_trip(name: str, pm400: Bench) -> None:
    procedure, drive = load_procedure(name), pm400.capabilities(max_current_a=10.0)
    again = Procedure.model_validate_json(procedure.model_dump_json())
    same_drive = Capabilities.model_validate_json(drive.model_dump_json())
    assert make_plan(again, same_drive) == make_plan(procedure, drive)
