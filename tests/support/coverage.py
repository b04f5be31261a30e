"""How often stated 95 % intervals hold the truth, over many small runs of the simulated drive.

Machines saturate differently, behind different dead times, cold or heating up, with the paper's procedure shortened,
at other sizes. Reported beside it: mean stated width over actual error, which tells honest intervals from vast ones.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from orchestrator.config import load_procedure
from plugins.estimators.classical import ClassicalEstimator
from plugins.estimators.energy import EnergyEstimator
from plugins.estimators.injection import InjectionEstimator
from plugins.estimators.resistance import ResistanceEstimator
from protocols import EstimationContext, FluxMap, FluxMapEstimate, Procedure
from tests.orchestrator.analysis.plant import Array
from tests.support.simulated import Measured, measure

MOTORS = Path(__file__).parents[2] / "docs" / "motors"
QUANTITIES = ("psi_d", "psi_q", "l_dd", "l_dq", "l_qq", "R_s")

_EFFECTS = "drive.plant.effects"


def _demo(random: np.random.Generator, *more: str, base: str = "demo", motor: Path | None = None) -> Procedure:
    falls = random.uniform((0.1, 0.1, 0.02), (0.5, 0.5, 0.15))
    shape = (f"drive.plant.magnetics.{n}={x:.3f}" for n, x in zip(("d_fall", "q_fall", "cross"), falls, strict=True))
    own = (f"seed={random.integers(1, 10**6)}", "drive.plant.magnetics.kind=nameplate", *shape)
    return load_procedure(base, overrides=(*own, *more), motor=motor)


def cold(random: np.random.Generator) -> Procedure:
    """R_s is one number; what compensation leaves of the dead time is not."""
    dead = f"{_EFFECTS}.dead_time.voltage_v={random.uniform(0.0, 1.2):.3f}"
    return _demo(random, dead, f"{_EFFECTS}.winding_heating.rise_per_watt=0.0")


def heated(random: np.random.Generator) -> Procedure:
    """R_s rises by up to a fifth, fast or slowly."""
    return _demo(
        random,
        f"{_EFFECTS}.dead_time.voltage_v={random.uniform(0.0, 1.2):.3f}",
        f"{_EFFECTS}.winding_heating.rise_per_watt={random.uniform(0.001, 0.006):.4f}",
        f"{_EFFECTS}.winding_heating.time_constant_s={random.uniform(30.0, 600.0):.0f}",
    )


def paper(random: np.random.Generator) -> Procedure:
    """The paper's paths and dead time, in a sixth of its points and a fifth of its time at each."""
    return _demo(
        random,
        f"{_EFFECTS}.dead_time.voltage_v={random.uniform(6.0, 10.0):.3f}",
        f"{_EFFECTS}.winding_heating.time_constant_s={random.uniform(60.0, 200.0):.0f}",
        "stages.4.periods=2",
        "stages.5.step_a=0.3",
        "stages.5.duration_s=1.0",
        base="paper",
    )


def servo(random: np.random.Generator) -> Procedure:
    """48 V: small inductances, large currents."""
    return _demo(random, motor=MOTORS / "servo-48v.yaml")


def large(random: np.random.Generator) -> Procedure:
    """28 kW: strongly salient."""
    return _demo(random, motor=MOTORS / "interior-magnet-28kw.yaml")


SCENARIOS: dict[str, Callable[[np.random.Generator], Procedure]] = {
    f.__name__: f for f in (cold, heated, paper, servo, large)
}


