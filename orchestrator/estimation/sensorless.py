"""What a small ripple sees beside the slopes of the large-signal map, for whoever tracks a rotor by injection."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from orchestrator.analysis._checks import values_at
from orchestrator.numerics.saliency import Saliency, principal
from protocols import Basis, FluxMap, FluxMapEstimate, IncrementalInductances, SeenByInjection


def seen_by_injection(maps: Sequence[FluxMapEstimate]) -> tuple[SeenByInjection, ...]:
    """One entry for each frequency and size of ripple.

    Parameters
    ----------
    maps : sequence of FluxMapEstimate
        The best first. The first that is not by injection alone is the large-signal one, as long as anything was swept.
    """
    swept = any(made.map.basis is Basis.INTEGRATION for made in maps)
    large = next((made.map for made in maps if made.map.basis is not Basis.INJECTION), None) if swept else None
    if large is None:
        return ()
    seen = (_beside(large, ripple) for made in maps for ripple in made.incremental)
    return tuple(one for one in seen if one is not None)


def _beside(large: FluxMap, ripple: IncrementalInductances) -> SeenByInjection | None:
    """None where the map covers none of the points."""
    slopes = values_at(large, "l_dd", "l_dq", "l_qq")(np.asarray(ripple.i_dq))
    known = np.isfinite(slopes).all(axis=1)
    if not known.any():
        return None
    own, of_map = ripple.inductance[known], slopes[known]
    d, q = (100.0 * float(np.mean(own[:, k] / of_map[:, k] - 1.0)) for k in (0, 2))
    seen, large_signal = principal(*own.T), principal(*of_map.T)
    # Axes, not arrows: half a turn is none.
    left = 0.5 * np.angle(np.exp(2j * (seen.angle_rad - large_signal.angle_rad)))
    (low, high), (map_low, map_high) = _range(seen), _range(large_signal)
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
        angle_error_rad=float(np.abs(seen.angle_rad).max()),
        left_by_map_rad=float(np.abs(left).max()),
    )


def _range(seen: Saliency) -> tuple[float | None, float | None]:
    ratio = seen.ratio[np.isfinite(seen.ratio)]
    return (float(ratio.min()), float(ratio.max())) if len(ratio) else (None, None)
