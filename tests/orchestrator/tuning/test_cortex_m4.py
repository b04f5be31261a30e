from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.orchestrator.tuning.closed_loop import library_of
from tests.orchestrator.tuning.cortex_m4 import CortexM4
from tests.orchestrator.tuning.functions import HostFunctions, words
from tests.orchestrator.tuning.tables import Tables, tables_of
from tests.orchestrator.tuning.test_c_code import PLANT

MAX_FLASH_BYTES = 16 * 1024
MAX_CYCLES = 1250
"""Of all functions in a period; 7.4 us at 168 MHz."""
MAX_LOOKUP_CYCLES = 690
"""Of a reference, the flux at two currents and the loss of three legs: everything that reads a table in a period."""
PERIODS = 300

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def tables() -> Tables:
    return tables_of(PLANT)


@pytest.fixture(scope="module")
def core(tables: Tables, tmp_path_factory: pytest.TempPathFactory) -> CortexM4:
    return CortexM4(tables.files(), tmp_path_factory.mktemp("core"))


def test_code_and_tables_fit_into_16_kb_of_flash(core: CortexM4) -> None:
    print(f"{core.flash_bytes} bytes")
    assert core.flash_bytes <= MAX_FLASH_BYTES


def test_a_control_period_takes_few_cycles(core: CortexM4) -> None:
    rng, state = np.random.default_rng(6), core.state()
    periods = []
    for _ in range(PERIODS):
        torque, omega, v_dc = rng.uniform(-12.0, 12.0), rng.uniform(-3000.0, 3000.0), rng.uniform(280.0, 320.0)
        i, i_ref, v = rng.uniform(-14.0, 14.0, 2).astype(np.float32), words(2), words(2)
        cycles = {
            "readings": core.cycles("corrected_current_a", i, i)
            + core.cycles("angle_rad", 1.0, omega)
            + core.cycles("r_s_ohm", 80.0),
            "references": core.cycles("current_reference_a", torque, omega, v_dc, PLANT.r_s, i_ref),
            "flux": 2 * core.cycles("psi_wb", float(i[0]), float(i[1]), words(2)),
            "control": core.cycles("current_control_v", state, i_ref, i, omega, v_dc, PLANT.r_s, v)
            + core.cycles("angle_ahead_rad", 1.0, omega),
            "bias": core.cycles("add_bias_v", v),
            "legs": sum(core.cycles("leg_voltage_v", x, v_dc) for x in (float(i[0]), float(i[1]), -float(i[0] + i[1]))),
        }
        periods.append(list(cycles.values()))
    longest = dict(zip(cycles, np.max(periods, axis=0).tolist(), strict=True))
    cost = {name: np.array(periods)[:, k] for k, name in enumerate(cycles)}
    lookups = int((cost["references"] + cost["flux"] + cost["legs"]).max())
    total = int((np.sum(periods, axis=1) - cost["flux"]).max())  # which are within the control
    print(f"longest period {total} cycles, its look-ups {lookups}, of each part {longest}")
    assert lookups <= MAX_LOOKUP_CYCLES
    assert total <= MAX_CYCLES


def test_it_answers_as_the_host_does_over_many_periods(core: CortexM4, tables: Tables, tmp_path: Path) -> None:
    """The same to float32's rounding: both compute in it, in another order."""
    host, rng = HostFunctions(library_of(tables.files(), tmp_path)), np.random.default_rng(8)
    states = [host.state(), core.state()]
    for _ in range(PERIODS):
        i_ref, i = rng.uniform(-14.0, 14.0, (2, 2))
        omega, v_dc = rng.uniform(-3000.0, 3000.0), rng.uniform(280.0, 320.0)
        (report, v), (report_core, v_core) = (
            one.control(state, i_ref, i, omega, v_dc) for one, state in zip((host, core), states, strict=True)
        )
        assert report == report_core
        assert v_core == pytest.approx(v, abs=1e-3)
        states[1][:6] = states[0][:6]
