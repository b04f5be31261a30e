"""Kernels compiled for any processor, so that a slow virtual machine finds them ready. Starts no machine."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ANY_CPU = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}
"""What numba compiles for; part of the name under which it keeps a kernel."""
_USES_ALL = """
from plugins.drives.simulated import SimulatedOptions
from plugins.drives.simulated.rig import Rig
from protocols import Motor
from tests.support.tiny import MOTOR
Rig(SimulatedOptions(), Motor(**MOTOR), 1).warm_up()
"""


def compile_for_any_cpu(folder: Path) -> None:
    """Compile the plant; what comes of it stays in `folder`, and is used again where it still fits."""
    folder.mkdir(parents=True, exist_ok=True)
    environment = {**os.environ, **ANY_CPU, "NUMBA_CACHE_DIR": str(folder)}
    subprocess.run([sys.executable, "-c", _USES_ALL], env=environment, check=True, cwd=Path(__file__).parents[2])
