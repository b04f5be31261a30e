"""Benches whose bridge switches: a healthy one, and what the averaged sizes of an ordinary one are behind a bridge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.blind.campaign import Bench
from tests.blind.effects import Rng
from tests.blind.magnetics import PM400
from tests.blind.switched import Bridge

HARDLY_THERE = ("voltage_delay", "current_filter")
"""What a reading in the carrier's valley hardly shows: between edges the current stands still but for its decay."""


FIRM = 300.0
"""Power of a hysteresis' yielding behind a bridge: at less, the flux's own ripple of each carrier period lets a soft
Bouc-Wen loop creep shut, which no iron does. At 1.1 and 1 mWb, 13 % of it is left; at 12, where it was until a
diagnosis called it unknown, loops of 20.9 mA were 17.4 mA wide, and the flux crept through each hold."""


def healthy(bench: Bench) -> Bench:
    """Edges without any loss, currents read in the valley."""
    return replace(bench, bridge=Bridge(half_s=0.5 / bench.machine.sampling_hz))


def imperfect(rng: Rng, bench: Bench) -> tuple[Bench, tuple[str, ...]]:
    """The bench with its inverter's losses as a bridge has them, and what else such a bridge brings along, by name."""
    p, machine = bench.plant, bench.machine
    dead_s = p.dead_v / (machine.sampling_hz * machine.bus_v)
    per_pm400 = machine.top_a / PM400.top_a * PM400.bus_v / machine.bus_v
    late_s = float(rng.choice([0.0, 1.0]) * rng.uniform(-4e-6, 4e-6))
    gain = float(rng.choice([0.0, 1.0, 1.0 + rng.normal(0.0, 0.005)]))
    mismatch, offset = abs(p.gain_a - p.gain_b), max(abs(p.offset_a), abs(p.offset_b))
    third = bool(rng.random() < 0.5)
    bridge = Bridge(
        half_s=0.5 / machine.sampling_hz,
        dead_s=dead_s,
        dead_a_s=dead_s,
        charge_c=2.0 * float(np.exp(rng.uniform(*np.log((40e-12, 300e-12))))) * machine.bus_v * per_pm400,
        slow_s_per_a=rng.uniform(0.0, 2e-9) / per_pm400,
        switch_v=p.drop_v * rng.uniform(0.85, 1.1),
        diode_v=p.drop_v * rng.uniform(0.9, 1.2),
        knee_a=p.drop_a * rng.uniform(0.2, 1.0),
        switch_ohm=machine.resistance_ohm * rng.uniform(0.0, 0.02),
        diode_ohm=machine.resistance_ohm * rng.uniform(0.0, 0.02),
        heat_k_per_w=rng.uniform(0.5, 3.0),
        heat_s=rng.uniform(0.5, 5.0),
        v_per_k=-0.002,
        shortest_s=max(1e-6, 3.0 * dead_s),
        tick_s=rng.uniform(5e-9, 30e-9),
        source_ohm=p.sag_per_watt * machine.bus_v**2,
        bus_f=rng.uniform(0.2e-3, 1.5e-3) * per_pm400,
        bus_gain=gain,
        late_s=late_s,
        gain_c=1.0 + rng.normal(0.0, 0.5) * mismatch if third else 0.0,
        offset_c=rng.normal(0.0, 0.7) * offset if third else 0.0,
    )
    plant = p._replace(
        dead_v=0.0, drop_v=0.0, sag_per_watt=0.0, eddy_s=rng.uniform(0.7, 2.5) / machine.sampling_hz,
        eddy_q=rng.uniform(0.7, 1.4), loop_power=FIRM,
    )  # fmt: skip
    brought = ["duty_quantum", "minimum_pulse"]
    brought += ["sampling_offset"] if late_s else []
    brought += ["bus_gain"] if gain not in (0.0, 1.0) else []
    brought += ["third_current_sensor"] if third else []
    return replace(bench, plant=plant, bridge=bridge), tuple(brought)
