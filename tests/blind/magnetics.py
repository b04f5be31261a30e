"""Saturated machines nobody chose by hand: co-energies W'(i) of several families, as one table for the plant.

psi = grad W'(i), dpsi/di = Hess W'(i): reciprocity holds by construction. The families are a shared iron whose
reluctance grows with |i + i_f| (Fröhlich, Langevin), separate arctangents with a cross term, and a measured
machine's map brought to the nameplate's scale.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

Array = np.ndarray[Any, np.dtype[np.float64]]

POINTS = 121
REACH = 3.0
"""The table's half-width in units of the largest current of the campaign. An injection that begins at the plan's edge
reaches twice that where the iron is soft; within a tenth of its own edge a table is no iron."""
MEASURED = Path(__file__).parents[2] / "plugins/drives/simulated/maps/baldor-5k6.csv"
"""Baldor ECS101M0H7EF4, measured; motulator (Aalto University), MIT."""


@dataclass(frozen=True)
class Machine:
    """Nameplate and the currents of its campaign; peak values."""

    name: str
    pole_pairs: int
    rated_power_w: float
    rated_voltage_rms_v: float
    rated_current_rms_a: float
    rated_frequency_hz: float
    rated_torque_nm: float
    resistance_ohm: float
    l_d_h: float
    l_q_h: float
    pm_flux_wb: float
    bus_v: float
    sampling_hz: float
    injection_hz: float
    noise_a: float
    quantum_a: float

    @property
    def top_a(self) -> float:
        """The largest current aimed at on an axis."""
        return float(1.28 * np.sqrt(2.0) * self.rated_current_rms_a)

    @property
    def rated_flux_wb(self) -> float:
        """The magnet's, or what the rated current makes where that is more."""
        rated_a = float(np.sqrt(2.0)) * self.rated_current_rms_a
        return max(self.pm_flux_wb, self.l_d_h * rated_a, self.l_q_h * rated_a)


PM400 = Machine(
    "400 W test PMSM", 2, 400.0, 139.3, 1.66, 60.0, 2.12, 4.25, 0.04325, 0.06905, 0.30, 540.0, 1e4, 500.0, 4e-3, 1e-3
)
SERVO_48V = Machine(
    "48 V servo", 4, 250.0, 24.0, 8.0, 200.0, 0.8, 0.5, 3.0e-4, 3.6e-4, 0.0118, 48.0, 2e4, 1000.0, 0.012, 3e-3
)
TRACTION_28KW = Machine(
    "28 kW interior-magnet machine", 4, 28e3, 160.0, 145.0, 200.0, 89.0, 0.02, 3.2e-4, 8.5e-4, 0.065,
    320.0, 1e4, 500.0, 0.25, 0.06,
)  # fmt: skip


@dataclass(frozen=True)
class Table:
    """W' as coefficients of bicubic B-splines on a uniform grid, [J]."""

    coefficients: Array
    low_a: float
    step_a: float

    def flux(self, i_d: float, i_q: float) -> tuple[float, float]:
        """psi(i) [Wb]."""
        d, q, *_ = self._derivatives(i_d, i_q)
        return d, q

    def inductance(self, i_d: float, i_q: float) -> tuple[float, float, float]:
        """(L_dd, L_dq, L_qq) [H]."""
        *_, dd, dq, qq = self._derivatives(i_d, i_q)
        return dd, dq, qq

    def _derivatives(self, i_d: float, i_q: float) -> tuple[float, ...]:
        from tests.blind.plant import look_up

        return tuple(look_up(self.coefficients, self.low_a, 1.0 / self.step_a, i_d, i_q))


def draw_table(
    rng: np.random.Generator, machine: Machine, slot: float = 0.0, family: str | None = None
) -> tuple[str, Table]:
    """A saturated machine: its inductances fall by 20 to 60 %, L_dq reaches 3 to 15 %.

    Parameters
    ----------
    slot : float
        Saliency of the slots at this angle, relative to the mean inductance: it breaks the evenness in i_q.
    """
    while True:
        kind = family or str(rng.choice(["froehlich", "langevin", "arctan", "measured"]))
        axis = np.linspace(-REACH, REACH, POINTS) * machine.top_a
        x, y = np.meshgrid(axis, axis, indexing="ij")
        energy = _measured(rng, machine, x, y) if kind == "measured" else _parametric(rng, kind, machine, x, y)
        table = tabulated(energy, axis)
        if _plausible(table, machine):
            break
    if slot:
        phase = rng.uniform(0.2, 0.8) * np.pi * rng.choice([-1, 1])
        mean = 0.5 * (machine.l_d_h + machine.l_q_h)
        form = 0.5 * slot * mean * (np.cos(phase) * (x**2 - y**2) + 2 * np.sin(phase) * x * y)
        table = tabulated(energy + form / (1 + (x**2 + y**2) / (6 * machine.top_a) ** 2), axis)
    return kind, table


def tabulated(energy: Array, axis: Array) -> Table:
    """W' [J], shape (n, n), on one uniform axis [A] for both currents."""
    from scipy.ndimage import spline_filter

    coefficients = spline_filter(energy, order=3, output=np.float64, mode="mirror")
    return Table(np.ascontiguousarray(coefficients), float(axis[0]), float(axis[1] - axis[0]))


def _plausible(table: Table, machine: Machine) -> bool:
    top = machine.top_a
    corners = [table.inductance(a * top, b * top) for a in np.linspace(-1.5, 1.5, 9) for b in np.linspace(-1.5, 1.5, 9)]
    if any(
        dd <= 0.1 * machine.l_d_h or dd * qq - dq * dq <= 0.02 * machine.l_d_h * machine.l_q_h for dd, dq, qq in corners
    ):
        return False
    d0, _, q0 = table.inductance(0.0, 0.0)
    d1 = table.inductance(top, 0.0)[0]
    q1 = table.inductance(0.0, top)[2]
    cross = max(abs(table.inductance(s * 0.6 * top, 0.6 * top)[1]) for s in (-1, 1)) / np.sqrt(d0 * q0)
    return bool(0.05 < 1 - d1 / d0 < 0.65 and 0.15 < 1 - q1 / q0 < 0.7 and 0.02 < cross < 0.2)