@dataclass(frozen=True)
class Coverage:
    """Over all runs of one or more scenarios; quantities as in `QUANTITIES`.

    Attributes
    ----------
    held : array, shape (runs, 6)
        Share of the map's nodes (of R_s: whether) whose interval holds the truth.
    error, width : array, shape (runs, 6)
        rms of the error and of the stated standard deviation; flux relative to the rated flux, inductances to the mean
        L_qq, R_s to itself.
    worst : array, shape (runs,)
        Largest length of a flux error, relative to the rated flux.
    """

    held: Array
    error: Array
    width: Array
    worst: Array

    @property
    def runs(self) -> int:
        return len(self.held)

    @property
    def share(self) -> Array:
        """Mean share held, by quantity."""
        return np.asarray(self.held.mean(axis=0))

    @property
    def width_over_error(self) -> Array:
        """1 where intervals are as wide as the errors are large; much more would be vacuous."""
        return np.asarray(np.sqrt((self.width**2).mean(axis=0) / (self.error**2).mean(axis=0)))

    @property
    def flux_percent(self) -> float:
        """rms error of the flux in per cent of the rated flux."""
        return float(100.0 * np.sqrt((self.error[:, :2] ** 2).sum(axis=1).mean()))

    def __str__(self) -> str:
        parts = [
            f"{name} {100 * share:.1f} ({ratio:.2f})"
            for name, share, ratio in zip(QUANTITIES, self.share, self.width_over_error, strict=True)
        ]
        return (
            f"{self.runs} runs, {self.flux_percent:.3f} % rms, {100 * self.worst.max():.2f} worst; {', '.join(parts)}"
        )


def together(several: Iterable[Coverage]) -> Coverage:
    """One table of all."""
    every = list(several)
    return Coverage(*(np.concatenate([getattr(c, n) for c in every]) for n in ("held", "error", "width", "worst")))


def cover(scenario: str, runs: int, *, seed: int = 1) -> Coverage:
    """Run a scenario so many times and judge the recommended map and R_s."""
    random = np.random.default_rng(seed)
    return together(judged(measure(SCENARIOS[scenario](random))) for _ in range(runs))


def judged(measured: Measured) -> Coverage:
    """One run's energy map and R_s against the plant."""
    recording = measured.recording
    resistance = ResistanceEstimator().estimate(recording, EstimationContext())
    maps: dict[str, FluxMapEstimate] = {}
    for estimator in (ClassicalEstimator(), InjectionEstimator(), EnergyEstimator()):
        maps[estimator.name] = estimator.estimate(recording, EstimationContext((resistance, *maps.values())))
    off, std = _errors(maps["energy"].map, measured)
    half = 0.5 * (resistance.high - resistance.low)
    ohm = _held_ohm(measured)
    held = np.append((np.abs(off) < 1.96 * std).mean(axis=0), abs(resistance.value_ohm - ohm) < half)
    error = np.append(np.sqrt((off**2).mean(axis=0)), abs(resistance.value_ohm / ohm - 1.0))
    width = np.append(np.sqrt((std**2).mean(axis=0)), half / 1.96 / ohm)
    worst = np.linalg.norm(off[:, :2], axis=1).max()
    return Coverage(held[None], error[None], width[None], np.array([worst]))


def _held_ohm(measured: Measured) -> float:
    """Mean of R_s over the instants that its estimate is the mean over."""
    used = ResistanceEstimator().constant_currents(measured.recording)
    return float(np.mean(measured.ohm_at(np.array([d.start_s + 0.5 * d.seconds for d in used]))))


def _errors(flux_map: FluxMap, measured: Measured) -> tuple[Array, Array]:
    """Errors and stated standard deviations of the five quantities at all nodes but zero current, (n, 5) each."""
    grid = np.stack(np.meshgrid(flux_map.i_d, flux_map.i_q, indexing="ij"), axis=-1).reshape(-1, 2)
    names = QUANTITIES[:5]
    found = np.column_stack([getattr(flux_map, name).ravel() for name in names])
    std = np.column_stack([getattr(flux_map, f"{name}_std").ravel() for name in names])
    known = np.isfinite(found).all(axis=1) & (np.linalg.norm(grid, axis=1) > 1e-9 * np.abs(grid).max())
    truth, motor = measured.truth, measured.procedure.motor
    zero = truth.flux(np.zeros((1, 2)))
    inductance = truth.inductance(grid[known])[:, [0, 0, 1], [0, 1, 1]]
    psi = truth.flux(grid[known]) - zero + np.array([motor.pm_flux_wb or 0.0, 0.0])
    rated = float(np.linalg.norm(truth.flux(np.array([[0.0, motor.rated_current_a or 0.0]])) - zero))
    scale = np.repeat([rated, float(inductance[:, 2].mean())], (2, 3))
    return (found[known] - np.column_stack([psi, inductance])) / scale, std[known] / scale
