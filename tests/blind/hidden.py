"""What may be hidden in a recording: the catalogue's effects in forms of their own, foreign ones, and nuisances.

A `Case` follows from a class, an index and a seed alone. Sizes are those of the 400 W machine and are scaled to others;
the catalogue's are drawn log-uniformly from its ranges.
"""

from __future__ import annotations

import dataclasses
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from tests.blind.campaign import Bench, Campaign
from tests.blind.effects import CATALOGUE, FOREIGN, IN_THE_LIBRARY, Rng
from tests.blind.magnetics import PM400, SERVO_48V, TRACTION_28KW, Machine, draw_table
from tests.blind.plant import HEALTHY, Plant
from tests.blind.switched_bench import HARDLY_THERE, healthy, imperfect

Hidden = Sequence[tuple[str, float | None]]
"""Names, and sizes in units of the typical one where they are not drawn."""


@dataclass(frozen=True)
class Truth:
    """One effect as it is hidden: its parameters as the catalogue names them, where both mean the same."""

    name: str
    size: float
    """In units of the catalogue's typical size."""
    parameters: Mapping[str, float] = field(default_factory=dict)
    changes: Mapping[str, float] = field(default_factory=dict)
    """What it does to the plant and its table."""

    def __str__(self) -> str:
        return f"{self.name} x{self.size:.2g}"


@dataclass(frozen=True)
class Case:
    """One recording to be made, and what is hidden in it."""

    kind: str
    index: int
    about: str
    bench: Bench
    campaign: Campaign
    family: str
    truths: tuple[Truth, ...] = ()
    foreign: str | None = None
    nuisance: str | None = None
    without: tuple[str, ...] = ()
    brought: tuple[str, ...] = ()
    """What a bridge that switches has beside the truths: names that are not false."""

    @property
    def label(self) -> str:
        """What `python -m tests.blind --make` takes."""
        return f"{self.kind}:{self.index}" + (f":{self.about}" if self.about else "")

    @property
    def hidden(self) -> str:
        """In words."""
        largest = sorted(self.truths, key=lambda truth: -truth.size)
        words = [str(truth) for truth in largest[:3]] + [w for w in (self.foreign, self.nuisance) if w]
        words += [f"and {len(largest) - 3} up to {largest[3].size:.2g}"] if len(largest) > 3 else []
        words += [f"without {name}" for name in self.without]
        return ", ".join(words) or "nothing"


NUISANCES: tuple[str, ...] = (
    "correlated_noise", "pwm_ripple", "sampling_jitter", "no_gates_off", "one_amplitude", "one_pwm_frequency",
    "no_classical", "no_injection", "no_anchors", "servo_48v", "traction_28kw", "too_short", "no_excitation",
    "wandering_zero",
)  # fmt: skip
SILENT = ("too_short", "no_excitation")
"""Nuisances that leave nothing to diagnose."""

KINDS = (
    "clean", "single", "double", "clutter", "ordinary", "left_out", "foreign", "nuisance", "faint",
    "foreign_behind", "switched_clean", "switched", "switched_foreign",
)  # fmt: skip
MANY = ("clutter", "ordinary")
"""Classes that hide every effect of the catalogue: what each does is requested of the plant (`tests.blind.removal`)."""
FAINT = (0.02, 0.2)
"""Sizes of faint effects, in units of the typical one."""
BEHIND = 1.0
"""Size of the dead time, in units of the typical one, behind which a foreign effect is hidden a second time."""
SLOW_LEG = "one_slow_leg"
"""Foreign on a bench that switches: one leg's dead time is longer than the others'."""
ORDINARY = (0.01, 1.0)
"""The same of the effects of an ordinary bench, on which a little of everything is present."""


def draw_case(kind: str, index: int, seed: int, machine: Machine | None = None) -> Case:
    """The case of a class with this number; raises `ValueError` for a class that there is not.

    Parameters
    ----------
    machine : Machine, optional
        By default the class's own: the 400 W machine but for two nuisances. Foreign effects are sized for it alone.
    """
    if kind not in KINDS:
        raise ValueError(f"{kind!r}: there is {', '.join(KINDS)}")
    rng = np.random.default_rng([seed, zlib.crc32(kind.encode()), index])
    names, case_of = list(CATALOGUE), partial(_case, kind, index, machine=machine)
    if kind == "clean":
        return case_of("", rng)
    if kind in ("foreign", "foreign_behind"):
        about = list(FOREIGN)[index % len(FOREIGN)]
        behind = [("dead_time", BEHIND)] if kind == "foreign_behind" else []
        return case_of(about, rng, behind, foreign=about, without=IN_THE_LIBRARY.get(about, ()))
    if kind == "nuisance":
        about = NUISANCES[index % len(NUISANCES)]
        # The first round is clean; the later ones have an effect beside the nuisance.
        hidden = [] if index < len(NUISANCES) else [(str(rng.choice(names)), None)]
        return case_of(about, rng, hidden, nuisance=about)
    first = names[index % len(names)]
    if kind == "double":
        first, second = (str(name) for name in rng.choice(names, 2, replace=False))
        return case_of("", rng, [(first, None), (second, None)])
    if kind == "clutter":
        rest = [(name, 0.05) for name in names if name != first]
        return case_of(first, rng, [(first, None), *rest])
    if kind == "ordinary":
        return case_of("", rng, [(name, float(np.exp(rng.uniform(*np.log(ORDINARY))))) for name in names])
    if kind == "switched_clean":
        case = case_of("", rng)
        return dataclasses.replace(case, bench=healthy(case.bench))
    if kind in ("switched", "switched_foreign"):
        present = [name for name in names if name not in HARDLY_THERE and (name == "dead_time" or rng.random() < 0.6)]
        sizes = [(name, float(np.exp(rng.uniform(*np.log(ORDINARY))))) for name in present]
        case = case_of("", rng, sizes)
        bench, brought = imperfect(rng, case.bench)
        bench = dataclasses.replace(bench, bridge=bench.bridge._replace(once=float(bench.seed % 2)))
        if kind == "switched_foreign":
            slow = bench.bridge._replace(dead_a_s=bench.bridge.dead_s + rng.uniform(0.2e-6, 0.6e-6))
            bench = dataclasses.replace(bench, bridge=slow)
            case = dataclasses.replace(case, about=SLOW_LEG, foreign=SLOW_LEG)
        return dataclasses.replace(case, bench=bench, brought=brought)
    if kind == "faint":
        return case_of(first, rng, [(first, float(np.exp(rng.uniform(*np.log(FAINT)))))])
    without = (first,) if kind == "left_out" else ()
    return case_of(first, rng, [(first, None)], without=without)


