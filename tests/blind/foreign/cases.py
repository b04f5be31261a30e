"""What is hidden in a foreign recording: one case from a class, an index and a seed, and its physical truth.

Sizes are relative to the machine, so that each is met on benches of any power.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from tests.blind.foreign.inverter import charge_table
from tests.blind.foreign.iron import Array
from tests.blind.foreign.machines import FAMILIES, Motor, draw_motor
from tests.blind.foreign.plans import PLANS
from tests.blind.foreign.plant import BRANCHES, Plant
from tests.blind.foreign.preisach import everett, half_width
from tests.blind.foreign.record import Rig

Rng = np.random.Generator
KINDS = ("clean", "single", "double", "ordinary", "no_catalogue", "plans")
USUAL_PLANS = ("standard", "one_angle", "slow_ramps")
"""Of all classes but the last."""
TWINS = ({"voltage_delay", "current_filter"}, {"dead_time", "device_drop"}, {"current_offset", "voltage_bias"})
"""Effects that a plan may not be able to tell apart: a double does not hide both."""
ORDINARY = (0.03, 0.5)
"""Sizes on an ordinary bench, in units of the typical one."""


@dataclass(frozen=True)
class Truth:
    """One hidden effect.

    Attributes
    ----------
    amounts : dict
        What it amounts to in physical terms, each as its lowest and highest value where the form has a range.
    """

    name: str
    size: float
    amounts: dict[str, tuple[float, float]] = field(default_factory=dict)

    def __str__(self) -> str:
        return f"{self.name} x{self.size:.2g}"


@dataclass(frozen=True)
class Case:
    """One recording to be made, and what is hidden in it."""

    kind: str
    index: int
    family: str
    rig: Rig
    truths: tuple[Truth, ...] = ()
    foreign: str | None = None
    without: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        """What `python -m tests.blind.foreign --make` takes."""
        return f"{self.kind}:{self.index}"

    @property
    def judged_as(self) -> str:
        """Its class; `single` where it was drawn as in no catalogue and is in one by now."""
        return "single" if self.kind == "no_catalogue" and self.truths else self.kind

    @property
    def hidden(self) -> str:
        """In words."""
        largest = sorted(self.truths, key=lambda truth: -truth.size)
        words = [str(truth) for truth in largest[:3]] + ([self.foreign] if self.foreign and not self.truths else [])
        words += [f"and {len(largest) - 3} up to {largest[3].size:.2g}"] if len(largest) > 3 else []
        return ", ".join(words) or "nothing"


@dataclass(frozen=True)
class Changes:
    """What an effect does to the rig, and what it amounts to."""

    plant: dict[str, Any]
    amounts: dict[str, tuple[float, float]]
    tables: dict[str, Any] = field(default_factory=dict)


def _sign(rng: Rng) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _rated_a(m: Motor) -> float:
    return float(np.sqrt(2.0) * m.plate.rated_current_rms_a)


def _eddy(rng: Rng, size: float, m: Motor) -> Changes:
    """Half-order: conductances with the root of their time constants from 30 us to 5 to 20 ms.

    Sources: G. Bertotti, IEEE Trans. Magn. 24 (1988) 621, doi:10.1109/20.43994 (loss that grows with the power 1.5 of
    the frequency); the ladder: A. Oustaloup et al., IEEE Trans. Circuits Syst. I 47 (2000), doi:10.1109/81.817385.
    """
    slow, fast, omega = float(rng.uniform(5e-3, 2e-2)), 3e-5, 2 * np.pi * m.plate.injection_hz
    tau = slow * (fast / slow) ** (np.arange(BRANCHES) / (BRANCHES - 1))
    shares = np.sqrt(tau / slow) / (1 + (omega * tau) ** 2)
    siemens = 0.25 * size / (omega * m.plate.l_q_h)
    return Changes(
        {"eddy_siemens": siemens / float(shares.sum()), "eddy_slow_s": slow, "eddy_fast_s": fast},
        {"loss at the injection's frequency, 1/ohm": (siemens, siemens)},
    )


def _hysteresis(rng: Rng, size: float, m: Motor) -> Changes:
    """A vector Preisach model; see `preisach`."""
    table = everett(float(rng.uniform(0.03, 0.1)), float(rng.uniform(0.4, 0.7)), float(rng.uniform(0.3, 0.5)))
    rest, top = m.iron.flux(0.0, 0.0), m.plate.top_a
    reach_d = max(abs(m.iron.flux(s * top, 0.0)[0] - rest[0]) for s in m.span_d)
    reach_q = m.iron.flux(0.0, top)[1]
    largest = 2.0 * max(reach_d, reach_q)
    widths = [half_width(table, reach / largest) for reach in (reach_d, reach_q)]
    half = 0.02 * size * _rated_a(m)
    scale = half / float(np.mean(widths))
    ends = sorted(scale * width for width in widths)
    return Changes(
        {"held_a": scale, "held_per_wb": 1.0 / largest, "magnet_wb": rest[0]},
        {"half the loop's width, A": (ends[0], ends[1])},
        {"relays": table},
    )


def _dead_time(rng: Rng, size: float, m: Motor) -> Changes:
    """Decided by the charge of the output capacitances; see `inverter`."""
    volts = 0.008 * size * m.plate.bus_v
    table = charge_table(float(rng.uniform(0.4, 0.9)), float(rng.uniform(0.05, 0.2)))
    knee = float(np.exp(rng.uniform(np.log(0.005), np.log(0.05)))) * _rated_a(m)
    return Changes({"dead_v": volts, "dead_a": knee}, {"lost at large currents, V": (volts, volts)}, {"charge": table})


def _device_drop(rng: Rng, size: float, m: Motor) -> Changes:
    """Its knee is an inverse hyperbolic sine."""
    volts, knee = size * (0.9 if m.plate.bus_v > 100 else 0.3), float(rng.uniform(0.002, 0.02)) * _rated_a(m)
    if m.plate.rated_current_rms_a > 50:
        knee *= 0.3
    per_asinh = 1.0 / float(np.arcsinh(_rated_a(m) / knee))
    return Changes(
        {"knee_v": volts, "knee_a": knee, "knee_per_asinh": per_asinh}, {"drop at the rated current, V": (volts, volts)}
    )


def _brake(rng: Rng, size: float, m: Motor) -> Changes:
    """A spring with LuGre bristles: C. Canudas de Wit, H. Olsson, K. J. Astrom, P. Lischinsky, IEEE Trans. Autom.
    Control 40 (1995), doi:10.1109/9.376053."""
    torque = m.plate.rated_torque_nm
    radians, friction = np.deg2rad(0.8 * size), float(rng.uniform(0.03, 0.15))
    return Changes(
        {
            "spring_per_nm": radians / torque, "resonance": 2 * np.pi * float(rng.uniform(150, 600)),
            "damping": float(rng.uniform(0.1, 0.5)), "friction_nm": friction * torque,
            "breakaway": float(rng.uniform(1.1, 1.5)), "bristle_rad": 0.2 * friction * radians,
        },
        {"twist at the rated torque, degrees": (0.8 * size * (1 - 1.5 * friction), 0.8 * size)},
    )  # fmt: skip


def _bus_sag(rng: Rng, size: float, m: Motor) -> Changes:
    """A line and a link, each a resistor with a capacitor behind it.

    Less voltage draws less power at one current: over the command's power the sag is smaller by itself, up to three
    times the copper's at one axis' largest current, with both axes and the magnetising power.
    """
    copper_w = 1.5 * m.plate.resistance_ohm * m.plate.top_a**2
    per_watt = 0.006 * size / copper_w
    ohm, share = per_watt * m.plate.bus_v**2, float(rng.uniform(0.5, 0.85))
    return Changes(
        {
            "line_ohm": share * ohm, "line_f": float(rng.uniform(2e-3, 15e-3)) / (share * ohm),
            "link_ohm": (1 - share) * ohm, "link_f": float(rng.uniform(1e-4, 6e-4)) / ((1 - share) * ohm),
        },
        {"sag, 1/W": (per_watt * (1 - 0.018 * size), per_watt)},
    )  # fmt: skip


def _heating(rng: Rng, size: float, m: Motor) -> Changes:
    """Copper in its slot and the iron around it, a ladder of heat capacities."""
    copper_w = 1.5 * m.plate.resistance_ohm * (0.5 * m.plate.top_a) ** 2
    fast, slow = float(rng.uniform(10, 40)), float(rng.uniform(150, 500))
    kelvin = 15.0 * size / copper_w
    return Changes(
        {
            "slot_k_per_w": 0.5 * kelvin, "copper_j_per_k": fast / (0.5 * kelvin),
            "room_k_per_w": kelvin, "iron_j_per_k": slow / kelvin,
        },
        {},
    )  # fmt: skip


def _hall(rng: Rng, size: float, m: Motor) -> Changes:
    """Sensors of second order: s^2 / w^2 + 2 z s / w + 1."""
    lag, z = 15e-6 * size * 500.0 / m.plate.injection_hz, float(rng.uniform(0.5, 0.9))
    return Changes({"hall": 1.0}, {"lag, s": (lag, lag)}, {"hall": hall_transition(2 * z / lag, z, _step_s(m))})


def hall_transition(w: float, z: float, h: float) -> Array:
    """A step of h under an input that goes straight: columns of (x, dx/dt / w), input before, input after."""
    from scipy.linalg import expm

    system = np.zeros((4, 4))
    system[0, 1], system[1, 0], system[1, 1], system[1, 2] = w, -w, -2 * z * w, w
    system[2, 3] = 1.0 / h
    whole = expm(system * h)
    return np.ascontiguousarray(
        np.stack([whole[:2, 0], whole[:2, 1], whole[:2, 2] - whole[:2, 3], whole[:2, 3]], axis=1)
    )


SUBSTEPS = 4


def _step_s(m: Motor) -> float:
    return 1.0 / (SUBSTEPS * m.plate.sampling_hz)


def _gain_mismatch(rng: Rng, size: float, m: Motor) -> Changes:
    g = 0.01 * size * _sign(rng)
    return Changes({"gain_a": 1 + g / 2, "gain_b": 1 - g / 2}, {"gain of a minus b": (g, g)})


def _misalignment(rng: Rng, size: float, m: Motor) -> Changes:
    degrees = 1.5 * size * _sign(rng)
    return Changes({"misaligned": np.deg2rad(degrees)}, {"angle, degrees": (degrees, degrees)})


def _offset(rng: Rng, size: float, m: Motor) -> Changes:
    a, b = 0.006 * size * _rated_a(m) * np.array([_sign(rng), rng.uniform(-1, 1)])
    return Changes({"offset_a": float(a), "offset_b": float(b)}, {"offset of a, A": (a, a), "offset of b, A": (b, b)})


def _delay(rng: Rng, size: float, m: Motor) -> Changes:
    late = 15e-6 * size * 500.0 / m.plate.injection_hz
    return Changes({"delay_samples": late * m.plate.sampling_hz}, {"lag, s": (late, late)})


EFFECTS: dict[str, tuple[Callable[[Rng, float, Motor], Changes], float, float]] = {
    "eddy_currents": (_eddy, 0.5, 2.0),
    "hysteresis": (_hysteresis, 0.4, 1.8),
    "dead_time": (_dead_time, 0.1, 2.0),
    "device_drop": (_device_drop, 0.6, 1.4),
    "brake_compliance": (_brake, 0.4, 2.5),
    "bus_sag": (_bus_sag, 0.5, 2.0),
    "winding_heating": (_heating, 0.5, 2.0),
    "current_filter": (_hall, 0.5, 2.5),
    "current_gain_mismatch": (_gain_mismatch, 0.3, 3.0),
    "rotor_misalignment": (_misalignment, 0.4, 2.5),
    "current_offset": (_offset, 0.5, 3.0),
    "voltage_delay": (_delay, 0.5, 3.0),
}
"""Effects that the library has, in forms of their own: how a size changes the rig, the smallest and the largest."""


def _shunts(rng: Rng, m: Motor) -> dict[str, Any]:
    a, b, c = rng.permutation([-1.0, 0.2, 1.0]) * rng.uniform(0.005, 0.015)
    return {"shunts": 1.0, "gain_a": 1 + a, "gain_b": 1 + b, "gain_c": 1 + c}


NO_CATALOGUE: dict[str, Callable[[Rng, Motor], dict[str, Any]]] = {
    "shunts_of_unequal_gain": _shunts,
    "sensor_remanence": lambda r, m: {"core_a": r.uniform(0.004, 0.012) * _rated_a(m)},
    "shorted_turn": lambda r, m: {
        "turn_s": r.uniform(1e-4, 4e-4),
        "turn_siemens": r.uniform(0.3, 0.8) / (2 * np.pi * m.plate.injection_hz * min(m.plate.l_d_h, m.plate.l_q_h)),
    },
    "lost_rows": lambda r, m: {"lost_rows": r.uniform(2e-4, 1e-3)},
    "warming_shunts": lambda r, m: {
        "shunt_per_a2": r.uniform(0.01, 0.03) / _rated_a(m) ** 2, "shunt_s": r.uniform(0.3, 2.0),
    },
}  # fmt: skip
"""Three low-side shunts of which the leg with the largest command is reconstructed, a sensor's core that stays
magnetised, a turn of phase a that is shorted, rows that a logger loses, shunts that warm up: in no catalogue."""


def _shunt_reconstruction(p: Plant) -> Truth:
    gains = np.array([p.gain_a, p.gain_b, p.gain_c])
    a, b, c = (float(g) for g in gains / gains.mean())
    two, third = a - b, c - 0.5 * (a + b)
    amounts = {"gain of a minus b": (two, two), "gain of c minus a and b": (third, third)}
    return Truth("shunt_reconstruction", max(abs(two), abs(third)) / 0.01, amounts)


SINCE_IN_CATALOGUE: dict[str, Callable[[Plant], Truth]] = {"shunts_of_unequal_gain": _shunt_reconstruction}
"""Of these, what the library has by now. A case is judged like a single effect, and drawn as before: other cases of a
seed stay what they are."""


def draw_case(kind: str, index: int, seed: int) -> Case:
    """The case of a class with this number; raises `ValueError` for a class that there is not."""
    if kind not in KINDS:
        raise ValueError(f"{kind!r}: there is {', '.join(KINDS)}")
    rng = np.random.default_rng([seed, zlib.crc32(f"foreign {kind}".encode()), index])
    names, families = list(EFFECTS), list(FAMILIES)
    family = families[index % len(families)] if kind == "clean" else str(rng.choice(families))
    plan = str(rng.choice(USUAL_PLANS))
    hidden: list[tuple[str, float | None]] = []
    foreign = None
    if kind == "single":
        hidden = [(names[index % len(names)], None)]
    elif kind == "double":
        hidden = [(str(name), None) for name in rng.choice(names, 2, replace=False)]
        while {name for name, _ in hidden} in TWINS:
            hidden = [(str(name), None) for name in rng.choice(names, 2, replace=False)]
    elif kind == "ordinary":
        hidden = [(name, float(np.exp(rng.uniform(*np.log(ORDINARY))))) for name in names]
    elif kind == "no_catalogue":
        foreign = list(NO_CATALOGUE)[index % len(NO_CATALOGUE)]
    elif kind == "plans":
        plan = list(PLANS)[1:][index % (len(PLANS) - 1)]
        hidden = [(str(rng.choice(names[:10])), None)] if rng.random() < 0.7 else []
    motor = draw_motor(rng, family)
    plate = motor.plate
    plant = Plant(
        sample_s=1.0 / plate.sampling_hz, substeps=SUBSTEPS, pole_pairs=float(plate.pole_pairs),
        resistance=plate.resistance_ohm * rng.uniform(0.96, 1.1), bus_v=plate.bus_v,
        noise_a=plate.noise_a * rng.uniform(0.6, 1.5), quantum_a=plate.quantum_a * rng.uniform(0.0, 2.0),
        shortest=float(rng.uniform(0.005, 0.02)) if kind == "ordinary" else 0.0,
    )  # fmt: skip
    rig = Rig(
        motor, plant, plan, int(rng.integers(2**31)), float(rng.uniform(-np.pi, np.pi)), float(rng.choice([0.0, 1.0]))
    )
    truths = []
    for name, size in hidden:
        build, low, high = EFFECTS[name]
        drawn = float(np.exp(rng.uniform(np.log(low), np.log(high)))) if size is None else size
        changes = build(rng, drawn, motor)
        rig = replace(rig, plant=rig.plant._replace(**changes.plant), **changes.tables)
        truths.append(Truth(name, drawn, changes.amounts))
    if foreign is not None:
        odd = NO_CATALOGUE[foreign](rng, motor)
        lost = odd.pop("lost_rows", 0.0)
        rig = replace(rig, plant=rig.plant._replace(**odd), lost_rows=lost)
        truths += [SINCE_IN_CATALOGUE[foreign](rig.plant)] if foreign in SINCE_IN_CATALOGUE else []
    return Case(kind, index, family, rig, tuple(truths), foreign)
