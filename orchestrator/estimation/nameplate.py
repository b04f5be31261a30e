"""Compares estimates with the nameplate; if all differ by a common factor, the map is not usable."""

from __future__ import annotations

import math
from collections.abc import Mapping

from orchestrator.formatting.sentences import listed
from orchestrator.numerics.tables import value_at
from protocols import Basis, CheckOutcome, EstimationReport, FluxMap, MapCriteria, Motor, Remark, UsabilityCheck


def with_nameplate_checks(report: EstimationReport, maps: Mapping[str, FluxMap], motor: Motor) -> EstimationReport:
    """The report with a remark on each of R_s, L_d and L_q that is far from the nameplate.

    Where R_s and the inductances all deviate in one direction, either the nameplate or a scale of the readings is
    wrong; the map is not usable until that is settled.
    """
    criteria = report.criteria
    pairs = {name: (found, stated) for name, found, stated in _pairs(report, maps, motor) if stated and found > 0.0}
    ratios = {name: found / stated for name, (found, stated) in pairs.items()}
    far = [name for name, ratio in ratios.items() if abs(ratio - 1.0) > criteria.nameplate_apart]
    questioned = [name for name in far if abs(math.log(ratios[name])) > math.log(criteria.nameplate_factor)]
    remarks = [_remark(name, *pairs[name], questioned=name in questioned) for name in far]
    remarks += _common_factor(ratios)
    signs = {ratios[name] > 1.0 for name in questioned}
    report = report.model_copy(update={"remarks": (*report.remarks, *remarks)})
    if len(questioned) == len(ratios) >= 2 and "R_s" in questioned and len(signs) == 1:
        return report.checked([_scale_check(ratios, pairs["R_s"], criteria)])
    return report


def _common_factor(ratios: Mapping[str, float]) -> list[Remark]:
    """A remark where R_s and the inductances differ from the nameplate by one factor, which scaled readings cause."""
    logs = [math.log(ratio) for ratio in ratios.values()]
    if "R_s" not in ratios or len(logs) < 2 or max(logs) - min(logs) > MAX_SPREAD_OF_FACTOR:
        return []
    ratio = math.exp(sum(logs) / len(logs))
    if abs(math.log(ratio)) < MIN_COMMON_FACTOR:
        return []
    text = "{names} are all {ratio:.3g} times the nameplate's: one scale of the currents or voltages explains it{hint}"
    names = listed(list(ratios))
    return [Remark.of("common_factor", text, names=names, ratio=ratio, hint=scale_hint(ratio))]


def scale_hint(ratio: float) -> str:
    """Which convention a factor is that of, in words; empty where it is none's."""
    for factor, words in KNOWN_FACTORS:
        for value, symbol in ((factor, words[0]), (1.0 / factor, words[1])):
            if abs(math.log(ratio / value)) < MAX_ERROR_OF_FACTOR:
                return f"; {value:.3g} = {symbol}, as between {words[2]}"
    return ""


KNOWN_FACTORS: tuple[tuple[float, tuple[str, str, str]], ...] = (
    (math.sqrt(1.5), ("√(3/2)", "√(2/3)", "power-invariant and amplitude-invariant values: is `scaling` right?")),
    (math.sqrt(2.0), ("√2", "1/√2", "peak and rms values: is `scaling` right, and the nameplate?")),
    (math.sqrt(3.0), ("√3", "1/√3", "line-to-line and phase values")),
    (2.0, ("2", "1/2", "values between two terminals and those of one phase")),
)
"""Factors of conventions: value, how it and its inverse are written, and what they are between."""
MAX_SPREAD_OF_FACTOR: float = 0.05
"""Largest difference of the logarithms of factors that count as one."""
MIN_COMMON_FACTOR: float = 0.1
"""Logarithm of a common factor below which tolerances of a nameplate explain it."""
MAX_ERROR_OF_FACTOR: float = 0.03
"""Difference of logarithms within which a factor is a convention's."""


def _scale_check(ratios: Mapping[str, float], ohms: tuple[float, float], criteria: MapCriteria) -> UsabilityCheck:
    """Failed check for a common factor, which a wrong nameplate or wrongly scaled readings cause."""
    text = (
        "{names} are all about {ratio:.3g} times the nameplate's: either the nameplate is wrong, or the currents or "
        "voltages are scaled. The recording alone cannot decide. Measure between two terminals: {found_ohm:.3g} ohm if "
        "the readings are right, {stated_ohm:.3g} ohm if the nameplate is; then correct the nameplate or the scale"
        "{hint}"
    )
    names = ", ".join(ratios)
    ratio = math.exp(sum(map(math.log, ratios.values())) / len(ratios))
    found_ohm, stated_ohm = (2.0 * ohm for ohm in ohms)
    figures = {"ratio": ratio, "found_ohm": found_ohm, "stated_ohm": stated_ohm}
    return UsabilityCheck(
        name="nameplate",
        outcome=CheckOutcome.FAILED,
        required=True,
        value=max(ratio, 1.0 / ratio),
        limit=criteria.nameplate_factor,
        unit="1",
        remark=Remark.of("nameplate_or_readings", text, names=names, hint=scale_hint(ratio), **figures),
    )


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
    """Name, estimate and nameplate; inductances at no current."""
    pairs = []
    if report.resistance is not None:
        pairs.append(("R_s", report.resistance.value_ohm, motor.stator_resistance_ohm))
    if report.method is not None:
        l_d, l_q = _unsaturated(_compared_map(report, maps))
        pairs += [("L_d", l_d, motor.d_inductance_h), ("L_q", l_q, motor.q_inductance_h)]
    return pairs


def _compared_map(report: EstimationReport, maps: Mapping[str, FluxMap]) -> FluxMap:
    """The recommended map; where that is not reliable, one of an energy, from which dead time has been taken out."""
    energies = [] if report.usable else [one for one in maps.values() if one.basis is Basis.ENERGY]
    return energies[0] if energies else maps[str(report.method)]


def _unsaturated(found: FluxMap) -> tuple[float, float]:
    """L_dd and L_qq at no current [H]; zero where unknown there, or where the 95 % band exceeds half the value."""
    pairs = ((found.l_dd, found.l_dd_std), (found.l_qq, found.l_qq_std))
    at_zero = [[value_at((found.i_d, found.i_q), table, 0.0, 0.0) for table in pair] for pair in pairs]
    l_d, l_q = (value if value and not 1.96 * (std or 0.0) > 0.5 * value else 0.0 for value, std in at_zero)
    return l_d, l_q
