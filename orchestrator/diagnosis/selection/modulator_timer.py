"""When a modulator's timer is asked for, and beside which fit: at first, and again as forms become right."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from orchestrator.diagnosis.fitting.baseline import DiagnosisSetup
from orchestrator.diagnosis.fitting.candidates import Candidate
from orchestrator.diagnosis.fitting.chords import LEAST_JOINT_GAIN
from orchestrator.diagnosis.fitting.model import Fit
from orchestrator.diagnosis.selection.joint_search import briefly_refitted
from orchestrator.diagnosis.uncertainty.command_traces import command_traces
from orchestrator.diagnosis.uncertainty.scatter import likelihood_of
from orchestrator.diagnosis.uncertainty.timer_beside_fit import timer_beside
from orchestrator.diagnosis.uncertainty.timer_in_rests import timer_near
from orchestrator.diagnosis.uncertainty.timer_search import timers_in

TIMER_ROUNDS: int = 4
"""How often timer and fit are estimated, each given the other."""


def with_its_timer(setup: DiagnosisSetup, fit: Fit, library: Sequence[Candidate]) -> DiagnosisSetup:
    """The setup with the voltages that the modulator's timer lets through, where the readings bear one.

    Where currents only rest at a PWM frequency, the phases there are told beside a fit, all effects following.
    """
    prepared = setup.prepared
    setup.fitter.tell("is a command rounded? A modulator's timer")
    resistance_ohm = prepared.manifest.motor.stator_resistance_ohm or 1.0
    traces = command_traces(prepared, (setup.l_d_h, setup.l_q_h), resistance_ohm)
    bus_v = prepared.manifest.drive.dc_bus_voltage_v
    timers = timers_in(traces, bus_v, prepared.criteria.selection.log_evidence)
    if not timers:
        return setup
    likelihood = likelihood_of(setup.coarse_fitter, fit, library)
    scatter = likelihood.likeliest((True, True), dithered=False)
    timer, _ = timer_near(setup.coarse_fitter.prepared, likelihood, scatter, timers)
    return replace(setup.with_timer(timer), timers=timers)


def with_sharper_timer(setup: DiagnosisSetup, fit: Fit, library: Sequence[Candidate]) -> DiagnosisSetup:
    """The setup with the modulator's timer as the dwells show it beside a fit; as it was, where there is none."""
    if not setup.timers:
        return setup
    setup.fitter.tell("the modulator's timer, by the voltages that hold the currents")
    likelihood = likelihood_of(setup.bare.coarse_fitter, fit, library)
    scatter = likelihood.likeliest((True, True), dithered=False)
    timer, _ = timer_near(setup.coarse_fitter.prepared, likelihood, scatter, setup.timers)
    setup.coarse_fitter.trace.record("quantiser", before=fit, taken=True, note="estimated from the dwells")
    return setup.with_timer(timer)


def with_timer_of_fit(
    setup: DiagnosisSetup, fit: Fit, library: Sequence[Candidate]
) -> tuple[DiagnosisSetup, Fit] | None:
    """The setup with the timer as every equation of a part's fit shows it, and the fit so.

    None where there is no timer, where nothing is left, or where another is hardly likelier.
    """
    limits = fit.criteria.selection
    if not setup.timers or fit.chi2_per_dof <= limits.detected_chi2:
        return None
    # No descent leads over a command's jump, which a phase estimated beside wrong forms may lie beyond; dwells do.
    beside = with_sharper_timer(setup, fit, library)
    starts = (setup, fit), (beside, beside.coarse_fitter.renewed(fit.model))
    timed, sharper = min(starts, key=lambda start: start[1].objective)
    gained = fit.objective - sharper.objective
    for turn in range(TIMER_ROUNDS):
        timed.fitter.tell("the modulator's timer, by all that the effects leave")
        timer, gain = timer_beside(sharper, timed.timers, timed.fitter.pm_flux_wb)
        gained += gain if turn == 0 else 0.0
        timed = timed.with_timer(timer)
        sharper = briefly_refitted(timed.coarse_fitter, sharper.model, sharper)
        if gain < LEAST_JOINT_GAIN:
            break
    return None if gained < 2.0 * limits.log_evidence * fit.chi2_per_dof else (timed, sharper)
