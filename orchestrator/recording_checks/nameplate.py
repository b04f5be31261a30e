"""R and L beside the nameplate's. A wrong nameplate and a wrong scale of the readings look alike: both are said.

A gain g on the currents divides R = v / i and L = v / (di/dt) by g alike, and one on the voltages multiplies both; so
does a nameplate that is written line to line. No recording separates these: an ohmmeter does, or whoever knows how the
log and the nameplate came about. Factors that differ for R and L are no gain's.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from orchestrator.recording_checks.criteria import ConventionCriteria
from orchestrator.recording_checks.responses import Responses
from orchestrator.recording_checks.set_points import Match, current_match, voltage_match
from orchestrator.recording_checks.vector_maps import CURRENT_SCALES
from protocols import Remark

NAMEPLATE_SCALES: Sequence[tuple[float, str]] = (
    (1.0 / 2.0, "values from line to line, two phases in series"),
    (2.0 / 3.0, "values of one phase in series with the other two in parallel"),
    (1.0 / 3.0, "values of a phase in delta"),
    (3.0 / 2.0, "2/3 of a phase's values, a Clarke factor in whatever measured them"),
    (2.0, "half the values of a phase"),
    (10.0, "a decimal point"),
    (0.1, "a decimal point"),
)
"""True R and L per phase of the star over those that are written, and what is written then."""


def nameplate_remarks(seen: Responses) -> tuple[Remark, ...]:
    """What R and L say beside the nameplate's, with the evidence that separates its being wrong from the readings'.

    None where R and L agree with it as far as tolerance, temperature and saturation go, or where one is not known.
    """
    r_ratio, l_ratio, limits = seen.resistance_ratio, seen.inductance_ratio, seen.survey.criteria
    if r_ratio is None or l_ratio is None or seen.resistive_part < limits.least_resistive:
        return ()
    tolerance = math.log1p(limits.nameplate)
    both = math.sqrt(r_ratio * l_ratio)
    if abs(math.log(r_ratio / l_ratio)) > tolerance:
        return (_unlike_factors(r_ratio, l_ratio),) if _far_apart(r_ratio, l_ratio, limits) else ()
    return (_same_factor(seen, r_ratio, l_ratio),) if abs(math.log(both)) >= math.log(limits.least_scale) else ()


def _far_apart(r_ratio: float, l_ratio: float, limits: ConventionCriteria) -> bool:
    """Whether one is further off than a winding's heat takes R, or than iron takes L."""
    hot, saturated = limits.hot_winding, limits.saturated_iron
    return not (1.0 / hot <= r_ratio <= hot and 1.0 / saturated <= l_ratio <= saturated)


def _same_factor(seen: Responses, r_ratio: float, l_ratio: float) -> Remark:
    motor, limits, both = seen.survey.manifest.motor, seen.survey.criteria, math.sqrt(r_ratio * l_ratio)
    near = math.log1p(limits.nameplate) / 2.0
    plate = next((why for factor, why in NAMEPLATE_SCALES if abs(math.log(both / factor)) < near), None)
    scale = next((m for m in CURRENT_SCALES if m.factor and abs(math.log(both * m.factor)) < near), None)
    written = "" if plate is None else f" (written would be {plate})"
    logged = f"scaled by {1.0 / both:.3g}" if scale is None else scale.what
    ohm = motor.stator_resistance_ohm or 0.0
    text = (
        "R and L are {resistance_ratio:.3g} and {inductance_ratio:.3g} times those of {motor}'s nameplate. "
        "Either the nameplate is wrong{written}, or the readings are: currents {logged}, or voltages by {both:.3g}. "
        "{evidence}. To decide, measure between two terminals with an ohmmeter: {readings_ohm:.3g} ohm if the readings "
        "are right, {nameplate_ohm:.3g} ohm if the nameplate is. Without R and L on the nameplate nothing is compared. "
        "Nothing was rescaled"
    )
    return Remark.of(
        "nameplate_or_readings",
        text,
        resistance_ratio=r_ratio,
        inductance_ratio=l_ratio,
        motor=motor.name,
        written=written,
        logged=logged,
        both=both,
        evidence=_set_points(current_match(seen.survey), voltage_match(seen.survey), limits),
        readings_ohm=2.0 * r_ratio * ohm,
        nameplate_ohm=2.0 * ohm,
    )


def _set_points(currents: Match | None, voltages: Match | None, limits: ConventionCriteria) -> str:
    """What the set-points say of a scale between the drive and the file."""
    matches = {"currents": currents, "injected voltages": voltages}
    asked = {name: match.error_as_is for name, match in matches.items() if match is not None}
    kept = [name for name, error in asked.items() if error < limits.alike]
    if not asked:
        return "No set-points were logged, which would show a scale between drive and file"
    if len(kept) < len(asked):
        return "The set-points do not decide it"
    within = 100.0 * max(asked.values())
    rest = "" if len(kept) == len(matches) else f", the {next(n for n in matches if n not in asked)} have none"
    return (
        f"The {' and '.join(kept)} are their set-points within {within:.2g} %{rest}: no scale came between drive and "
        "file, which leaves the nameplate or the drive's own sensors"
    )


def _unlike_factors(r_ratio: float, l_ratio: float) -> Remark:
    text = (
        "R is {resistance_ratio:.3g} and L {inductance_ratio:.3g} times the nameplate's. A scale of the readings "
        "changes both alike, so that one of the nameplate's values is wrong, or the sampling frequency. To decide, "
        "measure R between two terminals (twice that of a phase), and L with a bridge"
    )
    return Remark.of("nameplate_inconsistent", text, resistance_ratio=r_ratio, inductance_ratio=l_ratio)
