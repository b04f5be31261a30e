"""A `model.json` as the plant: its map, its R_s and its effects, and nothing that the plant cannot be."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orchestrator.numerics.tensor_spline import EvenSpline
from plugins.drives.simulated import true_flux
from plugins.drives.simulated._derive import derive, read_nameplate
from protocols import InputError
from tests.plugins.drives.simulated.conftest import PM400, options_of
from tests.support.close import assert_close

SPLINE = EvenSpline(-4.0, 3.0, 4.0, (6, 7))


def energy(i_d: np.ndarray, i_q: np.ndarray) -> np.ndarray:
    """A saturating co-energy of the third degree, even in i_q [J]."""
    return np.asarray(0.04 * (i_d**2 / 2 - i_d**3 / 60) + 0.06 * (i_q**2 / 2 - i_q**4 / 600) - 4e-4 * i_d * i_q**2)


def flux(i_dq: np.ndarray) -> np.ndarray:
    """Its gradient, with the magnet's 0.3 Wb."""
    i_d, i_q = i_dq.T
    psi_d = 0.3 + 0.04 * (i_d - i_d**2 / 20) - 4e-4 * i_q**2
    return np.column_stack((psi_d, 0.06 * (i_q - i_q**3 / 150) - 8e-4 * i_d * i_q))


def effect(name: str, **values: float) -> dict[str, Any]:
    parameters = {
        key: {"value": value, "low": None, "high": None, "unit": "1", "fitted": True} for key, value in values.items()
    }
    return {"name": name, "parameters": parameters, "relative_size": 1.0, "log_evidence": 0.0}


def saved(path: Path, *effects: dict[str, Any]) -> Path:
    at = np.stack(np.meshgrid(np.linspace(-4, 3, 40), np.linspace(-4, 4, 40)), axis=-1).reshape(-1, 2)
    coefficients = np.linalg.lstsq(SPLINE.rows(at, 0, 0), energy(*at.T), rcond=None)[0]
    content = {
        "format": "fluxbench-model", "version": 2, "recording": "r", "motor": PM400.model_dump(), "r_s_ohm": 4.4,
        "baseline": {"kind": "saturated"}, "pm_flux_wb": 0.3, "effects": list(effects),
        "magnetics": {"d_low_a": -4.0, "d_high_a": 3.0, "q_high_a": 4.0, "d_intervals": 6, "q_intervals": 7,
                      "coefficients_j": coefficients.tolist(),
                      "measured_hull_a": [[-4.0, -4.0], [3.0, -4.0], [3.0, 4.0], [-4.0, 4.0]]},
        "ladder": [{"added": None, "chi2": 1.0, "rms_v": 0.0, "heldout_rms_v": 0.0, "current_rms_a": 0.0}],
    }  # fmt: skip
    path.write_text(json.dumps(content))
    return path


def test_the_plant_s_map_is_the_model_s(tmp_path: Path) -> None:
    truth = true_flux(options_of(plant={"model": str(saved(tmp_path / "model.json"))}), PM400)
    axis = np.linspace(-2.5, 2.5, 9)
    i_dq = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    assert_close(truth.flux(i_dq), flux(i_dq), 1e-3)


def test_a_kink_of_the_model_s_map_is_the_plant_s(tmp_path: Path) -> None:
    path = saved(tmp_path / "model.json")
    content = json.loads(path.read_text())
    grid, along_d = EvenSpline(-4.0, 3.0, 4.0, (6, 8), kink=True), np.linspace(1.0, 2.0, 11)
    at = np.stack(np.meshgrid(np.linspace(-4, 3, 40), np.linspace(-4, 4, 40)), axis=-1).reshape(-1, 2)
    smooth = np.linalg.lstsq(grid.rows(at, 0, 0), energy(*at.T), rcond=None)[0].reshape(grid.functions)
    smooth[:, -1] += 2e-2 * along_d
    content["magnetics"] |= {
        "q_intervals": 8, "coefficients_j": smooth[:, :-1].ravel().tolist(), "kink_j": smooth[:, -1].tolist()
    }  # fmt: skip
    path.write_text(json.dumps(content))
    truth = true_flux(options_of(plant={"model": str(path)}), PM400)
    axis = np.linspace(-2.5, 2.5, 9)
    i_dq = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    added = grid.rows(i_dq, 0, 1)[:, grid.functions[1] - 1 :: grid.functions[1]] @ (2e-2 * along_d)
    assert float(np.abs(added).max()) > 1e-3
    assert_close(truth.flux(i_dq)[:, 1], flux(i_dq)[:, 1] + added, 3e-3)


def test_resistance_and_effects_are_the_model_s_and_no_others(tmp_path: Path) -> None:
    model = saved(tmp_path / "model.json", effect("dead_time", voltage_v=1.5, threshold_a=0.08, softness=0.2))
    plant = {
        "model": str(model),
        "resistance_ohm": 9.0,
        "magnetics": {"kind": "nameplate"},
        "effects": {"voltage_bias": {"bias_a_v": 0.3}},
    }
    found = derive(options_of(plant=plant), read_nameplate(PM400), 540.0)
    assert found.parameters.resistance_ohm == 4.4
    assert found.parameters.dead_time_v == 1.5
    assert found.parameters.dead_time_per_a == pytest.approx(1 / 0.08)
    assert found.parameters.bias_alpha_v == 0.0
    assert found.options.effects.dead_time is not None


@pytest.mark.parametrize(
    ("found", "message"),
    [
        (effect("leakage", amps=1.0), "leakage: the simulated plant has no effect of that name"),
        (effect("dead_time", voltage_v=-1.5), "dead_time.voltage_v: input should be greater than or equal to 0"),
    ],
)
def test_what_the_plant_cannot_be_is_one_line(found: dict[str, Any], message: str, tmp_path: Path) -> None:
    model = saved(tmp_path / "model.json", found)
    with pytest.raises(InputError, match=message):
        true_flux(options_of(plant={"model": str(model)}), PM400)
