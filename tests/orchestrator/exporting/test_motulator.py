from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from shutil import which

import numpy as np
import pytest

from orchestrator.exporting import export_map
from protocols import FluxMap
from tests.orchestrator.exporting.machines import MOTOR, saturated_map, shipped

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
        asked = subprocess.run(
            [candidate, "-c", "import sys; sys.exit(sys.version_info < (3, 12))"], capture_output=True
        )
        if asked.returncode == 0:
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
