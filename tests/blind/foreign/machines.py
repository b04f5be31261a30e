"""Five machines: a network with saturable bridges, one with ribs, measured and FEM maps, a SynRM, an arctangent."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from tests.blind.foreign.iron import Array, Iron, from_coenergy, tabulated
from tests.blind.magnetics import Machine

MAPS = Path(__file__).parents[3] / "plugins/drives/simulated/maps"
"""Maps of real machines with their licences (LICENSES.md there)."""
MAP_POINTS = 161
"""Of their tables on each axis: a tenth of the maps' own spacing."""


@dataclass(frozen=True)
class Motor:
    """A machine, its nameplate, and the currents of its plans in units of the nameplate's `top_a`.

    Attributes
    ----------
    span_d : tuple of float
        Lowest and highest i_d; |i_q| goes to 1.
    sharp : bool
        Whether iron saturates within a tenth of the current range.
    """

    plate: Machine
    iron: Iron
    span_d: tuple[float, float]
    sharp: bool


def draw_motor(rng: np.random.Generator, family: str) -> Motor:
    """A machine of one of `FAMILIES`, with other turns and length than the last one's."""
    motor = FAMILIES[family]()
    flux, current = (float(np.exp(rng.uniform(np.log(0.85), np.log(1.18)))) for _ in range(2))
    iron, plate = motor.iron.scaled(flux, current), motor.plate
    psi_d, _ = iron.flux(0.0, 0.0)
    l_d, _, l_q = iron.inductance(0.0, 0.25 * plate.top_a * current)

    def printed(value: float) -> float:
        """As a nameplate has it: some per cent off, three digits."""
        return float(f"{value * rng.uniform(0.95, 1.05):.3g}")

    plate = replace(
        plate,
        rated_current_rms_a=float(f"{plate.rated_current_rms_a * current:.3g}"),
        rated_torque_nm=float(f"{plate.rated_torque_nm * flux * current:.3g}"),
        rated_power_w=float(f"{plate.rated_power_w * flux * current:.3g}"),
        resistance_ohm=plate.resistance_ohm * flux / current,
        l_d_h=printed(l_d),
        l_q_h=printed(l_q),
        pm_flux_wb=float(f"{psi_d:.3g}") if plate.pm_flux_wb > 0.0 else 0.0,
        noise_a=plate.noise_a * current,
        quantum_a=plate.quantum_a * current,
    )
    return replace(motor, plate=plate, iron=iron)


def _network(
    magnet: Callable[[Array], Array], gap_h: tuple[float, float], rib: tuple[float, float],
    stator: tuple[float, float, float], d_wb: tuple[float, float], q_wb: float,
) -> Iron:  # fmt: skip
    """A reluctance network of series and parallel branches, each with its own energy.

    The d path is the gap in series with the rotor, whose flux at a magnetomotive force [A] is `magnet`. The q path is
    the gap in series with nothing but, beside it, ribs that carry up to rib[0] [Wb] and saturate within rib[1] [A].
    Teeth and yoke need stator[0] (|psi| / stator[1])^stator[2] [A] along the flux, which couples the axes.
    Sources: V. Ostovic, "Dynamics of Saturated Electric Machines" (1989), doi:10.1007/978-1-4613-8933-0; bridges:
    E. C. Lovelace, T. M. Jahns, J. H. Lang, "A saturating lumped-parameter model for an interior PM synchronous
    machine", IEEE Trans. Ind. Appl. 38 (2002) 645.
    """
    force = np.linspace(-60.0, 60.0, 240_001) * rib[1]
    force_d = np.linspace(-1.0, 1.0, 240_001) * 60.0 * rib[1]
    flux_d, flux_q = magnet(force_d), gap_h[1] * force + rib[0] * np.tanh(force / rib[1])

    def branch(force: Array, flux: Array) -> Callable[[Array], Array]:
        """Energy of one path, the integral of its force over its flux."""
        mean = 0.5 * (force[1:] + force[:-1])
        energy = np.concatenate([[0.0], np.cumsum(mean * np.diff(flux))])
        return lambda psi: np.interp(psi, flux, energy)

    rotor, q_path = branch(force_d, flux_d), branch(force, flux_q)
    size, limit, power = stator

    def energy(x: Array, y: Array) -> Array:
        iron = size * limit / (power + 1) * (np.hypot(x, y) / limit) ** (power + 1)
        return np.asarray(0.5 * x**2 / gap_h[0] + rotor(x) + q_path(y) + iron)

    return tabulated(energy, d_wb, q_wb)


