"""Recordings mutilated by a wrong logger, sensor or mechanics, and harmless ones, with the truth of the motor's map.

A map that an estimation calls usable is within 1 % of the rated flux (rms, less its mean, which no voltage shows).
"""

from __future__ import annotations

import functools
import math
import random
from collections.abc import Callable
from pathlib import Path

import numpy as np

from orchestrator.estimation import estimate_recording, load_flux_map
from orchestrator.interface.api import chosen_effects
from orchestrator.registry.plugins import PluginKind, make_plugins
from orchestrator.screening import check_model
from protocols import Capture, NotMeasuredError, RealArray, Usability
from tests.orchestrator.analysis.plant import flux_for, saturated_current
from tests.plugins.estimators.recordings import RATED_WB, clean
from tests.support.rewriting import Rewritten, exchanged, gain

MAX_OFF_PERCENT = 1.0
Change = Callable[[random.Random, Rewritten], Rewritten]


@functools.cache
def recording() -> Rewritten:
    """A small recording of a motor whose map is known."""
    return Rewritten.of(clean())


def mutilated(rng: random.Random, folder: Path) -> str:
    """A usable map is right, whatever was done to the recording."""
    name = rng.choice(sorted(MUTILATIONS))
    usability, off = judged(MUTILATIONS[name](rng, recording()), folder)
    assert usability is not Usability.USABLE or off <= MAX_OFF_PERCENT, f"{name}: usable, and {off:.2f} % off"
    return outcome(usability, off)


def harmless(rng: random.Random, folder: Path) -> str:
    """What changes nothing leaves the map usable, and right."""
    name = rng.choice(sorted(HARMLESS))
    usability, off = judged(HARMLESS[name](rng, recording()), folder)
    assert off <= MAX_OFF_PERCENT, f"{name}: {off:.2f} % off"
    return usability.value.replace("_", " ") + ("" if usability is Usability.USABLE else f" ({name})")


def judged(wrong: Rewritten, folder: Path) -> tuple[Usability, float]:
    """What an estimation says of a recording's map, and how far that is off the truth [% of the rated flux]."""
    estimators, judge = make_plugins(PluginKind.ESTIMATORS), functools.partial(check_model, chosen_effects())
    try:
        report = estimate_recording(wrong, estimators, folder, check_model=judge)
    except NotMeasuredError:
        return Usability.NOT_USABLE, math.inf
    if report.method is None:
        return Usability.NOT_USABLE, math.inf
    found = load_flux_map(folder / "results" / "flux_map.nc")
    i_dq = np.stack(np.meshgrid(found.i_d, found.i_q, indexing="ij"), axis=-1).reshape(-1, 2).astype(np.float64)
    off = np.stack([found.psi_d.ravel(), found.psi_q.ravel()], axis=1) - flux_for(i_dq, saturated_current)
    off = off[np.isfinite(off).all(axis=1)]
    return report.usability, 100.0 * float(np.sqrt(np.mean((off - off.mean(axis=0)) ** 2))) / RATED_WB


def outcome(usability: Usability, off: float) -> str:
    """The answer and whether the map was right, in a few words."""
    return f"{usability.value.replace('_', ' ')}, {'right' if off <= MAX_OFF_PERCENT else 'off'}"


def _size(rng: random.Random, low: float, high: float) -> float:
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def _one_axis(factor: float, axis: int) -> RealArray:
    matrix = np.eye(2)
    matrix[axis, axis] = factor
    return matrix


def _currents(wrong: Rewritten, change: Callable[[RealArray, Capture], RealArray]) -> Rewritten:
    def changed(c: Capture) -> dict[str, RealArray]:
        return {"i_ab": change(np.array(c.i_ab, dtype=np.float64), c).astype(np.float32)}

    return wrong.captured(changed)


def _reversed(rng: random.Random, wrong: Rewritten) -> Rewritten:
    return wrong.mapped("i_ab", _one_axis(-_size(rng, 0.05, 1.0), rng.randrange(2)))


def _late_current(rng: random.Random, wrong: Rewritten) -> Rewritten:
    axes, rows = rng.choice(([0], [1], [0, 1])), rng.choice((1, 1, 2, 3))

    def late(i: RealArray, _: Capture) -> RealArray:
        i[rows:, axes] = i[:-rows, axes].copy()
        return i

    return _currents(wrong, late)


def _late_voltage(rng: random.Random, wrong: Rewritten) -> Rewritten:
    return wrong.late(rng.choice((-2, -1, 1, 2, 3)))


def _offset(rng: random.Random, wrong: Rewritten) -> Rewritten:
    size, axis = _size(rng, 0.02, 1.0), rng.randrange(2)
    return _currents(wrong, lambda i, _: i + size * np.eye(2)[axis])


