from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path
from shutil import which

import numpy as np
import pytest

from orchestrator.flux_maps.exporting import export_map
from protocols import FluxMap, InputError
from tests.orchestrator.flux_maps.exporting.machines import MOTOR, saturated_map, shipped

PROGRAM = """\
import sys
import numpy as np
from motulator.drive.utils import MagneticModel

with np.load(sys.argv[1]) as content:
    model = MagneticModel(content["i_s_dq"], content["psi_s_dq"], tau_M=content["tau_M"])
    i = content["i_s_dq"].ravel()
    inverse = model.invert()
np.savez(sys.argv[2], i=i, psi=model(i), inverse=inverse.i_s_dq)
"""


def python_for_motulator() -> str:
    """A Python of 3.12 or newer, which motulator's flux maps need: this one, one on the path, or one of pyenv's."""
    others = [which(f"python3.{minor}") for minor in (14, 13, 12)]
    others += [str(p) for p in sorted((Path.home() / ".pyenv" / "versions").glob("3.1[2-9]*/bin/python"))]
    for candidate in [sys.executable, *filter(None, others)]:
        available = subprocess.run(
            [candidate, "-c", "import sys; sys.exit(sys.version_info < (3, 12))"], capture_output=True
        )
        if available.returncode == 0:
            return candidate
    pytest.fail("motulator's flux maps need Python 3.12 or newer, and none was found: this is not tested here")


@pytest.fixture(scope="module")
def motulator(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An environment of its own with motulator in it, from the package index."""
    folder = tmp_path_factory.mktemp("motulator")
    subprocess.run([python_for_motulator(), "-m", "venv", folder], check=True, capture_output=True)
    python = folder / "bin" / "python"
    subprocess.run([python, "-m", "pip", "install", "--quiet", "motulator>=0.10"], check=True, capture_output=True)
    return python


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("machine", ["baldor-5k6", "with holes"])
def test_motulator_loads_interpolates_and_inverts_what_we_wrote(motulator: Path, tmp_path: Path, machine: str) -> None:
    flux_map: FluxMap = saturated_map() if machine == "with holes" else shipped(machine)
    export_map(flux_map, MOTOR, tmp_path, ["npz"])
    done = tmp_path / "done.npz"
    subprocess.run([motulator, "-c", PROGRAM, tmp_path / "flux_map.npz", done], check=True, timeout=300)
    with np.load(done) as content:
        psi, inverse = content["psi"], content["inverse"]
    known = np.isfinite(flux_map.psi_d)
    truth = (flux_map.psi_d + 1j * flux_map.psi_q)[known]
    found = np.isfinite(psi)
    assert found.mean() > 0.85
    # motulator resamples a map when it takes it in; the linear interpolation between its own nodes is its error.
    assert np.abs(psi - truth)[found].max() < 0.01 * np.abs(truth).max()
    assert np.isfinite(inverse).mean() > 0.7


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_exported_script_runs_the_machine_to_its_speed_and_load(motulator: Path, tmp_path: Path) -> None:
    motor = MOTOR.model_copy(update={"rated_current_rms_a": 1.66, "rated_voltage_rms_v": 139.3})
    export_map(saturated_map(), motor, tmp_path, ["npz", "motulator"])
    script = tmp_path / "flux_map_motulator.py"
    done = subprocess.run([motulator, script], check=True, capture_output=True, text=True, timeout=600)
    constants = {
        name: float(re.findall(rf"^{name} = (\S+)", script.read_text(), re.M)[0]) for name in ("SPEED_RAD_S", "LOAD_NM")
    }
    speed, torque = (float(word) for word in re.findall(r"(?:speed|torque) (\S+)", done.stdout))
    assert speed == pytest.approx(float(constants["SPEED_RAD_S"]), rel=1e-3)
    assert torque == pytest.approx(float(constants["LOAD_NM"]), rel=1e-2)


@pytest.mark.slow
def test_a_machine_without_a_resistance_has_no_script_and_says_so(tmp_path: Path) -> None:
    bare = MOTOR.model_copy(update={"stator_resistance_ohm": None})
    report = export_map(saturated_map(nodes=9), bare, tmp_path)
    assert any("no motulator file" in note for note in report.notes)
    assert not (tmp_path / "flux_map_motulator.py").exists()
    with pytest.raises(InputError, match="needs a resistance"):
        export_map(saturated_map(nodes=9), bare, tmp_path, ["motulator"])


def test_a_motor_s_name_cannot_end_the_script_s_opening_string(tmp_path: Path) -> None:
    motor = MOTOR.model_copy(update={"name": 'm\\"""; raise SystemExit(3); """'})
    export_map(saturated_map(nodes=9), motor, tmp_path, ["motulator"])
    tree = ast.parse((tmp_path / "flux_map_motulator.py").read_text())
    assert not any(isinstance(node, ast.Raise) for node in ast.walk(tree))
