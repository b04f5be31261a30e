"""A saturated machine, its inverter and its sensors under the control of the C code; shares no code with the tuning."""

from __future__ import annotations

import ctypes
import dataclasses
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from orchestrator.numerics.types import Array

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-Wconversion", "-Wdouble-promotion", "-pedantic")
PLANT = Path(__file__).with_name("plant.c")
COLUMNS = ("i_d", "i_q", "torque", "omega", "v_d", "v_q", "ref_d", "ref_q", "report", "phase_a", "injected", "length_v")


def compiler() -> str:
    """Path of a C compiler; skips the test where there is none."""
    found = shutil.which("gcc")
    if found is None:
        pytest.skip("gcc is not installed")
    return found


@dataclass(frozen=True)
class Plant:
    """Parameters of the plant in the order of plant.c, with a map psi(i) that obeys reciprocity."""

    psi_m: float = 0.08
    l_d: float = 3.2e-3
    i_d: float = 40.0
    l_q: float = 8e-3
    i_q: float = 9.0
    l_leak: float = 1.2e-3
    cross: float = 8e-5
    i_x: float = 15.0
    i_y: float = 20.0
    r_s: float = 0.4
    pole_pairs: float = 4.0
    v_dc: float = 300.0
    period: float = 1e-4
    dead_time: float = 0.0
    drop_v: float = 0.0
    drop_ohm: float = 0.0
    knee_a: float = 0.05
    gain_a: float = 1.0
    gain_b: float = 1.0
    offset_a: float = 0.0
    offset_b: float = 0.0
    noise_a: float = 0.0
    angle_error: float = 0.0
    inertia: float = 0.0
    load_nm: float = 0.0
    is_compensated: float = 0.0
    injected_v: float = 0.0
    injected_rad_per_sample: float = 0.0
    injected_axis: float = 0.0
    winding_c: float = 20.0

    def psi(self, i_dq: Array) -> Array:
        """Flux linkage [Wb], shape (n, 2), at currents of shape (n, 2)."""
        d, q = i_dq[..., 0], i_dq[..., 1]
        x, y = 1.0 + (d / self.i_x) ** 2, 1.0 + (q / self.i_y) ** 2
        psi_d = self.psi_m + self.l_d * d / np.sqrt(1.0 + (d / self.i_d) ** 2) - self.cross * x**-1.5 * q**2 / (2.0 * y)
        psi_q = (
            self.l_q * q / np.sqrt(1.0 + (q / self.i_q) ** 2) + self.l_leak * q - self.cross * d * x**-0.5 * q / y**2
        )
        return np.stack([psi_d, psi_q], axis=-1)

    def torque_nm(self, i_dq: Array) -> Array:
        psi = self.psi(i_dq)
        torque: Array = 1.5 * self.pole_pairs * (psi[..., 0] * i_dq[..., 1] - psi[..., 1] * i_dq[..., 0])
        return torque

    def lost_v(self, i_a: Array, v_dc: float) -> Array:
        """Voltage that a leg loses [V]."""
        sign = np.clip(i_a / self.knee_a, -1.0, 1.0)
        lost: Array = sign * (self.dead_time / self.period * v_dc + self.drop_v) + self.drop_ohm * i_a
        return lost


class Loop:
    """The C code with the plant around it, compiled.

    Parameters
    ----------
    files : mapping
        Header and source of the symbol `motor`.
    folder : Path
        An empty one for the files.
    """

    def __init__(self, files: Mapping[str, bytes], folder: Path) -> None:
        library = library_of(files, folder, PLANT.read_bytes())
        self._simulate = library.simulate
        self._simulate.restype = None
        self.library = library

    def run(self, plant: Plant, command: Array) -> dict[str, Array]:
        """Samples by name, each of shape (n,), for commands of shape (n, 6): see `simulate` in plant.c."""
        rows = np.ascontiguousarray(command, dtype=np.float64)
        out = np.empty((len(rows), len(COLUMNS)))
        parameters = np.array(dataclasses.astuple(plant), dtype=np.float64)
        self._simulate(_pointer(parameters), len(rows), _pointer(rows), _pointer(out))
        return dict(zip(COLUMNS, out.T, strict=True))

    def torque(self, plant: Plant, torque_nm: Array | float, speed_rad_s: float, count: int) -> dict[str, Array]:
        """With a torque command at an imposed speed."""
        rows = np.zeros((count, 6))
        rows[:, 0], rows[:, 1], rows[:, 4], rows[:, 5] = torque_nm, speed_rad_s, plant.v_dc, 1.0
        return self.run(plant, rows)

    def currents(self, plant: Plant, i_dq: Array, speed_rad_s: Array | float) -> dict[str, Array]:
        """With current commands, shape (n, 2), at an imposed speed."""
        rows = np.zeros((len(i_dq), 6))
        rows[:, 1], rows[:, 2:4], rows[:, 4] = speed_rad_s, i_dq, plant.v_dc
        return self.run(plant, rows)


def library_of(
    files: Mapping[str, bytes], folder: Path, more: bytes = b"", options: Sequence[str] = ("-O2",)
) -> ctypes.CDLL:
    """The source as a shared library, every warning an error, with further source that uses it."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        (folder / name).write_bytes(content)
    (folder / "more.c").write_bytes(more or b"typedef int nothing;\n")
    gcc = compiler()
    for name in (*(n for n in files if n.endswith(".c")), "more.c"):
        run(gcc, *STRICT, *options, "-fPIC", "-c", name, folder=folder)
    run(gcc, "-shared", "-o", "drive.so", *(p.name for p in folder.glob("*.o")), "-lm", folder=folder)
    return ctypes.CDLL(str(folder / "drive.so"))


def run(*words: str, folder: Path, environment: Mapping[str, str] | None = None) -> str:
    """A program's output; fails with its errors."""
    done = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout


def _pointer(array: NDArray[np.float64]) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)
