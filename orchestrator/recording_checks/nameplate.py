"""R and L compared with the nameplate. A wrong nameplate and a wrong scale of the readings look alike: both are named.

A gain g on the currents divides R = v / i and L = v / (di/dt) by g alike, and one on the voltages multiplies both; so
does a nameplate that is written line to line. No recording separates these: an ohmmeter does, or knowledge of how the
log and the nameplate were made. A gain cannot cause different factors for R and L.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from orchestrator.recording_checks.responses import Responses
from orchestrator.recording_checks.set_points import Match, current_match, voltage_match
from orchestrator.recording_checks.survey import MAX_MATCH_ERROR
from orchestrator.recording_checks.vector_maps import CURRENT_SCALES
from protocols import Remark

NAMEPLATE_SCALES: Sequence[tuple[float, str]] = (
    (1.0 / 2.0, "values from line to line, two phases in series"),
    (2.0 / 3.0, "values of one phase in series with the other two in parallel"),
    (1.0 / 3.0, "values of a phase in delta"),
    (3.0 / 2.0, "2/3 of a phase's values, a Clarke factor of the instrument"),
    (2.0, "half the values of a phase"),
    (10.0, "a decimal point"),
    (0.1, "a decimal point"),
)
"""True R and L per phase of the star over the stated ones, and the meaning of the stated ones."""
MAX_NAMEPLATE_DEVIATION = 0.2
"""Relative difference to the nameplate's R and L that tolerance, temperature and saturation make."""
MIN_RESISTIVE_SHARE = 0.3
"""Part of the voltage at rest that R_s i has to make for a comparison of R_s: below, inverter losses dominate."""
MIN_SCALE_RATIO = 1.35
"""Ratio to the nameplate, of R and L alike, that a tolerance cannot make."""
MAX_RESISTANCE_RATIO = 1.7
"""Ratio to the nameplate's R that 100 K of copper (0.39 %/K) and a tolerance of 20 % make."""
MAX_INDUCTANCE_RATIO = 2.5
"""Ratio to the nameplate's L that iron makes which saturates by 60 %."""


def nameplate_remarks(responses: Responses) -> tuple[Remark, ...]:
    """Remarks on R and L that differ from the nameplate's, with the measurement that decides which is wrong.

    Empty where they agree within tolerance, temperature and saturation, or where one is not known.
    """
    r_ratio, l_ratio = responses.resistance_ratio, responses.inductance_ratio
    if r_ratio is None or l_ratio is None or responses.resistive_part < MIN_RESISTIVE_SHARE:
        return ()
    tolerance = math.log1p(MAX_NAMEPLATE_DEVIATION)
    both = math.sqrt(r_ratio * l_ratio)
    if abs(math.log(r_ratio / l_ratio)) > tolerance:
        by_heat = 1.0 / MAX_RESISTANCE_RATIO <= r_ratio <= MAX_RESISTANCE_RATIO
        by_saturation = 1.0 / MAX_INDUCTANCE_RATIO <= l_ratio <= MAX_INDUCTANCE_RATIO
        return () if by_heat and by_saturation else (_unlike_factors(r_ratio, l_ratio),)
    return (_same_factor(responses, r_ratio, l_ratio),) if abs(math.log(both)) >= math.log(MIN_SCALE_RATIO) else ()


def _same_factor(responses: Responses, r_ratio: float, l_ratio: float) -> Remark:
    motor, both = responses.survey.manifest.motor, math.sqrt(r_ratio * l_ratio)
    near = math.log1p(MAX_NAMEPLATE_DEVIATION) / 2.0
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
        evidence=_set_point_evidence(current_match(responses.survey), voltage_match(responses.survey)),
        readings_ohm=2.0 * r_ratio * ohm,
        nameplate_ohm=2.0 * ohm,
    )


def _set_point_evidence(currents: Match | None, voltages: Match | None) -> str:
    """A sentence on whether the set-points show a scale between the drive and the file."""
    matches = {"currents": currents, "injected voltages": voltages}
    errors = {name: match.error_as_is for name, match in matches.items() if match is not None}
    agreeing = [name for name, error in errors.items() if error < MAX_MATCH_ERROR]
    if not errors:
        return "No set-points were logged, which would show a scale between drive and file"
    if len(agreeing) < len(errors):
        return "The set-points do not decide it"
    within = 100.0 * max(errors.values())
    rest = "" if len(agreeing) == len(matches) else f" (no set-points of {next(n for n in matches if n not in errors)})"
    return (
        f"The {' and '.join(agreeing)} agree with their set-points within {within:.2g} %{rest}: there is no scale "
        "between drive and file, which leaves the nameplate or the drive's own sensors"
    )


def _unlike_factors(r_ratio: float, l_ratio: float) -> Remark:
    text = (
        "R is {resistance_ratio:.3g} and L {inductance_ratio:.3g} times the nameplate's. A scale of the readings "
        "changes both equally, so one of the nameplate's values or the sampling frequency is wrong. To decide, "
        "measure R between two terminals (twice that of a phase), and L with a bridge"
    )
    return Remark.of("nameplate_inconsistent", text, resistance_ratio=r_ratio, inductance_ratio=l_ratio)
