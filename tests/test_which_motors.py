"""docs/which-motors.md has the limits that the code has."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from orchestrator.config.time_constants import LINE_ERROR
from orchestrator.diagnosis.criteria import Criteria
from orchestrator.diagnosis.judgement import sufficiency
from orchestrator.registry.plugins import PluginKind, installed
from orchestrator.validation.plausibility import MOTOR_RANGES, PLAUSIBLE_BOUNDS, POSSIBLE_BOUNDS
from plugins.stages.lock_check import LockCheckStage
from protocols import MapCriteria

PAGE = (Path(__file__).parents[1] / "docs" / "which-motors.md").read_text(encoding="utf-8")
ROWS = dict(re.findall(r"^\| ([^|]+) \| ([^|]+) \|", PAGE, re.M))
CRITERIA = Criteria()

EXPECTED = {
    "rotation between rests, electrical": [LockCheckStage.model_fields["tolerance_rad"].default],
    "confidence of a lock": [LockCheckStage.least_confidence],
    "L / R": [round(0.5 / (3.0 * LINE_ERROR) ** 0.5, 1)],
    "R_s, half of its 95 % interval": [MapCriteria().resistance_percent],
    "measured bus, of the nominal one": [*PLAUSIBLE_BOUNDS.bus],
    "largest current": [100 * sufficiency.MIN_CURRENT, sufficiency.MIN_CURRENT_SIGMAS],
    "noise, as a voltage, of the excitation": [100 * CRITERIA.verdict.noise_of_excitation],
    "error of the simulated current, of its range": [100 * CRITERIA.verdict.current_error],
    "currents of a log, of the rated one": [*PLAUSIBLE_BOUNDS.rated_currents],
    "operating points for any cause": [
        sufficiency.MIN_OPERATING_POINTS,
        sufficiency.MIN_OPERATING_POINTS // sufficiency.OPERATING_POINTS_PER_SWEEP,
    ],
    "operating points for a safe cause": [CRITERIA.selection.few_views],
    "injection points for held-out data": [CRITERIA.weak_form.held_out_from],
    "half of the map's 95 % band": [CRITERIA.verdict.widest_band_percent],
    "the same, where no effect was found": [100 * CRITERIA.materiality.material_flux],
    "length of a hold": [1e3 * sufficiency.MIN_HOLD_S],
}


@pytest.mark.parametrize("limit", EXPECTED)
def test_a_limit_on_the_page_is_the_code_s(limit: str) -> None:
    numbers = [float(number) for number in re.findall(r"\d+(?:\.\d+)?", ROWS[limit])]
    missing = [value for value in EXPECTED[limit] if not any(abs(value - n) <= 1e-9 * abs(value) for n in numbers)]
    assert missing == [], ROWS[limit]


def test_the_ranges_of_a_nameplate_are_the_code_s() -> None:
    units = {"µ": 1e-6, "n": 1e-9, "m": 1e-3, "k": 1e3, "": 1.0}
    fields = {
        "rated current, rms": "rated_current_rms_a",
        "rated voltage, line to line, rms": "rated_voltage_rms_v",
        "resistance of a phase": "stator_resistance_ohm",
        "inductance of a phase": "d_inductance_h",
        "magnet flux, peak": "pm_flux_wb",
        "pole pairs": "pole_pairs",
    }
    for row, field in fields.items():
        (low, high) = re.findall(rf"^\| {re.escape(row)} \| ([^|]+) \| ([^|]+) \|$", PAGE, re.M)[0]
        stated = []
        for cell in (low, high):
            number, prefix = re.fullmatch(r"([\d.]+)(?: ([µnmk]?)(?:A|V|Ω|H|Wb))?", cell).groups()  # type: ignore[union-attr]
            stated.append(float(number) * units[prefix or ""])
        assert stated == pytest.approx(MOTOR_RANGES[field]), row
    assert f"above {POSSIBLE_BOUNDS.rated_currents[1]:g} nothing is computed" in PAGE


def test_every_drive_is_on_the_page() -> None:
    section = PAGE.partition("## Drives")[2]
    assert [drive.name for drive in installed(PluginKind.DRIVES) if f"`{drive.name}`" not in section] == []
