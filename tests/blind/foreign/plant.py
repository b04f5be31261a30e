"""A locked motor and its drive, the flux as the state: dpsi/dt = R(-theta) (v - e) - R i - w J psi, i = grad H + ...

Runge-Kutta on flux and eddy currents; heat, bus, brake and sensors go by steps of their own between. No line, and no
form of an effect, is shared with the first examiner's plant, the analysis or the simulated drive.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from tests.blind.foreign.inverter import phase_loss
from tests.blind.foreign.iron import Array, derivatives
from tests.blind.foreign.preisach import held_current, remember

SQRT3 = math.sqrt(3.0)
BRANCHES = 6
(PSI, EDDY, TURN, FAST) = (0, 2, 14, 15)
"""Flux, eddy currents of six branches on d and q, current in the shorted turn; so many go by Runge-Kutta."""
(HEAT, BUS, TWIST, BRISTLE, HALL, SHUNT, BEFORE, PULL, CORE, LATE) = (15, 17, 19, 21, 22, 28, 31, 34, 36, 39)
"""Two temperatures, two capacitors, angle and speed, the brake's bristle, three Hall sensors of second order, heat of
three shunts, phase currents one step before, the controller's integrals, the sensors' cores, the last two voltages."""
STATES = 43
(CONTROL, OPEN, OFF) = (0, 1, 2)


class Plant(NamedTuple):
    """Everything that drive, brake and winding are; zero is absent. Iron and tables come beside it."""

    sample_s: float
    substeps: int
    pole_pairs: float
    resistance: float
    bus_v: float
    noise_a: float
    quantum_a: float
    # sensors
    gain_a: float = 1.0
    gain_b: float = 1.0
    gain_c: float = 1.0
    offset_a: float = 0.0
    offset_b: float = 0.0
    offset_c: float = 0.0
    shunts: float = 0.0
    """Not zero: the leg with the largest command is not read, but minus the sum of the others."""
    hall: float = 0.0
    """Not zero: sensors of second order, by the transition matrix that comes beside."""
    core_a: float = 0.0
    """Half width of the remanence of a sensor's core."""
    shunt_per_a2: float = 0.0
    """Rise of a shunt by the square of its current, ..."""
    shunt_s: float = 1.0
    # voltage
    delay_samples: float = 0.0
    line_ohm: float = 0.0
    line_f: float = 1e-3
    link_ohm: float = 0.0
    link_f: float = 1e-4
    shortest: float = 0.0
    """Pulses below this part of a period are left out."""
    # inverter; its charge table comes beside
    dead_v: float = 0.0
    dead_a: float = 1.0
    knee_v: float = 0.0
    knee_a: float = 1.0
    knee_per_asinh: float = 1.0
    # winding
    copper_j_per_k: float = 1.0
    slot_k_per_w: float = 0.0
    iron_j_per_k: float = 1.0
    room_k_per_w: float = 0.0
    turn_s: float = 1.0
    turn_siemens: float = 0.0
    # frame
    misaligned: float = 0.0
    spring_per_nm: float = 0.0
    resonance: float = 1.0
    """Of the rotor on its spring [rad/s]."""
    damping: float = 0.3
    friction_nm: float = 0.0
    breakaway: float = 1.3
    """Of the friction when it slides."""
    creep_rad_s: float = 1.0
    """Stribeck's speed."""
    bristle_rad: float = 1e-4
    """By how much bristles bend before they slide."""
    # iron
    eddy_siemens: float = 0.0
    """Of the slowest branch; the others' goes with the root of their time constant."""
    eddy_slow_s: float = 1e-2
    eddy_fast_s: float = 3e-5
    held_a: float = 0.0
    held_per_wb: float = 1.0
    magnet_wb: float = 0.0
    """Flux on d about which the loops lie."""


COPPER_PER_K = 0.00393


@njit(cache=True, nogil=True)
def _phases(alpha: float, beta: float) -> tuple[float, float, float]:
    return alpha, 0.5 * (SQRT3 * beta - alpha), -0.5 * (SQRT3 * beta + alpha)


