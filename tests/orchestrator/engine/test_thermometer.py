"""A thermometer beside the drive: its readings are recorded with the currents, where heating effects see them."""

from __future__ import annotations

import os
import pty
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orchestrator.engine import AbsentOperator, Interrupts, RunServices, start_run
from orchestrator.engine._thermometer import open_thermometer
from orchestrator.recording import open_recording
from plugins.drives.simulated import SimulatedDrive
from protocols import InputError, Note, ThermometerChoice
from tests.support.tiny import messages_of, tiny_procedure

STAGES: list[dict[str, Any]] = [
    {"kind": "resistance", "points_a": [[1.0, 0.0], [2.0, 0.0]], "settle_s": 0.1, "duration_s": 0.05}
]


def read_once(line: str, folder: Path, **choice: Any) -> float | None:
    file = folder / "logger.csv"
    file.write_text(line)
    with open_thermometer(ThermometerChoice(file=file, **choice)) as thermometer:
        assert thermometer is not None
        return thermometer.reading_c()


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("time;T1\n2026-01-31 12:00:00;23.5\n", 23.5),
        ("23.5 degC\n24.5 degC\n25", 24.5),
        ("2026-01-31,9999\n", None),
        ("no sensor\n", None),
        ("", None),
    ],
)
def test_a_reading_is_the_last_number_of_the_last_whole_line(text: str, found: float | None, tmp_path: Path) -> None:
    assert read_once(text, tmp_path) == found


def test_a_column_can_be_named_and_an_old_reading_is_none(tmp_path: Path) -> None:
    assert read_once("12:00:01, 21.0, 88.5\n", tmp_path, column=0) == 21.0
    assert read_once("12:00:01, 21.0, 88.5\n", tmp_path, column=5) is None
    with open_thermometer(ThermometerChoice(file=tmp_path / "logger.csv", stale_s=10.0)) as thermometer:
        os.utime(tmp_path / "logger.csv", (time.time() - 60.0,) * 2)
        assert thermometer is not None
        assert thermometer.reading_c() is None


def test_a_serial_line_is_read_without_waiting() -> None:
    logger, line = pty.openpty()
    with open_thermometer(ThermometerChoice(port=os.ttyname(line))) as thermometer:
        assert thermometer is not None
        assert thermometer.reading_c() is None
        os.write(logger, b"T=1 20.5\r\n 21.5\r\n22.")
        deadline = time.monotonic() + 2.0
        while (found := thermometer.reading_c()) is None and time.monotonic() < deadline:
            time.sleep(0.01)
        assert found == 21.5


def test_its_readings_are_in_the_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "logger.csv"
    file.write_text("25.0\n")
    checkpoint = SimulatedDrive.checkpoint

    def warmer_after_a_point(self: SimulatedDrive, point_id: str) -> None:
        file.write_text("25.0\n31.0\n")
        checkpoint(self, point_id)

    monkeypatch.setattr(SimulatedDrive, "checkpoint", warmer_after_a_point)
    procedure = tiny_procedure(tmp_path, stages=STAGES)
    procedure = procedure.model_copy(update={"thermometer": ThermometerChoice(file=file)})
    result = start_run(procedure, tmp_path / "run", RunServices(AbsentOperator(), Interrupts()))
    assert result.outcome.ending == "finished", result.outcome.reason
    recording = open_recording(tmp_path / "run")
    first, second = (recording.load(segment).temperature_c for segment in recording.segments())
    assert first is not None
    assert second is not None
    np.testing.assert_array_equal([first.min(), second.min(), second.max()], [25.0, 31.0, 31.0])


def test_one_that_says_nothing_is_stated_once_and_the_run_goes_on(tmp_path: Path) -> None:
    file = tmp_path / "logger.csv"
    file.write_text("no sensor\n")
    procedure = tiny_procedure(tmp_path, stages=STAGES)
    procedure = procedure.model_copy(update={"thermometer": ThermometerChoice(file=file)})
    result = start_run(procedure, tmp_path / "run", RunServices(AbsentOperator(), Interrupts()))
    assert result.outcome.ending == "finished", result.outcome.reason
    notes = [m.text for m in messages_of(tmp_path / "run") if isinstance(m, Note) and "thermometer" in m.text]
    assert len(notes) == 1


def test_one_that_is_not_there_is_missed_before_anything_is_energised(tmp_path: Path) -> None:
    procedure = tiny_procedure(tmp_path, stages=STAGES)
    procedure = procedure.model_copy(update={"thermometer": ThermometerChoice(file=tmp_path / "none.csv")})
    with pytest.raises(InputError, match=r"none.csv: no such file"):
        start_run(procedure, tmp_path / "run", RunServices(AbsentOperator(), Interrupts()))
    assert not (tmp_path / "run").exists()