@lru_cache(1)
def _ipm() -> Motor:
    """A 400 V interior-magnet machine: bridges and ribs saturate within 0.8 A of 12 A."""
    plate = Machine(
        "400 V interior-magnet machine", 3, 4000.0, 360.0, 8.5, 100.0, 19.0, 0.95, 0.015, 0.044, 0.5, 560.0, 1e4,
        500.0, 0.012, 4e-3,
    )  # fmt: skip

    def magnet(force: Array) -> Array:
        return np.asarray(0.018 * (force + 30.0) + 0.05 * np.tanh(force / 0.8))

    iron = _network(magnet, (0.09, 0.042), (0.03, 0.8), (1.2, 0.75, 7.0), (-0.3, 1.2), 1.15)
    return Motor(plate, iron, (-0.95, 0.45), True)


@lru_cache(1)
def _traction() -> Motor:
    """An 800 V traction machine: bridges and ribs saturate within 14 A of 300 A."""
    plate = Machine(
        "800 V traction machine", 4, 150e3, 480.0, 165.0, 400.0, 190.0, 0.011, 1.3e-4, 3.6e-4, 0.061, 800.0, 1e4, 500.0,
        0.25, 0.06,
    )  # fmt: skip

    def magnet(force: Array) -> Array:
        return np.asarray(1.5e-4 * (force + 450.0) + 5e-3 * np.tanh(force / 14.0))

    iron = _network(magnet, (1e-3, 3.3e-4), (4e-3, 14.0), (25.0, 0.11, 6.0), (-0.05, 0.17), 0.165)
    return Motor(plate, iron, (-0.95, 0.15), True)


@lru_cache(1)
def _synrm() -> Motor:
    """A 6.7 kW synchronous reluctance machine, d the axis of high inductance; L_q halves within a tenth of the range.

    i_d = (a_d0 + a_dd |psi_d|^5 + a_dq/2 |psi_d| psi_q^2) psi_d and alike on q. Source of form and numbers:
    M. Hinkkanen, P. Pescetto, E. Molsa, S. E. Saarakkala, G. Pellegrino, R. Bojoi, IEEE Trans. Ind. Appl. 53 (2017),
    doi:10.1109/TIA.2016.2644624.
    """
    plate = Machine(
        "6.7 kW synchronous reluctance machine", 2, 6.7e3, 370.0, 15.5, 106.0, 20.1, 0.54, 0.046, 0.0068, 0.0, 540.0,
        1e4, 500.0, 0.02, 6e-3,
    )  # fmt: skip

    def energy(x: Array, y: Array) -> Array:
        return np.asarray(
            0.5 * 17.4 * x**2 + 373.0 * np.abs(x) ** 7 / 7 + 0.5 * 52.1 * y**2 + 658.0 * np.abs(y) ** 3 / 3
            + 1120.0 / 6 * np.abs(x) ** 3 * y**2
        )  # fmt: skip

    return Motor(plate, tabulated(energy, (-1.35, 1.35), 0.55), (-0.85, 0.85), True)


@lru_cache(1)
def _arctan() -> Motor:
    """A 400 W servo machine whose magnetising flux goes by the arctangent of one common excitation.

    W' = L i^2 / 2 + E g(r) + E_d g((i_d + i_m) / a_d), g'' = 1 / (1 + x^2), r an ellipse of i_d + i_m and i_q: the
    axes share their iron. Source: B. Stumberger, G. Stumberger, D. Dolinar, A. Hamler, M. Trlep, "Evaluation of
    saturation and cross-magnetization effects in interior permanent-magnet synchronous motor", IEEE Trans. Ind. Appl.
    39 (2003) 1264 (such machines have to be modelled with it); the arctangent is the usual curve.
    """
    plate = Machine(
        "servo machine", 4, 750.0, 200.0, 4.4, 200.0, 2.4, 0.9, 0.0055, 0.0085, 0.075, 320.0, 1e4, 500.0, 0.008, 2e-3
    )
    a, b, shift, leak = 9.0, 6.5, 5.5, (0.0025, 0.0028)
    e, e_d, magnet_wb = 0.19, 0.06, 0.055

    def g(x: Array, order: int) -> Array:
        if order == 0:
            return np.asarray(x * np.arctan(x) - 0.5 * np.log1p(x**2))
        return np.asarray(np.arctan(x) if order == 1 else 1 / (1 + x**2))

    def coenergy(i_d: Array, i_q: Array, m: int, n: int) -> Array:
        u, v = (i_d + shift) / a, i_q / b
        r = np.maximum(np.hypot(u, v), 1e-9)
        slope, curve = g(r, 1) / r, g(r, 2)
        own = e_d * g(u, m) / a**m if n == 0 else 0.0
        if (m, n) == (0, 0):
            return np.asarray(0.5 * leak[0] * i_d**2 + 0.5 * leak[1] * i_q**2 + e * g(r, 0) + own + magnet_wb * i_d)
        if m + n == 1:
            linear, direction = (magnet_wb + leak[0] * i_d, u / a) if m else (leak[1] * i_q, v / b)
            return np.asarray(linear + e * slope * direction + own)
        bend = (curve - slope) / r**2
        if (m, n) == (1, 1):
            return np.asarray(e * bend * u * v / (a * b))
        if m == 2:
            return np.asarray(leak[0] + e * (slope + bend * u**2) / a**2 + own)
        return np.asarray(leak[1] + e * (slope + bend * v**2) / b**2)

    return Motor(plate, from_coenergy(coenergy, (-0.065, 0.275), 0.17, 4.0), (-1.0, 0.9), False)


