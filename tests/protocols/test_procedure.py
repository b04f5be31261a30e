"""The procedure as a contract: entries that name their stage, strict keys, and the shipped ones."""

from __future__ import annotations

import math
from typing import Any

import pytest
from pydantic import TypeAdapter, ValidationError

from protocols import (
    Excitation,
    Hold,
    JournalledMessage,
    Manifest,
    Motor,
    Note,
    Procedure,
    ProcedureMotor,
    Trapezoid,
    shipped_procedure,
    shipped_procedures,
)


def procedure_fields(*stages: dict[str, Any]) -> dict[str, Any]:
    return {
        "format": "fluxbench-procedure",
        "version": 1,
        "name": "test",
        "motor": {"name": "m", "pole_pairs": 2},
        "drive": {"name": "simulated"},
        "limits": {"current_a": 5.0, "voltage_v": 100.0},
        "stages": list(stages) or [{"kind": "gates_off"}],
    }


def test_an_entry_keeps_what_its_stage_is_to_validate() -> None:
    (entry,) = Procedure.model_validate(procedure_fields({"kind": "thermal_soak", "current_a": 2.0})).stages
    assert (entry.kind, entry.settings) == ("thermal_soak", {"current_a": 2.0})
    assert entry.model_dump() == {"kind": "thermal_soak", "current_a": 2.0}


def test_the_kind_chooses_the_excitation_and_the_message() -> None:
    hold = {"kind": "hold", "current_d_a": 1.0, "current_q_a": 0.0, "settle_s": 0.0, "duration_s": 1.0}
    assert type(TypeAdapter[Any](Excitation).validate_python(hold)) is Hold
    note = {"kind": "note", "level": "info", "text": "x"}
    assert type(TypeAdapter[Any](JournalledMessage).validate_python(note)) is Note


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_number_that_is_not_finite_is_refused(value: float) -> None:
    with pytest.raises(ValidationError, match="finite"):
        Hold(current_d_a=value, current_q_a=0.0, settle_s=0.0, duration_s=1.0)


def test_a_person_may_not_misspell_the_nameplate_but_another_tool_may_add_to_it() -> None:
    fields = {"name": "m", "pole_pairs": 2, "cooling": "water"}
    assert Motor.model_validate(fields).name == "m"
    with pytest.raises(ValidationError, match="cooling"):
        ProcedureMotor.model_validate(fields)


def test_the_rated_current_is_the_length_of_its_vector() -> None:
    assert Motor(name="m", pole_pairs=2, rated_current_rms_a=1.66).rated_current_a == pytest.approx(2.3476, abs=1e-4)


def test_two_segments_may_not_share_an_id() -> None:
    segment = {"id": "a", "stage": "resistance", "start_s": 0.0, "samples": 1}
    fields = {
        "format": "fluxbench-recording",
        "version": 1,
        "name": "x",
        "created": "",
        "motor": {"name": "m", "pole_pairs": 1},
        "drive": {"name": "d", "sampling_frequency_hz": 1.0, "dc_bus_voltage_v": 1.0},
    }
    with pytest.raises(ValidationError, match="twice"):
        Manifest.model_validate({**fields, "segments": [segment, segment]})


@pytest.mark.parametrize("segment_id", ["../x", "a/b", "", ".hidden", "a b"])
def test_a_segment_id_is_no_path(segment_id: str) -> None:
    with pytest.raises(ValidationError, match="pattern"):
        Manifest.model_validate({"segments": [{"id": segment_id, "stage": "resistance", "start_s": 0.0, "samples": 1}]})


def test_a_trapezoid_has_the_defaults_of_the_contract() -> None:
    trapezoid = Trapezoid(swept_axis="dq", amplitude_a=3.0, period_s=2.0, periods=10, settle_s=0.25)
    assert trapezoid.held_a == 0.0
    assert trapezoid.control.bandwidth_hz == 25.0
    assert trapezoid.control.damping == pytest.approx(1 / math.sqrt(2))


def test_the_procedures_that_are_promised_are_shipped() -> None:
    assert set(shipped_procedures()) >= {"demo", "quick", "full", "paper"}
    for name in shipped_procedures():
        assert f"\nname: {name}\n" in shipped_procedure(name)


def test_a_procedure_that_is_not_shipped_is_a_key_error() -> None:
    with pytest.raises(KeyError):
        shipped_procedure("../_motor")