def _parametric(rng: np.random.Generator, kind: str, machine: Machine, x: Array, y: Array) -> Array:
    """Linear leakage and a saturable rest, scaled to the nameplate's inductances (within some per cent) and magnet."""
    top = machine.top_a
    l_d, l_q = machine.l_d_h * rng.uniform(0.92, 1.08), machine.l_q_h * rng.uniform(0.92, 1.08)
    shift = rng.uniform(0.2, 0.8) * top
    a, b = rng.uniform(0.7, 1.8, 2) * top
    share = rng.uniform(0.6, 0.9)

    def shape(i_d: Any, i_q: Any) -> Any:
        if kind == "arctan":
            u, v = (i_d + shift) / a, i_q / b
            cross = rng_cross * (1 + np.tanh(u)) * v**2 / (1 + 0.5 * v**2)
            return weight * _arctan_energy(u) * a**2 + (_arctan_energy(v) - cross) * b**2
        square = ((i_d + shift) / a) ** 2 + (i_q / b) ** 2
        if kind == "froehlich":
            return np.sqrt(1 + square)
        s = np.sqrt(3 * square + 1e-12)
        return s + np.log1p(-np.exp(-2 * s)) - np.log(2 * s)

    rng_cross, weight = rng.uniform(0.02, 0.08), l_d / l_q
    h = 1e-3 * top
    dd = _second(lambda e: shape(e, 0.0), h)
    qq = _second(lambda e: shape(0.0, e), h)
    scale = share * min(l_d / dd, l_q / qq)
    energy: Array = scale * shape(x, y) + 0.5 * (l_d - scale * dd) * x**2 + 0.5 * (l_q - scale * qq) * y**2
    at_zero = scale * float(shape(h, 0.0) - shape(-h, 0.0)) / (2 * h)
    return energy + (machine.pm_flux_wb - at_zero) * x


def _arctan_energy(t: Any) -> Any:
    """Whose second derivative is 1 / (1 + t^2)."""
    return t * np.arctan(t) - 0.5 * np.log1p(t**2)


def _second(f: Any, h: float) -> float:
    return float((f(h) - 2 * f(0.0) + f(-h)) / h**2)


def _measured(rng: np.random.Generator, machine: Machine, x: Array, y: Array) -> Array:
    """The measured map's co-energy by a smoothing fit of splines, brought to this machine's currents and inductances.

    Currents beyond the map are pulled in smoothly; what is read there is linear in the current.
    """
    from scipy.interpolate import BSpline

    rows = np.loadtxt(MEASURED, delimiter=",", comments="#", skiprows=2)
    knots_d, knots_q = (_knots(rows[:, 0], 7), _knots(rows[:, 1], 9))
    size = (len(knots_d) - 6, len(knots_q) - 6)

    def design(i_d: Array, i_q: Array, order_d: int, order_q: int) -> Array:
        basis_d = BSpline(knots_d, np.eye(size[0]), 5)(i_d, nu=order_d)
        basis_q = BSpline(knots_q, np.eye(size[1]), 5)(i_q, nu=order_q)
        return np.asarray(np.einsum("ki,kj->kij", basis_d, basis_q).reshape(len(i_d), -1))

    both = np.concatenate([rows[:, :2], rows[:, :2] * [1, -1]])
    flux = np.concatenate([rows[:, 2:], rows[:, 2:] * [1, -1]])
    i_d, i_q = both.T
    matrix = np.concatenate([design(i_d, i_q, 1, 0), design(i_d, i_q, 0, 1)])
    found = np.linalg.lstsq(matrix, np.concatenate([flux[:, 0], flux[:, 1]]), rcond=1e-10)[0]

    top = machine.top_a
    stretch = 7.0 * rng.uniform(0.8, 1.3) / top
    u, v = stretch * x.ravel(), stretch * y.ravel()
    inside_d, inside_q = np.clip(u, -19.0, 19.0), np.clip(v, -25.0, 25.0)
    energy = design(inside_d, inside_q, 0, 0) @ found
    slope_d, slope_q = design(inside_d, inside_q, 1, 0) @ found, design(inside_d, inside_q, 0, 1) @ found
    curve_d, curve_q = design(inside_d, inside_q, 2, 0) @ found, design(inside_d, inside_q, 0, 2) @ found
    du, dv = u - inside_d, v - inside_q
    energy += slope_d * du + slope_q * dv + 0.5 * curve_d * du**2 + 0.5 * curve_q * dv**2
    at_zero = [float((design(np.zeros(1), np.zeros(1), d, q) @ found)[0]) for d, q in ((1, 0), (2, 0), (0, 2))]
    flux_0, l_d, l_q = at_zero
    # The measured machine is a reluctance machine: its saliency is left, its size is not.
    scale = np.sqrt(machine.l_d_h * machine.l_q_h / (l_d * l_q)) / stretch**2
    energy = scale * energy.reshape(x.shape)
    energy = 0.5 * (energy + energy[:, ::-1])
    return np.asarray(energy + (machine.pm_flux_wb - scale * stretch * flux_0) * x, dtype=np.float64)


def _knots(values: Array, intervals: int) -> Array:
    inner = np.linspace(values.min(), values.max(), intervals + 1)
    return np.concatenate([np.full(5, inner[0]), inner, np.full(5, inner[-1])])