def _offset_voltage(rng: random.Random, wrong: Rewritten) -> Rewritten:
    size = _size(rng, 0.02, 5.0) * np.eye(2)[rng.randrange(2)]
    return wrong.captured(lambda c: {"v_ab": (c.v_ab + size).astype(np.float32)})


def _gain(rng: random.Random, wrong: Rewritten) -> Rewritten:
    factor = 1.0 + rng.choice((-1, 1)) * _size(rng, 0.005, 0.3)
    return wrong.mapped(rng.choice(("i_ab", "v_ab")), _one_axis(factor, rng.randrange(2)))


def _phase_gain(rng: random.Random, wrong: Rewritten) -> Rewritten:
    factor = 1.0 + rng.choice((-1, 1)) * _size(rng, 0.005, 0.3)
    return wrong.phases("i_ab", gain(rng.choice("abc"), factor), rng.choice(("abc", "ab")))


def _coupled(rng: random.Random, wrong: Rewritten) -> Rewritten:
    matrix = np.eye(2)
    matrix[rng.choice(((0, 1), (1, 0)))] = rng.choice((-1, 1)) * _size(rng, 0.01, 0.3)
    return wrong.mapped("i_ab", matrix)


def _quantised(rng: random.Random, wrong: Rewritten) -> Rewritten:
    step = _size(rng, 0.005, 0.3)
    return _currents(wrong, lambda i, _: step * np.round(i / step))


def _swapped(rng: random.Random, wrong: Rewritten) -> Rewritten:
    return wrong.phases(rng.choice(("i_ab", "v_ab")), exchanged(*rng.choice(("ab", "bc", "ac"))))


def _dropped(rng: random.Random, wrong: Rewritten) -> Rewritten:
    share = _size(rng, 1e-4, 0.02)
    return wrong.rows(lambda count, draw: np.flatnonzero(draw.random(count) > share))


def _held(rng: random.Random, wrong: Rewritten) -> Rewritten:
    share = _size(rng, 1e-3, 0.3)

    def hold(i: RealArray, c: Capture) -> RealArray:
        fresh = np.random.default_rng(len(c)).random(len(i)) > share
        fresh[0] = True
        return i[np.maximum.accumulate(np.where(fresh, np.arange(len(i)), 0))]

    return _currents(wrong, hold)


def _clipped(rng: random.Random, wrong: Rewritten) -> Rewritten:
    top = rng.uniform(0.4, 0.95) * max(float(np.abs(c.i_ab).max()) for c in wrong.captures.values())
    return _currents(wrong, lambda i, _: np.clip(i, -top, top))


def _bent(rng: random.Random, wrong: Rewritten) -> Rewritten:
    top = max(float(np.abs(c.i_ab).max()) for c in wrong.captures.values())
    bend = rng.choice((-1, 1)) * _size(rng, 0.005, 0.3) / top**2
    return _currents(wrong, lambda i, _: i * (1.0 - bend * i**2))


def _turned(i: RealArray, theta: RealArray) -> RealArray:
    c, s = np.cos(theta), np.sin(theta)
    return np.stack([c * i[:, 0] - s * i[:, 1], s * i[:, 0] + c * i[:, 1]], axis=1)


def _turning(wrong: Rewritten, angle: Callable[[Capture], RealArray]) -> Rewritten:
    def turned(c: Capture) -> dict[str, RealArray]:
        theta = angle(c)
        return {name: _turned(getattr(c, name), theta).astype(np.float32) for name in ("i_ab", "v_ab")}

    return wrong.captured(turned)


def _drifting_angle(rng: random.Random, wrong: Rewritten) -> Rewritten:
    end_s = max(c.start_s + len(c) / c.sampling_frequency_hz for c in wrong.captures.values())
    rate = rng.choice((-1, 1)) * _size(rng, 0.01, 0.5) / end_s
    return _turning(wrong, lambda c: rate * (c.start_s + np.arange(len(c)) / c.sampling_frequency_hz))


def _constant_angle(rng: random.Random, wrong: Rewritten) -> Rewritten:
    theta = rng.choice((-1, 1)) * _size(rng, 0.005, 1.5)
    return _turning(wrong, lambda c: np.full(len(c), theta))


def _wrong_pole_pairs(rng: random.Random, wrong: Rewritten) -> Rewritten:
    factor = rng.choice((0.5, 2.0, 3.0))
    moved = _turning(wrong, lambda c: np.full(len(c), 0.4))  # a mechanical angle is not zero
    return moved.with_segments(lambda s: {"rotor_angle_rad": factor * (s.rotor_angle_rad + 0.4)})


def _backlash(rng: random.Random, wrong: Rewritten) -> Rewritten:
    play, width_a = _size(rng, 0.003, 0.1), 0.2

    def angle(c: Capture) -> RealArray:
        return play * np.tanh(np.asarray(c.i_ab[:, 1], dtype=np.float64) / width_a)

    return _turning(wrong, angle)


