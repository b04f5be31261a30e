"""The unit is taken apart and run by what a simulator uses of it; fmpy judges it whole."""

from __future__ import annotations

import ctypes
import subprocess
import sys
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from orchestrator.flux_maps.exporting import export_map
from protocols import InputError
from tests.orchestrator.flux_maps.exporting.machines import MOTOR, POLE_PAIRS, PSI_M, saturated_flux, saturated_map

V_D, V_Q = 4.25, 8.5
PROGRAM = """\
import sys
import fmpy
import numpy as np
from fmpy.validation import validate_fmu

assert not validate_fmu(sys.argv[1]), validate_fmu(sys.argv[1])
volts = np.array([(0.0, 4.25, 8.5, 0.0)], dtype=[("time", "f8"), ("v_d", "f8"), ("v_q", "f8"), ("w_e", "f8")])
end = fmpy.simulate_fmu(sys.argv[1], stop_time=0.5, step_size=1e-3, output_interval=1e-2, input=volts)[-1]
print(end["i_d"], end["i_q"], end["torque"])
"""


@pytest.fixture(scope="module")
def unit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fmu")
    (file,) = export_map(saturated_map(), MOTOR, folder, ["fmu"], recording="bench-7").files
    return file.path


def test_the_machine_comes_to_rest_at_ohm_s_law_with_the_map_s_torque(unit: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(unit) as archive:
        archive.extractall(tmp_path)
    described = ElementTree.parse(tmp_path / "modelDescription.xml").getroot()
    assert "bench-7" in described.attrib["description"]
    references = {v.attrib["name"]: int(v.attrib["valueReference"]) for v in described.iter("ScalarVariable")}
    library = ctypes.CDLL(str(tmp_path / "binaries" / "linux64" / "pm400.so"))
    library.fmi2Instantiate.restype = ctypes.c_void_p
    assert library.fmi2Instantiate(b"m", 1, b"another", b"", None, 0, 0) is None
    machine = ctypes.c_void_p(library.fmi2Instantiate(b"m", 1, described.attrib["guid"].encode(), b"", None, 0, 0))

    def get(*names: str) -> list[float]:
        values = (ctypes.c_double * len(names))()
        vr = (ctypes.c_uint * len(names))(*(references[name] for name in names))
        assert library.fmi2GetReal(machine, vr, ctypes.c_size_t(len(names)), values) == 0
        return list(values)

    assert get("psi_d", "psi_q", "R_s") == pytest.approx([PSI_M, 0.0, 4.25], abs=1e-12)
    vr = (ctypes.c_uint * 2)(references["v_d"], references["v_q"])
    assert library.fmi2SetReal(machine, vr, ctypes.c_size_t(2), (ctypes.c_double * 2)(V_D, V_Q)) == 0
    for k in range(50):
        assert library.fmi2DoStep(machine, ctypes.c_double(0.01 * k), ctypes.c_double(0.01), 0) == 0
    assert get("i_d", "i_q") == pytest.approx([1.0, 2.0], abs=1e-3)
    psi = saturated_flux(np.array([1.0, 2.0]))
    assert get("psi_d", "psi_q") == pytest.approx(list(psi), rel=2e-3)
    assert get("torque")[0] == pytest.approx(1.5 * POLE_PAIRS * (psi[0] * 2.0 - psi[1] * 1.0), rel=2e-3)
    library.fmi2FreeInstance(machine)


def test_without_a_compiler_the_sources_are_in_it_and_that_is_stated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", "")
    (file,) = export_map(saturated_map(nodes=9), MOTOR, tmp_path, ["fmu"]).files
    assert "no C compiler is available: sources only" in file.notes
    with zipfile.ZipFile(file.path) as archive:
        assert set(archive.namelist()) == {"modelDescription.xml", "sources/pm400.c", "sources/flux_map.h"}


def test_a_machine_without_a_resistance_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="needs R_s"):
        export_map(saturated_map(nodes=9), MOTOR.model_copy(update={"stator_resistance_ohm": None}), tmp_path, ["fmu"])


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_fmpy_finds_nothing_wrong_with_it_and_runs_it(unit: Path, tmp_path: Path) -> None:
    subprocess.run([sys.executable, "-m", "venv", tmp_path / "env"], check=True, capture_output=True)
    python = tmp_path / "env" / "bin" / "python"
    subprocess.run([python, "-m", "pip", "install", "--quiet", "fmpy"], check=True, capture_output=True)
    done = subprocess.run([python, "-c", PROGRAM, unit], check=True, capture_output=True, text=True, timeout=300)
    i_d, i_q, _ = map(float, done.stdout.split())
    assert (i_d, i_q) == pytest.approx((1.0, 2.0), abs=1e-3)
