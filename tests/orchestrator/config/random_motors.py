"""Motors at random within what data sheets hold, from a micro servo to a traction drive; nothing of `check` is in them.

A draw fixes voltage, speed, the magnet's share of the voltage, the reactances and the copper loss; the rated current is
that which makes the rated torque along its best angle (T = 3/2 p (psi i_q + (L_d - L_q) i_d i_q)). Draws whose power
factor or terminal voltage no machine has are thrown away.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from protocols import Motor

Range = tuple[float, float]


@dataclass(frozen=True)
class Kind:
    """Ranges of one kind of machine, drawn evenly in their logarithms.

    Attributes
    ----------
    power_w, voltage_v, speed_rpm, pole_pairs : (low, high)
    emf : (low, high)
        omega psi over the phase voltage; (0, 0): no magnet.
    reactance : (low, high)
        omega L_q I over the phase voltage.
    saliency : (low, high)
        L_q / L_d.
    copper : (low, high)
        Copper loss over the rated power.
    """

    power_w: Range
    voltage_v: Range
    speed_rpm: Range
    pole_pairs: Range
    emf: Range
    reactance: Range
    saliency: Range
    copper: Range


KINDS = {
    name: Kind(*ranges)
    for name, ranges in {
        "micro servo": ((3, 60), (6, 30), (4e3, 3e4), (1, 4), (0.6, 0.9), (0.01, 0.15), (1, 1), (0.1, 0.35)),
        "outrunner": ((80, 3e3), (8, 40), (400, 8e3), (7, 15), (0.6, 0.9), (0.08, 0.5), (0.95, 1.15), (0.05, 0.2)),
        "servo": ((50, 5e3), (30, 380), (2e3, 6e3), (3, 5), (0.5, 0.85), (0.08, 0.5), (0.95, 1.2), (0.04, 0.2)),
        "pump": (
            (750, 3e4),
            (200, 400),
            (1e3, 3600),
            (2, 5),
            (0.6, 0.9),
            (0.3, 0.8),
            (1.2, 2.5),
            (0.02, 0.07),
        ),
        "traction": ((1e4, 2e5), (60, 350), (2.5e3, 8e3), (3, 6), (0.3, 0.75), (0.3, 0.9), (1.5, 3.5), (0.008, 0.04)),
        "assisted": ((750, 3e4), (200, 400), (1e3, 3e3), (2, 3), (0.1, 0.45), (0.6, 1.3), (3, 8), (0.02, 0.08)),
        "reluctance": ((750, 3e4), (200, 400), (1e3, 3e3), (2, 3), (0, 0), (0.2, 0.4), (0.15, 0.3), (0.02, 0.08)),
    }.items()
}
"""Of data sheets of coreless servos, hobby motors and hubs, servo families, pumps, cars, and reluctance machines."""


def random_motors(seed: int, count: int) -> Iterator[Motor]:
    """So many motors, the kinds in turn."""
    random = np.random.default_rng(seed)
    kinds = list(KINDS.items())
    made = 0
    while made < count:
        name, kind = kinds[made % len(kinds)]
        drawn = _drawn(random, kind)
        if drawn is not None:
            yield Motor.model_validate({"name": f"{name} {made}", **drawn})
            made += 1


def _within(random: np.random.Generator, limits: Range) -> float:
    low, high = limits
    return low if low == high else float(np.exp(random.uniform(math.log(low), math.log(high))))


def _drawn(random: np.random.Generator, kind: Kind) -> dict[str, float] | None:
    """The nameplate of one draw, three figures each; None where no machine is like that."""
    power_w, volts = _within(random, kind.power_w), _within(random, kind.voltage_v)
    pairs = round(_within(random, kind.pole_pairs))
    speed_rpm = _within(random, kind.speed_rpm)
    omega = 2.0 * math.pi * speed_rpm / 60.0 * pairs
    phase_v = math.sqrt(2.0 / 3.0) * volts
    emf, reactance, saliency = (_within(random, one) for one in (kind.emf, kind.reactance, kind.saliency))
    psi = emf * phase_v / omega
    torque = power_w / (omega / pairs)
    angle = np.linspace(0.0, math.pi, 721)

    def most_torque(peak_a: float) -> tuple[float, float, float]:
        """Largest torque, and i_d, i_q at it."""
        l_q = reactance * phase_v / (omega * peak_a)
        i_d, i_q = peak_a * np.cos(angle), peak_a * np.sin(angle)
        made = 1.5 * pairs * (psi + (l_q / saliency - l_q) * i_d) * i_q
        best = int(np.argmax(made))
        return float(made[best]), float(i_d[best]), float(i_q[best])

    # Reactances scale with the current, so torque is proportional to it; data sheets leave it something in hand.
    peak_a = torque * float(random.uniform(0.95, 1.25)) / most_torque(1.0)[0]
    _, d, q = most_torque(peak_a)
    l_q = reactance * phase_v / (omega * peak_a)
    l_d = l_q / saliency
    ohm = _within(random, kind.copper) * power_w / (1.5 * peak_a**2)
    needed_v = math.hypot(ohm * d - omega * l_q * q, ohm * q + omega * (l_d * d + psi))
    factor = power_w / (1.5 * phase_v * peak_a)
    if not (0.7 * phase_v < needed_v < 1.1 * phase_v and 0.45 < factor < 0.97):
        return None
    values = {
        "rated_power_w": power_w,
        "rated_voltage_rms_v": volts,
        "rated_current_rms_a": peak_a / math.sqrt(2.0),
        "rated_frequency_hz": omega / (2.0 * math.pi),
        "rated_torque_nm": torque,
        "rated_speed_rpm": speed_rpm,
        "stator_resistance_ohm": ohm,
        "d_inductance_h": l_d,
        "q_inductance_h": l_q,
        "pm_flux_wb": psi,
    }
    return {"pole_pairs": pairs, **{name: float(f"{value:.3g}") for name, value in values.items() if value > 0.0}}