@njit(cache=True, nogil=True)
def stator_current(
    p: Plant, c: Array, grid: Array, table: Array, memory: Array, y: Array, theta: float
) -> tuple[float, float]:
    """Current of the terminals in the stator's frame."""
    d, q, _, _, _ = derivatives(c, grid, y[PSI], y[PSI + 1])
    if p.eddy_siemens > 0.0:
        for k in range(BRANCHES):
            d += y[EDDY + 2 * k]
            q += y[EDDY + 2 * k + 1]
    if p.held_a > 0.0:
        held_d, held_q = held_current(table, memory, p.held_per_wb, p.held_a, y[PSI] - p.magnet_wb, y[PSI + 1])
        d, q = d + held_d, q + held_q
    cos, sin = math.cos(theta), math.sin(theta)
    return cos * d - sin * q + y[TURN], sin * d + cos * q


@njit(cache=True, nogil=True)
def _rates(
    p: Plant, c: Array, grid: Array, table: Array, memory: Array, charge: Array, y: Array, v_alpha: float,
    v_beta: float, theta: float, out: Array,
) -> None:  # fmt: skip
    """dy/dt of flux and eddy currents."""
    i_alpha, i_beta = stator_current(p, c, grid, table, memory, y, theta)
    resistance = p.resistance * (1.0 + COPPER_PER_K * y[HEAT])
    i_a, i_b, i_c = _phases(i_alpha, i_beta)
    e_a = phase_loss(charge, p.dead_v, p.dead_a, p.knee_v, p.knee_a, p.knee_per_asinh, i_a)
    e_b = phase_loss(charge, p.dead_v, p.dead_a, p.knee_v, p.knee_a, p.knee_per_asinh, i_b)
    e_c = phase_loss(charge, p.dead_v, p.dead_a, p.knee_v, p.knee_a, p.knee_per_asinh, i_c)
    # What the shorted turn carries flows beside the winding's resistance.
    u_alpha = v_alpha - (2 * e_a - e_b - e_c) / 3 - resistance * (i_alpha - y[TURN])
    u_beta = v_beta - (e_b - e_c) / SQRT3 - resistance * i_beta
    cos, sin = math.cos(theta), math.sin(theta)
    speed = y[TWIST + 1]
    out[PSI] = cos * u_alpha + sin * u_beta + speed * y[PSI + 1]
    out[PSI + 1] = -sin * u_alpha + cos * u_beta - speed * y[PSI]
    if p.eddy_siemens > 0.0:
        ratio = (p.eddy_fast_s / p.eddy_slow_s) ** (1.0 / (BRANCHES - 1))
        tau, siemens = p.eddy_slow_s, p.eddy_siemens
        for k in range(BRANCHES):
            out[EDDY + 2 * k] = (siemens * out[PSI] - y[EDDY + 2 * k]) / tau
            out[EDDY + 2 * k + 1] = (siemens * out[PSI + 1] - y[EDDY + 2 * k + 1]) / tau
            tau, siemens = tau * ratio, siemens * math.sqrt(ratio)
    if p.turn_siemens > 0.0:
        out[TURN] = (p.turn_siemens * u_alpha - y[TURN]) / p.turn_s


@njit(cache=True, nogil=True)
def _advance(
    p: Plant, c: Array, grid: Array, table: Array, memory: Array, charge: Array, hall: Array, y: Array, work: Array,
    v_alpha: float, v_beta: float, believed: float, h: float,
) -> None:  # fmt: skip
    """One step of h seconds under a constant command."""
    scale = 1.0 - (y[BUS] + y[BUS + 1]) / p.bus_v
    u_alpha, u_beta = scale * v_alpha, scale * v_beta
    theta = believed + p.misaligned + y[TWIST]
    turn = h * y[TWIST + 1]
    for stage in range(4):
        part = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
        work[4, :] = y
        if stage:
            for n in range(FAST):
                work[4, n] = y[n] + part * h * work[stage - 1, n]
        _rates(p, c, grid, table, memory, charge, work[4], u_alpha, u_beta, theta + part * turn, work[stage])
    for n in range(FAST):
        y[n] += h / 6.0 * (work[0, n] + 2 * work[1, n] + 2 * work[2, n] + work[3, n])
    if p.held_a > 0.0:
        remember(table, memory, p.held_per_wb, y[PSI] - p.magnet_wb, y[PSI + 1])
    i_alpha, i_beta = stator_current(p, c, grid, table, memory, y, theta + turn)
    _warm(p, y, i_alpha, i_beta, h)
    if p.line_ohm > 0.0:
        _charge_bus(p, y, 1.5 * (u_alpha * i_alpha + u_beta * i_beta), h)
    if p.spring_per_nm > 0.0:
        cos, sin = math.cos(theta + turn), math.sin(theta + turn)
        i_d, i_q = cos * (i_alpha - y[TURN]) + sin * i_beta, cos * i_beta - sin * (i_alpha - y[TURN])
        _twist(p, y, 1.5 * p.pole_pairs * (y[PSI] * i_q - y[PSI + 1] * i_d), h)
    i = _phases(i_alpha, i_beta)
    for n in range(3):
        if p.hall > 0.0:
            x, v = y[HALL + 2 * n], y[HALL + 2 * n + 1]
            for m in range(2):
                y[HALL + 2 * n + m] = hall[m, 0] * x + hall[m, 1] * v + hall[m, 2] * y[BEFORE + n] + hall[m, 3] * i[n]
        if p.shunt_per_a2 > 0.0:
            y[SHUNT + n] += h / p.shunt_s * (p.shunt_per_a2 * i[n] ** 2 - y[SHUNT + n])
        y[BEFORE + n] = i[n]


