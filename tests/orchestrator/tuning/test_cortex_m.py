from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.orchestrator.tuning.closed_loop import library_of
from tests.orchestrator.tuning.cortex_m import CortexM, EmulatedFunctions
from tests.orchestrator.tuning.functions import Functions, HostFunctions, Words, words
from tests.orchestrator.tuning.int32_functions import Int32Functions
from tests.orchestrator.tuning.tables import Tables, tables_of
from tests.orchestrator.tuning.test_c_code import PLANT

MAX_FLASH_BYTES = 16 * 1024
MAX_INT32_FLASH_BYTES = 24 * 1024
MAX_CYCLES = 1200
"""Of all functions in a period; 7.1 us at 168 MHz."""
MAX_LOOKUP_CYCLES = 600
"""Of a reference, the flux at two currents and the loss of three legs: everything that reads a table in a period."""
MAX_INT32_CYCLES = 14000
"""Of all functions in a period in int32 on a Cortex-M4 without floats: 64-bit products and divisions of the library."""
PERIODS = 300

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def tables() -> Tables:
    return tables_of(PLANT)


@pytest.fixture(scope="module")
def core(tables: Tables, tmp_path_factory: pytest.TempPathFactory) -> CortexM:
    return CortexM("cortex-m4f", tables.files(), tmp_path_factory.mktemp("core"))


def test_code_and_tables_fit_into_16_kb_of_flash(core: CortexM) -> None:
    print(f"{core.flash_bytes} bytes")
    assert core.flash_bytes <= MAX_FLASH_BYTES


@pytest.mark.parametrize("name", ["cortex-m0", "cortex-m3", "cortex-m4"])
def test_the_source_in_int32_fits_into_24_kb_with_the_library_that_it_needs(
    name: str, tables: Tables, tmp_path: Path
) -> None:
    flash_bytes = CortexM(name, tables.int32_files(), tmp_path).flash_bytes
    print(f"{name}: {flash_bytes} bytes")
    assert flash_bytes <= MAX_INT32_FLASH_BYTES


def cycles_of_periods(core: CortexM, drive: Functions) -> tuple[int, int]:
    """Most cycles of all functions in a period, and of those that read tables; prints the longest of each part."""
    rng, state = np.random.default_rng(6), drive.state()
    periods = []
    for _ in range(PERIODS):
        torque, omega, v_dc = rng.uniform(-12.0, 12.0), rng.uniform(-3000.0, 3000.0), rng.uniform(280.0, 320.0)
        i, i_ref, v = rng.uniform(-14.0, 14.0, 2).astype(np.float32), words(2), words(2)

        def spent(name: str, *arguments: float | Words) -> int:
            return core.cycles(lambda: drive.call(name, *arguments))

        readings = spent("corrected_current_a", i, i) + spent("angle_rad", 1.0, omega) + spent("r_s_ohm", 80.0)
        references = spent("current_reference_a", torque, omega, v_dc, PLANT.r_s, i_ref)
        control = spent("current_control_v", state, i_ref, i, omega, v_dc, PLANT.r_s, v)
        control += spent("angle_ahead_rad", 1.0, omega) + spent("add_bias_v", v)
        legs = sum(spent("leg_voltage_v", x, v_dc) for x in (float(i[0]), float(i[1]), -float(i[0] + i[1])))
        flux = sum(spent("psi_wb", *map(float, at), words(2)) for at in (i, i_ref))
        periods.append(
            (readings + references + control + legs, references + flux + legs, references, control, legs, flux)
        )
    whole, lookups, *parts = np.max(periods, axis=0).tolist()
    print(f"period {whole} cycles, its look-ups {lookups}; reference, control, legs, flux (in the control): {parts}")
    return whole, lookups


def test_a_control_period_takes_few_cycles(core: CortexM) -> None:
    whole, lookups = cycles_of_periods(core, EmulatedFunctions(core))
    assert lookups <= MAX_LOOKUP_CYCLES
    assert whole <= MAX_CYCLES


def test_a_control_period_in_int32_ends_in_time(tables: Tables, tmp_path: Path) -> None:
    core = CortexM("cortex-m4", tables.int32_files(), tmp_path)
    assert cycles_of_periods(core, Int32Functions(core))[0] <= MAX_INT32_CYCLES


def test_it_answers_as_the_host_does_over_many_periods(core: CortexM, tables: Tables, tmp_path: Path) -> None:
    """The same to float32's rounding: both compute in it, in another order."""
    host, rng = HostFunctions(library_of(tables.files(), tmp_path)), np.random.default_rng(8)
    emulated = EmulatedFunctions(core)
    states = [host.state(), emulated.state()]
    for _ in range(PERIODS):
        i_ref, i = rng.uniform(-14.0, 14.0, (2, 2))
        omega, v_dc = rng.uniform(-3000.0, 3000.0), rng.uniform(280.0, 320.0)
        (report, v), (report_core, v_core) = (
            one.control(state, i_ref, i, omega, v_dc) for one, state in zip((host, emulated), states, strict=True)
        )
        assert report == report_core
        assert v_core == pytest.approx(v, abs=1e-3)
        states[1][:6] = states[0][:6]
