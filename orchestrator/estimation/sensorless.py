"""Incremental inductances at a small ripple compared with the large-signal map, for sensorless rotor tracking."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from orchestrator.analysis import values_at
from orchestrator.numerics.saliency import Saliency, principal
from protocols import Basis, FluxMap, FluxMapEstimate, IncrementalInductances, SeenByInjection


def seen_by_injection(maps: Sequence[FluxMapEstimate]) -> tuple[SeenByInjection, ...]:
    """One entry for each frequency and size of ripple.

    Parameters
    ----------
    maps : sequence of FluxMapEstimate
        The best first. The first one not by injection alone is the large-signal map, if any current was swept.
    """
    swept = any(m.map.basis is Basis.INTEGRATION for m in maps)
    large = next((m.map for m in maps if m.map.basis is not Basis.INJECTION), None) if swept else None
    if large is None:
        return ()
    comparisons = (_comparison(large, ripple) for m in maps for ripple in m.incremental)
    return tuple(entry for entry in comparisons if entry is not None)


def _comparison(large: FluxMap, ripple: IncrementalInductances) -> SeenByInjection | None:
    """None where the map covers none of the points."""
    slopes = values_at(large, "l_dd", "l_dq", "l_qq")(np.asarray(ripple.i_dq))
    known = np.isfinite(slopes).all(axis=1)
    if not known.any():
        return None
    measured, map_values = ripple.inductance[known], slopes[known]
    d, q = (100.0 * float(np.mean(measured[:, k] / map_values[:, k] - 1.0)) for k in (0, 2))
    axes, large_signal = principal(*measured.T), principal(*map_values.T)
    # Axes have no direction: angles modulo half a turn.
    angle_difference = 0.5 * np.angle(np.exp(2j * (axes.angle_rad - large_signal.angle_rad)))
    (low, high), (map_low, map_high) = _range(axes), _range(large_signal)
    turn = np.abs(axes.angle_rad)
    worst_dq = np.asarray(ripple.i_dq)[known][int(turn.argmax())]
    return SeenByInjection(
        method=large.method,
        frequency_hz=ripple.frequency_hz,
        amplitude_v=ripple.amplitude_v,
        points=int(known.sum()),
        l_dd_percent=d,
        l_qq_percent=q,
        saliency_low=low,
        saliency_high=high,
        map_saliency_low=map_low,
        map_saliency_high=map_high,
        angle_error_rad=float(turn.max()),
        angle_error_i_d_a=float(worst_dq[0]),
        angle_error_i_q_a=float(worst_dq[1]),
        left_by_map_rad=float(np.abs(angle_difference).max()),
    )


def _range(seen: Saliency) -> tuple[float | None, float | None]:
    ratio = seen.ratio[np.isfinite(seen.ratio)]
    return (float(ratio.min()), float(ratio.max())) if len(ratio) else (None, None)
