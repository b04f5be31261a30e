"""Symbolic regression of the voltage that R_s and the map leave: gplearn's genetic programming, where it is installed.

It sees what a user would give it: means over windows of each leg's leftover voltage, and of each quantity that the
search knows. It has no places: whatever enters elsewhere, as through a sensor, is a voltage to it.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from importlib import import_module

import numpy as np

from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.discovery import quantities as of
from orchestrator.numerics.frames import to_phases
from orchestrator.numerics.types import Array
from protocols import Signals

WINDOW_S = 0.01
QUANTITIES = (
    of.PHASE_CURRENT, of.NEXT_CURRENT, of.CURRENT_SLOPE, of.PHASE_VOLTAGE, of.CURRENT, of.CURRENT_D, of.CURRENT_Q,
    of.LINK_VOLTAGE, of.TIME, of.HEAT, of.ROTOR_ANGLE,
)  # fmt: skip
MAX_ROWS = 2500
POPULATION, GENERATIONS, PARSIMONY = 500, 12, 0.003


@dataclass(frozen=True)
class Symbolic:
    """The expression that is kept.

    Attributes
    ----------
    first : list of str
        Quantities in it, of the phase whose leftover it removes best.
    phase : str
    left : float
        rms of the held-out leftover with it, relative to that without.
    formula : str
    cpu_s : float
    """

    first: list[str]
    phase: str
    left: float
    formula: str
    cpu_s: float


def symbolic_law(fit: Fit) -> Symbolic | None:
    """The expression of the phase whose fitted leftover it removes best; None where gplearn is not installed."""
    try:
        regressor = import_module("gplearn.genetic").SymbolicRegressor
    except ImportError:
        return None
    start = time.process_time()
    held = {p.segment.start_s for p in fit.prepared.pieces if p.held_out}
    rows: list[tuple[bool, Array, Array]] = []
    for batch in fit.linearisation.batches:
        for k in range(len(batch.base.segments)):
            one = batch.base.segment(k)
            if one.bridge_on and one.psi_smooth_ab is not None:
                rows.append((one.start_s in held, *_windows(one, fit.model.r_s)))
    best: Symbolic | None = None
    least = np.inf
    for k, phase in enumerate("abc"):
        fitted, unseen = (
            [np.concatenate([part[:, k] for is_held, *parts in rows if is_held == side for part in [parts[j]]])
             for j in (0, 1)]
            for side in (False, True)
        )  # fmt: skip
        scale = np.maximum(np.abs(fitted[1]).max(axis=0), 1e-12)
        volts = float(np.std(fitted[0]))
        some = np.random.default_rng(0).permutation(len(fitted[0]))[:MAX_ROWS]
        found = regressor(
            population_size=POPULATION, generations=GENERATIONS, parsimony_coefficient=PARSIMONY, random_state=0,
            function_set=("add", "sub", "mul", "div", "abs", "inv", "log", "sqrt"), metric="rmse",
        ).fit(fitted[1][some] / scale, fitted[0][some] / volts)  # fmt: skip
        left = float(np.std(fitted[0] / volts - found.predict(fitted[1] / scale)))
        if left < least:
            error = unseen[0] / volts - found.predict(unseen[1] / scale)
            used = sorted({int(x) for x in found._program.program if isinstance(x, int)})
            least, quantities = left, [QUANTITIES[j].name for j in used]
            part = float(np.std(error) / max(np.std(unseen[0] / volts), 1e-12))
            best = Symbolic(quantities, phase, part, str(found._program), 0.0)
    assert best is not None
    return Symbolic(best.first, best.phase, best.left, best.formula, time.process_time() - start)


def _windows(signals: Signals, r_s: float) -> tuple[Array, Array]:
    """Means over windows: leftover voltage of each phase (m, 3), and each quantity of it (m, 3, quantities)."""
    n = round(WINDOW_S * signals.sampling_frequency_hz)
    count = (len(signals.v_dc) - 1) // n
    ends = n * np.arange(count + 1)

    def means(x: Array) -> Array:
        return np.asarray(np.add.reduceat(x[: ends[-1]], ends[:-1]) / n, dtype=np.float64)

    assert signals.psi_smooth_ab is not None
    drop = np.asarray(signals.v_ab, np.float64) - r_s * np.asarray(signals.i_ab, np.float64)
    rise = np.diff(np.asarray(signals.psi_smooth_ab, np.float64)[ends], axis=0) * signals.sampling_frequency_hz / n
    columns = [q.of(signals) for q in QUANTITIES]
    each = [means(x if x.ndim == 2 else np.repeat(x[:, None], 3, axis=1)) for x in columns]
    return to_phases(means(drop) - rise), np.stack(each, axis=2)
