"""The nameplate's fields say which of the conventions in use is theirs."""

from __future__ import annotations

import pytest

from orchestrator.config import MotorFile
from orchestrator.formatting.options import options_table

TABLE = {line.split("`")[1]: line for line in options_table(MotorFile).splitlines() if "`" in line}


def test_every_field_of_a_motor_file_is_described() -> None:
    assert [name for name, row in TABLE.items() if row.rpartition("|")[0].endswith("| ")] == []
    assert len(TABLE) >= 19


@pytest.mark.parametrize(
    ("field", "words"),
    [
        ("pole_pairs", "half the number of poles"),
        ("rated_power_w", "not kW"),
        ("rated_voltage_rms_v", "Line to line, rms"),
        ("rated_current_rms_a", "rms"),
        ("rated_frequency_hz", "Electrical"),
        ("rated_speed_rpm", "Mechanical"),
        ("stator_resistance_ohm", "phase of the equivalent star"),
        ("d_inductance_h", "not mH"),
        ("q_inductance_h", "not mH"),
        ("pm_flux_wb", "peak"),
    ],
)
def test_a_field_states_its_convention(field: str, words: str) -> None:
    assert words in TABLE[f"motor.{field}"]