@njit(cache=True, nogil=True)
def _warm(p: Plant, y: Array, i_alpha: float, i_beta: float, h: float) -> None:
    """Copper in its slot, and the iron around it: a ladder of two heat capacities from the loss to the room."""
    if p.slot_k_per_w > 0.0:
        loss = 1.5 * p.resistance * (1.0 + COPPER_PER_K * y[HEAT]) * (i_alpha * i_alpha + i_beta * i_beta)
        flow = (y[HEAT] - y[HEAT + 1]) / p.slot_k_per_w
        y[HEAT] += h * (loss - flow) / p.copper_j_per_k
        y[HEAT + 1] += h * (flow - y[HEAT + 1] / p.room_k_per_w) / p.iron_j_per_k


@njit(cache=True, nogil=True)
def _charge_bus(p: Plant, y: Array, watts: float, h: float) -> None:
    """Two capacitors behind two resistors: what the line and the link lose [V], each with its own lag."""
    drawn = watts / p.bus_v
    fed = y[BUS] / p.line_ohm
    through = y[BUS + 1] / p.link_ohm
    y[BUS] += (through - fed) * p.line_ohm * -math.expm1(-h / (p.line_ohm * p.line_f))
    y[BUS + 1] += (drawn - through) * p.link_ohm * -math.expm1(-h / (p.link_ohm * p.link_f))


@njit(cache=True, nogil=True)
def _twist(p: Plant, y: Array, torque: float, h: float) -> None:
    """The rotor on the brake's spring and its bristles (LuGre), in steps of a tenth of its resonance's radian."""
    count = math.ceil(10.0 * h * p.resonance)
    step = h / count
    for _ in range(count):
        friction = 0.0
        if p.friction_nm > 0.0:
            speed = y[TWIST + 1]
            limit = 1.0 + (p.breakaway - 1.0) * math.exp(-((speed / p.creep_rad_s) ** 2))
            before = y[BRISTLE]
            y[BRISTLE] = (before + step * speed) / (1.0 + step * abs(speed) / (limit * p.bristle_rad))
            damped = 0.3 * (y[BRISTLE] - before) / step / p.resonance
            friction = p.friction_nm * (y[BRISTLE] + damped) / p.bristle_rad
        pull = p.spring_per_nm * (torque - friction) - y[TWIST]
        y[TWIST + 1] += step * p.resonance * (p.resonance * pull - 2 * p.damping * y[TWIST + 1])
        y[TWIST] += step * y[TWIST + 1]


@njit(cache=True, nogil=True)
def _read(p: Plant, y: Array, n: int, gain: float, offset: float, noise: float, flows: bool) -> float:
    """What the sensor of one phase reads."""
    i = 0.0
    if flows:
        i = y[HALL + 2 * n] if p.hall > 0.0 else y[BEFORE + n]
    if p.core_a > 0.0:
        y[CORE + n] = min(max(y[CORE + n], i - 2 * p.core_a), i + 2 * p.core_a)
        i += 0.5 * (y[CORE + n] - i)
    read = gain * (1.0 + y[SHUNT + n]) * i + offset + noise
    return float(p.quantum_a * math.floor(read / p.quantum_a + 0.5)) if p.quantum_a > 0.0 else float(read)


