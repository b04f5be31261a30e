"""The laws that may be hidden: twenty kinds, each with constants drawn by a seed, and what names it rightly."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from tests.laws import plant as of
from tests.laws.plant import Machine

Rng = np.random.Generator


@dataclass(frozen=True)
class Hidden:
    """A law: where it enters, over what, in which phase, and its constants.

    Attributes
    ----------
    law : int
        Of the plant.
    place, quantity, phase : str
        As the search names them; `phase` is empty for all.
    constants : (float, float)
    formula : str
        With its units, as a person reads it.
    same : tuple of (str, str)
        Other places and quantities that are the same law.
    """

    law: int
    place: str
    quantity: str
    phase: str
    constants: tuple[float, float]
    formula: str = ""
    same: tuple[tuple[str, str], ...] = ()

    @property
    def names(self) -> tuple[tuple[str, str, str], ...]:
        """Place, quantity and phase, by which a search may name it."""
        return tuple((*one, self.phase) for one in ((self.place, self.quantity), *self.same))


def _between(rng: Rng, low: float, high: float) -> float:
    return float(f"{np.exp(rng.uniform(np.log(low), np.log(high))):.3g}")


def _leg(law: int, first: tuple[float, float], second: tuple[float, float], text: str, **more: str) -> Draw:
    """A voltage over a leg's own current, in one phase."""

    def draw(rng: Rng) -> Hidden:
        constants = (_between(rng, *first), _between(rng, *second))
        place, quantity = more.get("place", "leg_voltage"), more.get("quantity", "phase_currents")
        return Hidden(law, place, quantity, str(rng.choice(list("abc"))), constants, text)

    return draw


def _sensor(law: int, quantity: str, first: tuple[float, float], second: tuple[float, float], text: str) -> Draw:
    """An error of one of both sensors."""

    def draw(rng: Rng) -> Hidden:
        constants = (_between(rng, *first), _between(rng, *second))
        place = "reading_gain" if quantity == "time" else "reading"
        return Hidden(law, place, quantity, str(rng.choice(list("ab"))), constants, text)

    return draw


def _whole(
    law: int,
    place: str,
    quantity: str,
    first: tuple[float, float],
    second: tuple[float, float],
    text: str,
    same: tuple[tuple[str, str], ...] = (),
) -> Draw:
    """A law of all phases."""

    def draw(rng: Rng) -> Hidden:
        return Hidden(law, place, quantity, "", (_between(rng, *first), _between(rng, *second)), text, same)

    return draw


Draw = Callable[[Rng], Hidden]
KINDS: Mapping[str, Draw] = {
    "poor_contact": _leg(of.POOR_CONTACT, (0.2, 0.8), (0.2, 0.8), "a (i/b) / (1 + (i/b)^2) in one leg"),
    "asinh_drop": _leg(of.ASINH_LEG, (0.08, 0.3), (0.05, 0.3), "a asinh(i/b) in one leg"),
    "quadratic_drop": _whole(
        of.SQUARE_LEGS, "leg_voltage", "phase_currents", (0.05, 0.2), (1.0, 1.0), "a i^2 in each leg"
    ),
    "slow_leg": _leg(
        of.SLOW_LEG, (0.3, 1.0), (0.05, 0.2), "a tanh(i/b) in one leg, at twice the PWM frequency twice as much",
        place="pulse_voltage",
    ),
    "growing_drop": _leg(
        of.GROWING_DROP, (0.5, 1.5), (0.1, 0.5), "a tanh(i/b) t/60 s in one leg", place="leg_voltage_by_time"
    ),
    "sensor_crosstalk": _sensor(of.CROSSTALK, "next_phase_currents", (0.02, 0.06), (0.5, 2.0), "a tanh(i_next/b)"),
    "saturating_sensor": _sensor(of.CLIP, "phase_currents", (0.03, 0.1), (1.2, 2.2), "-a max(|i| - b, 0) sgn(i)"),
    "quadratic_sensor": _sensor(of.SQUARE_SENSOR, "phase_currents", (0.004, 0.015), (1.0, 1.0), "a i^2"),
    "magnitude_offset": _sensor(of.MAGNITUDE_OFFSET, "current", (0.008, 0.03), (1.0, 1.0), "a |i|"),
    "gain_settles": _sensor(of.GAIN_SETTLES, "time", (0.01, 0.03), (6.0, 20.0), "gain a (1 - exp(-t/b))"),
    "slope_pick_up": _sensor(of.PICK_UP, "current_slopes", (0.01, 0.03), (3.0, 30.0), "a tanh(di/dt / b)"),
    "sensor_remanence": _whole(
        of.PLAY, "reading", "phase_currents", (0.01, 0.03), (0.02, 0.06), "a/b (i - i with a play of b)",
        (("reading", "smooth_currents"),),
    ),
    "bus_dependent_gain": _whole(
        of.BUS_GAIN, "voltage_gain", "link_voltage", (0.1, 0.3), (1.0, 1.0), "lost: a (v_dc/540 V - 1) of the voltage"
    ),
    "joint_loosens": _whole(of.RAMP, "resistance", "time", (0.2, 0.6), (15.0, 35.0), "a max(t/b - 1, 0)"),
    "heated_leg": _leg(
        of.HEATED_LEG, (0.0005, 0.002), (5.0, 15.0), "ohms a W, dW/dt = P - W/b, in one leg", place="leg_resistance",
        quantity="heat",
    ),
    "load_angle": _whole(
        of.LOAD_ANGLE, "angle", "current_q", (0.01, 0.03), (0.5, 1.5), "a tanh(i_q/b)", (("angle", "torque"),)
    ),
    "resolver_error": _whole(
        of.RESOLVER, "angle", "rotor_angle", (0.01, 0.04), (0.2, 6.0), "a sin(2 theta + b), six positions"
    ),
    "brake_creeps": _whole(of.CREEP, "angle", "time", (0.02, 0.06), (6.0, 20.0), "a (1 - exp(-t/b))"),
    "magnet_warms": _whole(
        of.WARM_MAGNET, "magnetising_d", "heat", (0.05, 0.2), (100.0, 400.0), "i_d more by a (1 - exp(-W/b))"
    ),
    "shorted_turn": _leg(
        of.TURN, (0.6, 1.8), (2e-4, 8e-4), "a (psi - psi lagging by b) in one phase", place="magnetising",
        quantity="phase_fluxes",
    ),
}  # fmt: skip


def draw(kind: str, seed: int) -> tuple[Hidden, Machine]:
    """A kind's law and its machine, which follow from the seed alone."""
    rng = np.random.default_rng([seed, zlib.crc32(kind.encode())])
    hidden = KINDS[kind](rng)
    if kind == "shorted_turn":
        hidden = Hidden(hidden.law, hidden.place, hidden.quantity, "a", hidden.constants, hidden.formula)
    machine = Machine(
        magnet_wb=0.30 * rng.uniform(0.95, 1.05),
        resistance_ohm=4.4 * rng.uniform(0.95, 1.1),
        l_d_h=0.042 * rng.uniform(0.95, 1.05),
        l_q_h=0.067 * rng.uniform(0.95, 1.05),
        noise_a=2e-3 * rng.uniform(0.7, 1.5),
    )
    return hidden, machine