def _hysteresis(rng: random.Random, wrong: Rewritten) -> Rewritten:
    part, limit_a = _size(rng, 0.02, 1.0), _size(rng, 0.02, 0.4)

    def lagging(i: RealArray, _: Capture) -> RealArray:
        stop, out = np.zeros(2), np.empty_like(i)
        for k, step in enumerate(np.diff(i, axis=0, prepend=i[:1])):
            stop = np.clip(stop + step, -limit_a, limit_a)
            out[k] = stop
        return i + part * out

    return _currents(wrong, lagging)


def _eddy(rng: random.Random, wrong: Rewritten) -> Rewritten:
    siemens = _size(rng, 1e-4, 2e-2)

    def currents(i: RealArray, c: Capture) -> RealArray:
        emf = np.asarray(c.v_ab, dtype=np.float64) - 4.31 * i
        return i + siemens * np.sign(emf) * np.sqrt(np.abs(emf) * 10.0)  # of half order in the voltage

    return _currents(wrong, currents)


def _voltage_steps(rng: random.Random, wrong: Rewritten) -> Rewritten:
    step = _size(rng, 0.05, 10.0)
    return wrong.captured(lambda c: {"v_ab": (step * np.round(c.v_ab / step)).astype(np.float32)})


def _heating(rng: random.Random, wrong: Rewritten) -> Rewritten:
    rise = _size(rng, 0.02, 1.0)
    end_s = max(c.start_s for c in wrong.captures.values())
    return wrong.captured(
        lambda c: {"v_ab": (c.v_ab + 4.31 * rise * (c.start_s / end_s) ** 2 * c.i_ab).astype(np.float32)}
    )


MUTILATIONS: dict[str, Change] = {
    "backlash": _backlash,
    "bent sensor": _bent,
    "clipped": _clipped,
    "coupled": _coupled,
    "drifting angle": _drifting_angle,
    "dropped rows": _dropped,
    "eddy": _eddy,
    "gain": _gain,
    "heating": _heating,
    "held rows": _held,
    "hysteresis": _hysteresis,
    "late current": _late_current,
    "late voltage": _late_voltage,
    "offset": _offset,
    "offset voltage": _offset_voltage,
    "phase gain": _phase_gain,
    "quantised": _quantised,
    "reversed": _reversed,
    "swapped": _swapped,
    "voltage steps": _voltage_steps,
    "wrong angle": _constant_angle,
    "wrong pole pairs": _wrong_pole_pairs,
}


def _noisy(rng: random.Random, right: Rewritten) -> Rewritten:
    std, draw = _size(rng, 1e-4, 5e-3), np.random.default_rng(rng.randrange(2**32))
    return _currents(right, lambda i, _: i + std * draw.normal(size=i.shape))


def _tiny_offset(rng: random.Random, right: Rewritten) -> Rewritten:
    size = _size(rng, 1e-5, 1e-3) * np.array([rng.choice((-1, 1)), rng.choice((-1, 1))])
    return _currents(right, lambda i, _: i + size)


def _reordered(rng: random.Random, right: Rewritten) -> Rewritten:
    segments = list(right.manifest.segments)
    rng.shuffle(segments)
    return Rewritten(right.manifest.model_copy(update={"segments": tuple(segments)}), right.captures)


def _same(rng: random.Random, right: Rewritten) -> Rewritten:
    return right.rows(lambda count, _: np.arange(count))


def _shorter(rng: random.Random, right: Rewritten) -> Rewritten:
    cut = rng.uniform(0.0, 0.1)
    segments = {s.id: s.stage.value for s in right.segments()}
    captures = {}
    for name, c in right.captures.items():
        left = len(c) if segments[name] == "classical" else round((1.0 - cut) * len(c))
        captures[name] = c.model_copy(update={x: getattr(c, x)[:left] for x in ("i_ab", "v_ab", "v_dc")})
    return Rewritten(right.manifest, captures).captured(lambda c: {})


def _extra_dwells(rng: random.Random, right: Rewritten) -> Rewritten:
    """Held currents measured once more at the end, as they were."""
    holds = [s for s in right.segments() if s.stage.value == "resistance"]
    end_s = max(c.start_s + len(c) / c.sampling_frequency_hz for c in right.captures.values()) + 1.0
    segments, captures = list(right.manifest.segments), dict(right.captures)
    for k, s in enumerate(rng.sample(holds, min(len(holds), 4))):
        name, start_s = f"{s.id}-again", end_s + k
        segments.append(s.model_copy(update={"id": name, "start_s": start_s}))
        captures[name] = right.captures[s.id].model_copy(update={"start_s": start_s})
    return Rewritten(right.manifest.model_copy(update={"segments": tuple(segments)}), captures)


HARMLESS: dict[str, Change] = {
    "extra dwells": _extra_dwells,
    "noise": _noisy,
    "nothing": _same,
    "reordered": _reordered,
    "shorter": _shorter,
    "tiny offset": _tiny_offset,
}