@njit(cache=True, nogil=True)
def _impressed(p: Plant, v_alpha: float, v_beta: float) -> tuple[float, float]:
    """The vector that is left where pulses that are too short are left out."""
    if p.shortest <= 0.0:
        return v_alpha, v_beta
    v = _phases(v_alpha, v_beta)
    zero = 0.5 * (max(v[0], v[1], v[2]) + min(v[0], v[1], v[2]))
    duty = np.empty(3)
    for n in range(3):
        duty[n] = min(1.0, max(0.0, 0.5 + (v[n] - zero) / p.bus_v))
        if duty[n] < p.shortest:
            duty[n] = 0.0
        elif duty[n] > 1.0 - p.shortest:
            duty[n] = 1.0
    return p.bus_v * (2 * duty[0] - duty[1] - duty[2]) / 3, p.bus_v * (duty[1] - duty[2]) / SQRT3


@njit(cache=True, nogil=True)
def run(
    p: Plant, c: Array, grid: Array, table: Array, memory: Array, charge: Array, hall: Array, y: Array, believed: float,
    mode: int, gains: Array, wanted: Array, wave: Array, noise: Array, i_out: Array, v_out: Array,
) -> None:  # fmt: skip
    """Run the drive sample by sample; a row holds the current read at t_k and the voltage held from then on.

    Parameters
    ----------
    mode : int
        `CONTROL`: currents `wanted` (samples, 2) by a PI controller, plus the voltages `wave`. `OPEN`: the voltages
        `wanted` plus `wave`. `OFF`: no gate is on.
    gains : array (4,)
        Proportional gains on d and q [V/A], integral gains [V/(A s)].
    """
    cos, sin = math.cos(believed), math.sin(believed)
    work = np.zeros((5, STATES))
    ts, top_v = p.sample_s, p.bus_v / SQRT3
    h = ts / p.substeps
    whole = int(p.delay_samples + 1e-9)
    part = p.delay_samples - whole
    for k in range(wanted.shape[0]):
        flows = mode != OFF
        read_a = _read(p, y, 0, p.gain_a, p.offset_a, noise[k, 0], flows)
        read_b = _read(p, y, 1, p.gain_b, p.offset_b, noise[k, 1], flows)
        if p.shunts > 0.0 and flows:
            read_c = _read(p, y, 2, p.gain_c, p.offset_c, noise[k, 2], flows)
            # The command that acts while the current is read.
            v_a, v_b, v_c = _phases(y[LATE], y[LATE + 1])
            if v_a >= v_b and v_a >= v_c:
                read_a = -read_b - read_c
            elif v_b >= v_a and v_b >= v_c:
                read_b = -read_a - read_c
        i_alpha, i_beta = read_a, (read_a + 2 * read_b) / SQRT3
        i_out[k, 0], i_out[k, 1] = i_alpha, i_beta
        v_d = v_q = 0.0
        if mode == CONTROL:
            off_d = wanted[k, 0] - cos * i_alpha - sin * i_beta
            off_q = wanted[k, 1] - cos * i_beta + sin * i_alpha
            y[PULL] += gains[2] * ts * off_d
            y[PULL + 1] += gains[3] * ts * off_q
            v_d, v_q = gains[0] * off_d + y[PULL] + wave[k, 0], gains[1] * off_q + y[PULL + 1] + wave[k, 1]
            length = math.sqrt(v_d * v_d + v_q * v_q)
            if length > top_v:
                v_d, v_q = v_d * top_v / length, v_q * top_v / length
        elif mode == OPEN:
            v_d, v_q = wanted[k, 0] + wave[k, 0], wanted[k, 1] + wave[k, 1]
        v_out[k, 0], v_out[k, 1] = cos * v_d - sin * v_q, sin * v_d + cos * v_q
        before_alpha, before_beta = y[LATE], y[LATE + 1]
        older_alpha, older_beta = y[LATE + 2], y[LATE + 3]
        now_alpha, now_beta = _impressed(p, v_out[k, 0], v_out[k, 1])
        y[LATE + 2], y[LATE + 3], y[LATE], y[LATE + 1] = before_alpha, before_beta, now_alpha, now_beta
        if not flows:
            continue
        if whole >= 1:
            now_alpha, now_beta, before_alpha, before_beta = before_alpha, before_beta, older_alpha, older_beta
        if part > 0.0:
            _advance(
                p, c, grid, table, memory, charge, hall, y, work, before_alpha, before_beta, believed, part * ts
            )  # fmt: skip
            for _ in range(p.substeps):
                _advance(
                    p, c, grid, table, memory, charge, hall, y, work, now_alpha, now_beta, believed, (1 - part) * h
                )  # fmt: skip
            continue
        for _ in range(p.substeps):
            _advance(p, c, grid, table, memory, charge, hall, y, work, now_alpha, now_beta, believed, h)
