"""Estimation of a PWM quantiser within a search: before it, and again as the effects' forms improve."""

from __future__ import annotations

from dataclasses import replace

from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.fitting.candidates import Library
from orchestrator.diagnosis.fitting.fit import MIN_JOINT_GAIN, fit_with_frozen_jacobian
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.nuisances.command_traces import command_traces
from orchestrator.diagnosis.nuisances.quantiser_beside_fit import quantiser_beside
from orchestrator.diagnosis.nuisances.quantiser_in_dwells import quantiser_of_dwells
from orchestrator.diagnosis.nuisances.quantiser_search import detect_quantisation
from orchestrator.diagnosis.nuisances.segment_scatter import likelihood_of

MAX_QUANTISER_ROUNDS: int = 4
"""Maximum number of alternating estimates of quantiser and fit."""
MAX_ROUNDS_WITH_QUANTISER: int = 6
"""Relinearisations of the fit in one such round."""
TOLERANCE_WITH_QUANTISER: float = 1e-2
"""Gain of a relinearisation, as a part of the excess chi2, below which that fit ends."""


def with_detected_quantiser(setup: DiagnosisSetup, fit: Fit, library: Library) -> DiagnosisSetup:
    """The setup with voltages rounded by the modulator's timer, where the readings show one.

    For a PWM frequency with dwells only, the timer's phases are estimated beside a fit, all effects adapting.
    """
    prepared = setup.prepared
    setup.fitter.tell("testing whether a modulator's timer rounds the commands")
    resistance_ohm = prepared.manifest.motor.stator_resistance_ohm or 1.0
    quantisers = detect_quantisation(
        command_traces(prepared, (setup.l_d_h, setup.l_q_h), resistance_ohm),
        prepared.manifest.drive.dc_bus_voltage_v,
        prepared.criteria.selection.log_evidence,
    )
    return _by_dwells(replace(setup, quantisers=quantisers), fit, library) if quantisers else setup


def _by_dwells(setup: DiagnosisSetup, fit: Fit, library: Library) -> DiagnosisSetup:
    """The setup with the likeliest timer beside a fit near the readings' estimates."""
    likelihood = likelihood_of(setup.with_quantiser(None).part_fitter, fit, library)
    scatter = likelihood.most_likely((True, True))
    timer, _ = quantiser_of_dwells(setup.part_fitter.prepared, likelihood, scatter, setup.quantisers)
    return setup.with_quantiser(timer)


def with_quantiser_of_dwells(setup: DiagnosisSetup, fit: Fit, library: Library) -> DiagnosisSetup:
    """The setup with the timer estimated from the dwells beside a fit; unchanged where there is none."""
    if not setup.quantisers:
        return setup
    setup.fitter.tell("the modulator's timer, by the voltages that hold the currents")
    timed = _by_dwells(setup, fit, library)
    setup.part_fitter.trace.record("quantiser", before=fit, taken=True, note="estimated from the dwells")
    return timed


def refine_quantiser_by_fit(setup: DiagnosisSetup, fit: Fit, library: Library) -> tuple[DiagnosisSetup, Fit] | None:
    """The setup with the timer estimated from all equations of a part's fit, and the fit with it.

    None where there is no timer, no misfit, or no significant gain by another timer.
    """
    limits = fit.criteria.selection
    if not setup.quantisers or fit.chi2_per_dof <= limits.detected_chi2:
        return None
    # Rounding makes the objective discontinuous in the timer's phase: the estimate by dwells is a second start.
    beside = with_quantiser_of_dwells(setup, fit, library)
    starts = (setup, fit), (beside, beside.part_fitter.relinearise(fit.model))
    timed, sharper = min(starts, key=lambda start: start[1].objective)
    gained = fit.objective - sharper.objective
    for turn in range(MAX_QUANTISER_ROUNDS):
        timed.fitter.tell("the modulator's timer, by all that the effects leave")
        timer, gain = quantiser_beside(sharper, timed.quantisers, timed.fitter.pm_flux_wb)
        gained += gain if turn == 0 else 0.0
        timed = timed.with_quantiser(timer)
        sharper = fit_with_frozen_jacobian(
            timed.part_fitter,
            sharper.model,
            rounds=MAX_ROUNDS_WITH_QUANTISER,
            tolerance=TOLERANCE_WITH_QUANTISER,
            known=sharper,
        )
        if gain < MIN_JOINT_GAIN:
            break
    return None if gained < 2.0 * limits.log_evidence * fit.chi2_per_dof else (timed, sharper)
