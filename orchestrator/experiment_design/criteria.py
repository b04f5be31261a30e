"""Thresholds of the experiments that are proposed or designed, with their units and sources."""

from __future__ import annotations

from orchestrator.thresholds import threshold
from protocols import Strict


class DesignCriteria(Strict):
    """The stages that are proposed, and how what they would tell is predicted."""

    least_separation: float = threshold(25.0, "1", "theory")
    """chi2 that a stage has to be predicted to separate before it is worth an operator's time: five sigma."""
    settle_s: float = threshold(0.5, "s", "practice")
    """Before each point of a stage: dozens of L/R."""
    hold_s: float = threshold(0.5, "s", "practice")
    """Of each held current: its mean is known to a hundredth of a reading's noise."""
    injection_s: float = threshold(1.0, "s", "practice")
    """At each point: one turn of the injected direction."""
    gates_off_s: float = threshold(2.0, "s", "practice")
    """Of a reading with all gates off."""
    anchor_s: float = threshold(5.0, "s", "practice")
    """Of a point that is measured once more."""
    long_hold_s: float = threshold(30.0, "s", "practice")
    """Of a hold that is to warm the winding: a part of its thermal time constant."""
    small_currents: tuple[float, ...] = threshold((0.01, 0.02, 0.05, 0.1, 0.2), "1", "practice")
    """Parts of the current, of both signs, at which what happens about zero current is looked at."""
    pwm_currents: tuple[float, ...] = threshold((0.02, 0.05, 0.15, 1.0), "1", "practice")
    """The same, to be held at two PWM frequencies: within the knee of an inverter's error, and beyond it."""
    directions: int = threshold(12, "1", "practice")
    """Of held currents all around: twice those of a three-phase winding's axes."""
    few_points: tuple[tuple[float, float], ...] = threshold(((0, 0), (0.5, 0), (0, 0.5), (-0.5, 0)), "1", "practice")
    """In parts of the current, where ripple of another amplitude or frequency is injected: zero, and off it."""
    axis_points: tuple[tuple[float, float], ...] = threshold(
        ((-1, 0), (-0.5, 0), (0.5, 0), (0, 0.5), (0, 1)), "1", "practice"
    )
    """The same where the ripple is to be seen along both axes."""
    samples_per_period: float = threshold(20.0, "1", "practice")
    """Of an injected wave, where there was none yet."""
    most_segments: int = threshold(36, "1", "budget")
    """Of the recording, evenly spread: what is known already need not be known to the last digit."""
    planned_hold_s: float = threshold(0.2, "s", "budget")
    """Of a hold that is predicted: as long as it is the same all through, a part stands for the whole."""
    planned_turn_s: float = threshold(0.1, "s", "budget")
    """The same of a turn of an injected direction."""


class RehearsalCriteria(Strict):
    """How a plan is rehearsed before it is measured, and a shortest one found."""

    noise_share: float = threshold(0.002, "1", "practice")
    """Noise of a reading over the rated current, where nobody says: a step of a 12-bit converter of four times it."""
    rehearsed_samples: int = threshold(300_000, "1", "budget")
    """Of injection that are rehearsed; longer plans are thinned as long recordings are."""
    rehearsed_hold_s: float = threshold(2.0, "s", "budget")
    """Of a hold: the rest of it is like that."""
    shapes: tuple[float, ...] = threshold((-2.0, -1.5, -1.0, -0.5, 0.5, 1.0, 1.5, 2.0), "1", "theory")
    """Other shapes in which an effect may stand in for another one, in standard deviations of the prior."""
    parted_size: float = threshold(1.0, "1", "practice")
    """Part of its typical size at which an effect has to be found, and told from another."""
    least_weight: float = threshold(1e-3, "1", "practice")
    """Part of the time below which a point of an approximate design is left out."""
    optimal_within: float = threshold(0.005, "1", "theory")
    """By how much the largest directional derivative may exceed its bound where the weights are taken as optimal."""
    most_weighings: int = threshold(20_000, "1", "budget")
    """Steps of the multiplicative algorithm."""
    most_repeats: int = threshold(100, "1", "practice")
    """How often a point may be measured before what it cannot tell is said to be out of reach."""
    margin: float = threshold(1.2, "1", "practice")
    """By how much a designed plan is to do better than asked, in size: its order is not the one it was chosen in."""