def _case(
    kind: str,
    index: int,
    about: str,
    rng: Rng,
    hidden: Hidden = (),
    foreign: str | None = None,
    nuisance: str | None = None,
    without: tuple[str, ...] = (),
    machine: Machine | None = None,
) -> Case:
    machine = machine or {"servo_48v": SERVO_48V, "traction_28kw": TRACTION_28KW}.get(nuisance or "", PM400)
    changes, truths = _hide(rng, machine, hidden)
    if foreign:
        changes |= FOREIGN[foreign](rng)
    if nuisance in ("correlated_noise", "pwm_ripple", "sampling_jitter"):
        changes |= {
            "correlated_noise": {"noise_memory": rng.uniform(0.3, 0.8)},
            "pwm_ripple": {"pwm_ripple": rng.uniform(0.02, 0.06)},
            "sampling_jitter": {"jitter_s": 1e-6},
        }[nuisance]
    family, table = draw_table(rng, machine, slot=float(changes.pop("slot", 0.0)))
    d, _, q = table.inductance(0.0, 0.0)
    plate = dataclasses.replace(
        machine, l_d_h=_rounded(d * rng.uniform(0.95, 1.05)), l_q_h=_rounded(q * rng.uniform(0.95, 1.05))
    )
    plant = HEALTHY._replace(
        sample_s=1 / machine.sampling_hz,
        pole_pairs=float(machine.pole_pairs),
        resistance=machine.resistance_ohm * rng.uniform(0.96, 1.1),
        bus_v=machine.bus_v,
        noise=machine.noise_a * rng.uniform(0.6, 1.5),
        quantum=machine.quantum_a * rng.uniform(0.0, 2.0),
    )
    bench = Bench(
        plate,
        table,
        _changed(plant, changes),
        believed_rad=float(rng.uniform(-np.pi, np.pi)),
        drive_delay_samples=float(rng.choice([0.0, 0.0, 1.0])),
        seed=int(rng.integers(2**63)),
    )
    if nuisance == "wandering_zero":
        # A sound sensor's, in warm-up: up to 0.15 % of the rated current, each segment its own.
        rated_a = np.sqrt(2.0) * machine.rated_current_rms_a
        bench = dataclasses.replace(bench, zero_wander_a=float(rng.uniform(0.0005, 0.0015) * rated_a))
    return Case(
        kind,
        index,
        about,
        bench,
        _campaign(nuisance),
        family,
        truths,
        foreign,
        nuisance,
        without,
    )


def _hide(rng: Rng, machine: Machine, hidden: Hidden) -> tuple[dict[str, Any], tuple[Truth, ...]]:
    changes: dict[str, Any] = {}
    truths = []
    for name, relative in hidden:
        size = CATALOGUE[name]
        if relative is None:
            value = float(np.exp(rng.uniform(np.log(size.low), np.log(size.high))))
        else:
            value = size.typical / relative if size.inverse else relative * size.typical
        does, parameters = size.build(rng, value, machine)
        does["substeps"] = max(does.get("substeps", 2), changes.get("substeps", 2))
        changes |= does
        truths.append(Truth(name, size.relative(value), parameters, does))
    return changes, tuple(truths)


def _changed(plant: Plant, changes: Mapping[str, Any]) -> Plant:
    return plant._replace(**changes)


def _campaign(nuisance: str | None) -> Campaign:
    return {
        "no_gates_off": Campaign(gates_off=False),
        "one_amplitude": Campaign(second_amplitude=False),
        "one_pwm_frequency": Campaign(second_pwm=False),
        "no_classical": Campaign(classical=False),
        "no_injection": Campaign(injection=False, second_amplitude=False),
        "no_anchors": Campaign(anchors=False),
        "too_short": Campaign(short_s=0.004),
        "no_excitation": Campaign(excited=False),
    }.get(nuisance or "", Campaign())


def _rounded(value: float) -> float:
    return float(f"{value:.3g}")
