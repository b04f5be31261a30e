"""Small motors whose nameplate is off, or whose R hides L: estimates are right, and say why the map is not usable."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orchestrator.estimation import estimate_recording
from plugins.estimators.classical import ClassicalEstimator
from plugins.estimators.energy import EnergyEstimator
from plugins.estimators.injection import InjectionEstimator
from plugins.estimators.resistance import ResistanceEstimator
from protocols import CheckOutcome, EstimationReport, Estimator, Procedure
from tests.support.simulated import measure

HUB = {
    "motor": {
        "name": "hub motor, R and L at two thirds",
        "pole_pairs": 15,
        "rated_current_rms_a": 10.0,
        "rated_voltage_rms_v": 20.0,
        "stator_resistance_ohm": 0.14,
        "d_inductance_h": 200e-6,
        "q_inductance_h": 220e-6,
        "pm_flux_wb": 0.025,
    },
    "limits": {"current_a": 18.0, "voltage_v": 16.0, "energy_j": 20000.0},
    "bus_v": 36.0,
    "plant": {
        "resistance_ohm": 0.21,
        "magnetics": {"kind": "polynomial", "d_inductance_h": 300e-6, "q_inductance_h": 330e-6, "pm_flux_wb": 0.025},
        "effects": {"dead_time": {"voltage_v": 0.3}},
        "sensors": {"noise_a": 0.05},
    },
}
CORELESS = {
    "motor": {
        "name": "coreless servo, L / R of 62 us",
        "pole_pairs": 2,
        "rated_current_rms_a": 0.68,
        "rated_voltage_rms_v": 25.0,
        "stator_resistance_ohm": 5.85,
        "d_inductance_h": 360e-6,
        "q_inductance_h": 360e-6,
        "pm_flux_wb": 0.0211,
    },
    "limits": {"current_a": 1.6, "voltage_v": 20.0, "energy_j": 3000.0},
    "bus_v": 42.0,
    "plant": {
        "magnetics": {"kind": "polynomial", "d_inductance_h": 360e-6, "q_inductance_h": 360e-6, "pm_flux_wb": 0.0211},
        "sensors": {"noise_a": 0.003},
    },
}


def estimates(bench: dict[str, Any], folder: Path) -> EstimationReport:
    """What the estimators make of holds, sweeps and injection on a simulated drive at 20 kHz."""
    drive = {"dc_bus_voltage_v": bench["bus_v"], "sampling_frequency_hz": 20e3, "plant": bench["plant"]}
    procedure = Procedure.model_validate(
        {
            "format": "fluxbench-procedure",
            "version": 1,
            "name": "bench",
            "motor": bench["motor"],
            "drive": {"name": "simulated", **drive},
            "limits": bench["limits"],
            "stages": [
                {"kind": "resistance"},
                {"kind": "classical", "periods": 1},
                {"kind": "injection", "pattern": "grid", "duration_s": 0.5},
            ],
        }
    )
    estimators: list[Estimator] = [ResistanceEstimator(), ClassicalEstimator(), InjectionEstimator(), EnergyEstimator()]
    return estimate_recording(measure(procedure).recording, estimators, folder)


def at_rest(report: EstimationReport) -> tuple[float, float]:
    """Smallest and largest inductance of the recommended map [H]."""
    assert report.method is not None
    found = report.maps[report.method].inductances
    assert found is not None
    return min(found.l_dd_low_h, found.l_qq_low_h), max(found.l_dd_high_h, found.l_qq_high_h)


def failed(report: EstimationReport) -> dict[str, str]:
    return {check.name: check.remark.text for check in report.checks if check.outcome is CheckOutcome.FAILED}


@pytest.mark.slow
def test_a_nameplate_at_two_thirds_leaves_the_estimates_right_and_the_map_unusable_with_the_reason(
    tmp_path: Path,
) -> None:
    report = estimates(HUB, tmp_path)
    assert report.resistance is not None
    assert report.resistance.value_ohm == pytest.approx(0.21, rel=2e-3)
    assert np.array(at_rest(report)) == pytest.approx([300e-6, 330e-6], rel=0.02)
    assert not report.usable
    assert list(failed(report)) == ["nameplate"]
    assert "0.42 ohm if the readings are right, 0.28 ohm if the nameplate is" in failed(report)["nameplate"]


@pytest.mark.slow
def test_a_resistance_that_hides_the_inductance_leaves_the_classical_map_a_band_that_says_so(tmp_path: Path) -> None:
    report = estimates(CORELESS, tmp_path)
    assert np.array(at_rest(report)) == pytest.approx(360e-6, rel=0.03)
    assert not report.usable
    assert list(failed(report)) == ["methods"]
    assert "within their own 95 % bands" in failed(report)["methods"]
    assert "confirms nothing" in failed(report)["methods"]
