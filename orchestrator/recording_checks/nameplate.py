"""R and L far from the nameplate by one and the same factor, where no set-point says which of the readings is off."""

from __future__ import annotations

import math

from orchestrator.recording_checks.responses import Responses
from orchestrator.recording_checks.vector_maps import CURRENT_SCALES
from protocols import Convention, ManifestCorrection


def against_nameplate(seen: Responses) -> Convention | None:
    """A factor on currents or voltages that brings both R and L back; both are named, for they look alike."""
    limits = seen.survey.criteria
    ratios = (seen.resistance_ratio, seen.inductance_ratio)
    if ratios[0] is None or ratios[1] is None or seen.resistive_part < limits.least_resistive:
        return None
    both = math.sqrt(ratios[0] * ratios[1])
    tolerance = math.log1p(limits.nameplate)
    if abs(math.log(both)) < math.log(limits.least_scale) or abs(math.log(ratios[0] / ratios[1])) > tolerance:
        return None
    likely = min(CURRENT_SCALES, key=lambda m: abs(math.log(both * (m.factor or 1.0))))
    factor = likely.factor or 1.0
    if abs(math.log(both * factor)) > tolerance / 2.0:
        return None
    motor = seen.survey.manifest.motor
    # Between two lines of a star are two phases.
    plate = "line to line" if abs(math.log(2.0 * both)) < tolerance / 2.0 else "another motor's"
    return Convention(
        kind="scaled",
        what=f"the currents look {likely.what}, or the voltages by {1.0 / factor:.4g}, or the nameplate is {plate}",
        evidence=f"R and L are {ratios[0]:.3g} and {ratios[1]:.3g} times those of {motor.name}'s nameplate",
        correction=ManifestCorrection(
            text=f"multiply the currents by {1.0 / factor:.4g}, or the voltages by {factor:.4g}",
            field="currents",
            factor=1.0 / factor,
        ),
    )
