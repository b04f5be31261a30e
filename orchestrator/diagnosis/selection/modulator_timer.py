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
from orchestrator.diagnosis.uncertainty.scatter import as_much, at_most_sound, doubting_zeros, likelihood_of
from orchestrator.diagnosis.uncertainty.timer_beside_fit import timer_beside
from orchestrator.diagnosis.uncertainty.timer_in_rests import timer_near
from orchestrator.diagnosis.uncertainty.timer_search import timers_in

TELLINGS = 4
"""How often timer, scatter and fit are told, each in the light of the others."""


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


def with_sharper_timer(
    setup: DiagnosisSetup, doubting: DiagnosisSetup, fit: Fit, library: Sequence[Candidate]
) -> tuple[DiagnosisSetup, DiagnosisSetup]:
    """Both setups with the modulator's timer as the rests tell it beside a fit, and with what scatters still."""
    if not setup.timers:
        return setup, doubting
    setup.fitter.tell("the modulator's timer, by what holds the currents that rest")
    likelihood = likelihood_of(setup.bare.coarse_fitter, fit, library)
    timer, scatter = timer_near(setup.coarse_fitter.prepared, likelihood, doubting.fitter.noise.of_model, setup.timers)
    timed = setup.with_timer(timer)
    timed.coarse_fitter.trace.record("quantiser", before=fit, taken=True, note="estimated from the dwells")
    return timed, timed.with_noise(at_most_sound(timed, scatter))


def with_timer_of_fit(
    setup: DiagnosisSetup, doubting: DiagnosisSetup, fit: Fit, library: Sequence[Candidate]
) -> tuple[DiagnosisSetup, DiagnosisSetup, Fit] | None:
    """Both setups with the timer as every equation of a part's fit tells it, and what then scatters; and the fit so.

    None where there is no timer, where nothing is left, or where another is hardly likelier. The fit may be worse where
    less scatters beside the timer: what was no effect in more noise is to be asked again.
    """
    limits = fit.criteria.selection
    if not setup.timers or fit.chi2_per_dof <= limits.detected_chi2:
        return None
    # A phase that was told beside wrong forms may be anywhere, and no descent leads over a command's jump; rests do.
    beside = with_sharper_timer(setup, doubting, fit, library)[1]
    starts = (doubting, fit), (beside, beside.coarse_fitter.renewed(fit.model))
    start = min(starts, key=lambda start: start[1].objective)
    timed, told, gained = _told(*start, library)
    if fit.objective - start[1].objective + gained < 2.0 * limits.log_evidence * fit.chi2_per_dof:
        return None
    return timed.with_noise(setup.fitter.noise.of_model), timed, told


def _told(doubting: DiagnosisSetup, fit: Fit, library: Sequence[Candidate]) -> tuple[DiagnosisSetup, Fit, float]:
    """Timer, what scatters and a part's fit, each in the light of the others.

    And how much of chi2 the timer took as it was told first; what scatters was the same until then.
    """
    gains = list[float]()
    for _ in range(TELLINGS):
        doubting.fitter.tell("the modulator's timer, by all that the effects leave")
        before = doubting.fitter.noise.of_model
        timer, gain = timer_beside(fit, doubting.timers, doubting.fitter.pm_flux_wb)
        gains.append(gain)
        timed = doubting.with_timer(timer)
        doubting = doubting_zeros(timed, likelihood_of(timed.coarse_fitter, fit, library))
        fit = briefly_refitted(doubting.coarse_fitter, fit.model, fit)
        if as_much(doubting.fitter.noise.of_model, before) and gain < LEAST_JOINT_GAIN:
            break
    return doubting, fit, gains[0]
