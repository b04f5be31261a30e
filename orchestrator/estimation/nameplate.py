"""Estimates beside the nameplate: what is far from it is said, and a factor on all of them is an objection."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from orchestrator.estimation.usability import unmet
from protocols import EstimationReport, FluxMap, Motor, Remark


def beside_nameplate(report: EstimationReport, maps: Mapping[str, FluxMap], motor: Motor) -> EstimationReport:
    """The report with a remark on each of R_s, L_d and L_q that is far from the nameplate.

    Where R_s and the inductances are all off the same way, a scale of the readings is: the map is not usable then.
    """
    criteria = report.criteria
    pairs = {name: (found, stated) for name, found, stated in _pairs(report, maps, motor) if stated and found > 0.0}
    ratios = {name: found / stated for name, (found, stated) in pairs.items()}
    told = [name for name, ratio in ratios.items() if abs(ratio - 1.0) > criteria.nameplate_apart]
    far = [name for name in told if abs(math.log(ratios[name])) > math.log(criteria.nameplate_factor)]
    remarks = [_remark(name, *pairs[name], questioned=name in far) for name in told]
    signs = {ratios[name] > 1.0 for name in far}
    if len(far) == len(ratios) >= 2 and "R_s" in far and len(signs) == 1:
        return report.checked(unmet("nameplate", remarks))
    return report.model_copy(update={"remarks": (*report.remarks, *remarks)})


def _remark(name: str, found: float, stated: float, *, questioned: bool) -> Remark:
    text = "{name} is {measured:.4g} {unit}, {ratio:.3g} times the nameplate's {nameplate:.4g} {unit}"
    if questioned:
        text += ": is the nameplate right, and are the units?"
    unit = "ohm" if name == "R_s" else "H"
    ratio = found / stated
    return Remark.of("far_from_nameplate", text, name=name, measured=found, nameplate=stated, ratio=ratio, unit=unit)


def _pairs(
    report: EstimationReport, maps: Mapping[str, FluxMap], motor: Motor
) -> list[tuple[str, float, float | None]]:
    """Name, estimate and nameplate; inductances where the least current flows."""
    pairs = []
    if report.resistance is not None:
        pairs.append(("R_s", report.resistance.value_ohm, motor.stator_resistance_ohm))
    if report.method is not None:
        l_d, l_q = _unsaturated(maps[report.method])
        pairs += [("L_d", l_d, motor.d_inductance_h), ("L_q", l_q, motor.q_inductance_h)]
    return pairs


def _unsaturated(found: FluxMap) -> tuple[float, float]:
    there = np.isfinite(found.l_dd) & np.isfinite(found.l_qq)
    if not there.any():
        return 0.0, 0.0
    size = np.hypot(*np.meshgrid(found.i_d, found.i_q, indexing="ij"))
    nearest = np.unravel_index(int(np.argmin(np.where(there, size, np.inf))), size.shape)
    return float(found.l_dd[nearest]), float(found.l_qq[nearest])
