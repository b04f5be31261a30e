"""Whether a bridge switches: then the resistance takes its part of the current's ripple within each carrier period.

No manifest says so, and simulated plants often hold one voltage a period. Only where R_s T / L is large does it matter.
"""

from __future__ import annotations

from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup, baseline_model
from orchestrator.diagnosis.fitting.model import Fit, Model
from protocols import Saturated

LEAST_RESISTIVE_RIPPLE: float = 0.02
"""R_s over the inductance, times the carrier's period, from which R_s is included in the ripple within a period: its
square over 24, 2e-5 of the voltage, is what the best recordings show."""


def with_carrier_ripple(setup: DiagnosisSetup) -> DiagnosisSetup:
    """The setup as a bridge that switches has it, where that matters, unless the bare map says otherwise."""
    if not _matters(setup):
        return setup
    rippling = setup.with_ripple(ripples=True)
    plain, other = (_fitted(one, baseline_model(one, Saturated())) for one in (setup, rippling))
    return setup if _does_better(plain, other) else rippling


def _matters(setup: DiagnosisSetup) -> bool:
    drive, ohm = setup.prepared.manifest.drive, setup.prepared.manifest.motor.stator_resistance_ohm or 0.0
    period_s = 1.0 / (drive.pwm_frequency_hz or drive.sampling_frequency_hz)
    return ohm * period_s > LEAST_RESISTIVE_RIPPLE * min(setup.l_d_h, setup.l_q_h)


def _fitted(setup: DiagnosisSetup, model: Model) -> Fit:
    return setup.coarse_fitter.fit(model, renewals=1)


def _does_better(one: Fit, other: Fit) -> bool:
    threshold = 2.0 * one.criteria.selection.log_evidence * max(one.chi2_per_dof, 1.0)
    return other.objective - one.objective > threshold
