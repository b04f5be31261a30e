"""The stage's conformance kit: motors of very different size, no drive. Whether it is worth measuring is not judged."""

from __future__ import annotations

import json
import math
from abc import ABC, abstractmethod
from typing import Any

import pytest
from pydantic import ValidationError

from orchestrator.config import Plan, check_plan, make_plan
from orchestrator.engine import table_of
from orchestrator.registry.plugins import PLUGIN_NAME
from orchestrator.stages import NOMINAL_SAMPLING_HZ
from orchestrator.testing._kit import Kit
from protocols import (
    DriveChoice,
    Limits,
    Procedure,
    ProcedureError,
    ProcedureMotor,
    SegmentStage,
    Stage,
    StageContext,
    StageEntry,
)

MOTORS: dict[str, tuple[dict[str, float], dict[str, float]]] = {
    "400 W": (
        {"rated_current_rms_a": 1.66, "stator_resistance_ohm": 4.25, "d_inductance_h": 0.043, "q_inductance_h": 0.069},
        {"current_a": 5.0, "voltage_v": 150.0},
    ),
    "48 V servo": (
        {"rated_current_rms_a": 7.0, "stator_resistance_ohm": 0.5, "d_inductance_h": 3e-4, "q_inductance_h": 3e-4},
        {"current_a": 21.0, "voltage_v": 24.0},
    ),
    "28 kW": (
        {"rated_current_rms_a": 145.0, "stator_resistance_ohm": 0.03, "d_inductance_h": 4e-4, "q_inductance_h": 1.1e-3},
        {"current_a": 450.0, "voltage_v": 200.0},
    ),
}
"""Nameplate and limits of each."""

every_motor = pytest.mark.parametrize("motor", MOTORS)


class StageConformance(Kit, ABC):
    """Checks that a stage plugin keeps the contract of `protocols.Stage`.

    Subclass it in a test file, in a class whose name begins with ``Test``, and give one method, ``make_stage()``: the
    stage with no more settings than a procedure has to write. What `work` does is for the plugin's own tests.
    """

    @abstractmethod
    def make_stage(self) -> Stage:
        """A stage without its optional settings."""

    def _procedure(self, motor: str, **nameplate: float | None) -> Procedure:
        values, limits = MOTORS[motor]
        return Procedure(
            format="fluxbench-procedure",
            version=1,
            name="kit",
            motor=ProcedureMotor.model_validate({"name": motor, "pole_pairs": 4, **values, **nameplate}),
            drive=DriveChoice(name="kit"),
            limits=Limits.model_validate(limits),
            stages=(self.make_stage().entry(),),
        )

    def _filled(self, motor: str) -> Stage:
        return self.make_stage().filled(StageContext(self._procedure(motor), 0, NOMINAL_SAMPLING_HZ))

    def _plan(self, motor: str) -> Plan:
        if not self.registered:
            pytest.skip("a plan has installed stages only")
        return make_plan(self._procedure(motor), None)

    def test_entry_point_leads_to_the_stage(self) -> None:
        self.require_entry_point("fluxbench.stages", type(self.make_stage()))

    def test_class_keeps_the_contract(self) -> None:
        stage = self.make_stage()
        assert isinstance(stage, Stage), "expected a sub-class of protocols.Stage"
        assert PLUGIN_NAME.match(stage.name), f"{stage.name!r} is no name for a stage"
        assert stage.title.strip(), "title is empty"
        assert "kind" not in type(stage).model_fields, "kind is written in the entry, and is no setting"
        assert (stage.measuring is None) == (stage.records_as is None), "measuring and records_as go together"
        assert stage.records_as is None or isinstance(stage.records_as, SegmentStage)

    def test_states_are_the_stage_s_own(self) -> None:
        stage = self.make_stage()
        for state in (*stage.working, *([stage.measuring] if stage.measuring else [])):
            assert PLUGIN_NAME.match(state.name), f"{state.name!r} is no name for a state"
            assert PLUGIN_NAME.match(state.trigger), f"{state.trigger!r} is no name for a trigger"
        table_of([stage])

    def test_settings_survive_being_written(self) -> None:
        stage = self.make_stage()
        entry = StageEntry.model_validate_json(stage.entry().model_dump_json())
        assert entry.kind == stage.name
        again = type(stage).model_validate_json(json.dumps(entry.settings), strict=True)
        assert again == stage, "settings that are written and read again are others"

    def test_every_setting_is_in_the_schema(self) -> None:
        stage = self.make_stage()
        assert set(type(stage).model_json_schema().get("properties", {})) == set(type(stage).model_fields)

    def test_an_unknown_setting_is_refused(self) -> None:
        settings: dict[str, Any] = self.make_stage().model_dump()
        with pytest.raises(ValidationError):
            type(self.make_stage()).model_validate({**settings, "no_such_setting": 1})

    def test_a_setting_cannot_be_changed(self) -> None:
        stage = self.make_stage()
        for name in type(stage).model_fields:
            with pytest.raises(ValidationError):
                setattr(stage, name, getattr(stage, name))

    def test_plugins_that_it_uses_are_named_in_its_settings(self) -> None:
        stage = self.make_stage()
        for use in stage.uses():
            known = use.field.partition(".")[0] in type(stage).model_fields
            assert use.name is None or known, f"{use.name!r} comes from no setting: {use.field!r}"

    @every_motor
    def test_filling_in_leaves_what_is_written(self, motor: str) -> None:
        written, filled = self.make_stage().model_dump(), self._filled(motor).model_dump()
        changed = [name for name, value in written.items() if value is not None and filled[name] != value]
        assert not changed, f"written settings are changed: {changed}"

    @every_motor
    def test_a_filled_stage_is_not_filled_again(self, motor: str) -> None:
        filled = self._filled(motor)
        assert filled.filled(StageContext(self._procedure(motor), 0, NOMINAL_SAMPLING_HZ)) == filled

    @every_motor
    def test_points_are_there_where_it_measures(self, motor: str) -> None:
        filled = self._filled(motor)
        points = list(filled.points())
        assert bool(points) == (filled.measuring is not None), "points go with a state to measure them in"
        for point in points:
            assert point.excitation.captured_s > 0, "a point that captures nothing"
            assert math.isfinite(point.excitation.longest_current_a), "a current that is not finite"
            json.dumps(dict(point.settings))

    @every_motor
    def test_the_same_stage_has_the_same_points(self, motor: str) -> None:
        assert list(self._filled(motor).points()) == list(self._filled(motor).points())

    @every_motor
    def test_what_it_fills_in_keeps_the_limits(self, motor: str) -> None:
        check_plan(self._plan(motor), None)

    @every_motor
    def test_a_bare_nameplate_is_one_line_or_enough(self, motor: str) -> None:
        bare = self._procedure(motor, **dict.fromkeys(MOTORS[motor][0]))
        try:
            self.make_stage().filled(StageContext(bare, 0, NOMINAL_SAMPLING_HZ))
        except ProcedureError as error:
            refused = error
        else:
            return
        assert refused.field.startswith("motor."), f"the error names no value of the nameplate: {refused}"
        assert "stages.0" in refused.problem, f"the error names no setting: {refused}"