@lru_cache(1)
def _measured() -> Motor:
    """Baldor ECS101M0H7EF4, 5.6 kW PM-SyRM, measured; motulator (Aalto University), MIT."""
    plate = Machine(
        "5.6 kW PM-SyRM", 2, 5600.0, 460.0, 6.5, 60.0, 20.0, 0.63, 0.02, 0.11, 0.44, 650.0, 8e3, 400.0, 0.01, 3e-3
    )
    return Motor(plate, _from_map("baldor-5k6.csv", (-0.4, 1.2), 1.6, 8.0), (-0.95, 0.95), False)


@lru_cache(1)
def _finite_elements() -> Motor:
    """An interior-magnet traction machine, FEMM with four skew slices; pmsm-femm-to-tinyml, MIT."""
    plate = Machine(
        "interior-magnet traction machine", 4, 40e3, 200.0, 120.0, 300.0, 80.0, 0.0095, 1.2e-4, 5e-4, 0.061, 400.0, 1e4,
        500.0, 0.2, 0.05,
    )  # fmt: skip
    return Motor(plate, _from_map("ipm-femm-60c.csv", (-0.01, 0.12), 0.12, 60.0), (-0.95, 0.15), False)


def _from_map(name: str, d_wb: tuple[float, float], q_wb: float, guess_a: float) -> Iron:
    """A map by a co-energy of quintic splines; beyond its points inductances stay as they are there."""
    from scipy.interpolate import BSpline, NdBSpline

    rows = np.loadtxt(MAPS / name, delimiter=",", comments="#", skiprows=2)
    both = np.concatenate([rows, rows * [1, -1, 1, -1]])
    lows, highs = both[:, :2].min(axis=0), both[:, :2].max(axis=0)

    def knots(low: float, high: float, intervals: int) -> Array:
        return np.concatenate([np.full(5, low), np.linspace(low, high, intervals + 1), np.full(5, high)])

    grids = knots(lows[0], highs[0], 9), knots(lows[1], highs[1], 15)
    sizes = len(grids[0]) - 6, len(grids[1]) - 6

    def basis(axis: int, order: int) -> Array:
        return np.asarray(BSpline(grids[axis], np.eye(sizes[axis]), 5)(both[:, axis], nu=order))

    def design(order_d: int, order_q: int) -> Array:
        parts = basis(0, order_d), basis(1, order_q)
        return np.asarray(np.einsum("ki,kj->kij", *parts).reshape(len(both), -1))

    matrix = np.concatenate([design(1, 0), design(0, 1)])
    scale = np.abs(matrix).max(axis=0) + 1e-12
    found = np.linalg.lstsq(matrix / scale, np.concatenate([both[:, 2], both[:, 3]]), rcond=1e-9)[0] / scale
    table = found.reshape(sizes)
    spline = NdBSpline(grids, 0.5 * (table + table[:, ::-1]), 5)
    margin = 0.02 * (highs - lows)

    def coenergy(i_d: Array, i_q: Array, m: int, n: int) -> Array:
        in_d = np.clip(i_d, lows[0] + margin[0], highs[0] - margin[0])
        in_q = np.clip(i_q, lows[1] + margin[1], highs[1] - margin[1])
        out_d, out_q = i_d - in_d, i_q - in_q

        def at(a: int, b: int) -> Array:
            return np.asarray(spline(np.stack([in_d, in_q], axis=-1), nu=(a, b)))

        # Taylor's second order about the nearest point inside; its derivatives alike.
        if (m, n) == (0, 0):
            first, cross = at(1, 0) * out_d + at(0, 1) * out_q, at(1, 1) * out_d * out_q
            return np.asarray(at(0, 0) + first + 0.5 * at(2, 0) * out_d**2 + 0.5 * at(0, 2) * out_q**2 + cross)
        if m + n == 1:
            return np.asarray(at(m, n) + at(m + 1, n) * out_d + at(m, n + 1) * out_q)
        return at(m, n)

    return from_coenergy(coenergy, d_wb, q_wb, guess_a, MAP_POINTS)


FAMILIES: dict[str, Callable[[], Motor]] = {
    "ipm_bridges": _ipm,
    "traction_bridges": _traction,
    "synrm": _synrm,
    "arctan": _arctan,
    "measured": _measured,
    "finite_elements": _finite_elements,
}
