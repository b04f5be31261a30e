"""The settings of a diagnosis that a user may change: significance, materiality, limits, resolution and budget.

Each has its unit, its reason and its source (`orchestrator.validation.thresholds`). A report says which values it
was made with. All other constants stand beside the code that uses them.
"""

from __future__ import annotations

from orchestrator.experiment_design.criteria import DesignCriteria, RehearsalCriteria
from orchestrator.validation.thresholds import threshold as _is
from protocols import Strict


class WeakFormCriteria(Strict):
    """How a recording is cut into test functions, averaged and thinned."""

    hat_s: float = _is(0.010, "s", "simulated")
    """Spacing of the test functions in trapezoids, half the length of one: much shorter than a trapezoid."""
    held_out_from: int = _is(10, "1", "practice")
    """Number of injection points below which none is held out for validation: the map needs them all."""
    most_samples: int = _is(2_400_000, "1", "budget")
    """Maximum number of injection samples; longer recordings are thinned."""
    averaged_step: float = _is(0.002, "1", "simulated")
    """Largest step of the current from one averaged sample to the next, as a part of the segment's largest current."""
    averaged_noise: float = _is(0.2, "1", "theory")
    """Largest such step relative to the noise's standard deviation, which hides smaller ones."""
    most_averaged_at_rest: int = _is(25, "1", "budget")
    """Maximum number of readings of a hold, or with gates off, in one averaged sample."""
    most_averaged_in_sweeps: int = _is(5, "1", "simulated")
    """Maximum number of readings of a sweep in one averaged sample: its plateaus and corners are short."""


class FittingCriteria(Strict):
    """Resolution and smoothness of the map, and the computation budget."""

    roughness: float = _is(3.0, "L/I^2", "simulated")
    """Prior standard deviation of the map's fourth derivatives; saturation changes L by about L over the range I."""
    intervals: tuple[int, ...] = _is((6, 8, 10), "1", "simulated")
    """Spline intervals on each axis, in the order in which they are tried."""
    sharper_intervals: tuple[int, ...] = _is((14, 20, 28, 40, 56, 80), "1", "practice")
    """Spline intervals along one axis for sharp saturation, within a twentieth of the current's range at bridges."""
    most_map_numbers: int = _is(700, "1", "budget")
    """Maximum number of coefficients of such a fine map. With 350 three of three machines whose bridges saturate within
    5 to 10 % of the range had chi2 of 1.2 to 2.5 and a false brake backlash; with 700 it is 1.01 to 1.03."""
    most_effort: float = _is(3e8, "1", "budget")
    """Budget of a search in samples times columns."""
    most_effort_per_sample: float = _is(600.0, "1", "budget")
    """Budget of a search in columns per sample, used where it is larger (long recordings)."""


class SelectionCriteria(Strict):
    """Thresholds for adding and naming effects. The verdict has separate limits."""

    detected_chi2: float = _is(1.08, "1", "simulated")
    """chi2 per degree of freedom above which the search continues: noise alone stays within 1.00 +- 0.05."""
    log_evidence: float = _is(16.0, "nat", "theory")
    """Gain required to add an effect: chance alone reaches it once in about 1e6 trials, and about twenty effects with
    several shapes are tried on each recording. In the report two effects are indistinguishable below it."""
    prior_probability: float = _is(0.2, "1", "practice")
    """Prior probability that a given effect of the library is visible in a recording."""
    tie: float = _is(3.0, "nat", "theory")
    """Difference in log evidence below which the search prefers neither of two models: odds of twenty to one."""
    named_share: float = _is(0.05, "1", "practice")
    """Contribution of an effect in any kind of stage over the first model's rms error from which it is a cause."""
    most_trials: int = _is(5, "1", "budget")
    """Maximum number of effects refitted in one round."""
    few_views: int = _is(16, "1", "simulated")
    """Number of operating points below which a remark says that they are few."""


class MaterialityCriteria(Strict):
    """Sizes that matter in engineering, regardless of the noise."""

    material_flux: float = _is(0.002, "1", "practice")
    """Change of the map by an effect, relative to the rated flux, from which it is material."""
    material_voltage: float = _is(0.005, "1", "practice")
    """Contribution of an effect in any kind of stage over the excitation's rms voltage from which it is material."""


class VerdictCriteria(Strict):
    """Limits of the verdict, named as in `VerdictLimits`."""

    noise_chi2: float = _is(1.08, "1", "simulated")
    """chi2 per degree of freedom up to which a model fits within the noise."""
    least_chi2: float = _is(0.5, "1", "simulated")
    """chi2 per degree of freedom below which the noise was overestimated and may hide an effect. Coarsely rounded
    readings have 0.68; where a response to the voltage was taken for noise it was 0.0098."""
    chance_sigmas: float = _is(3.0, "1", "theory")
    """Excess chi2 attributed to chance with few readings, in its standard deviations sqrt(2 / dof)."""
    explained_fraction: float = _is(0.05, "1", "practice")
    """Largest ratio of the final error to the first (of amplitudes) for ``explained``."""
    mostly_explained_fraction: float = _is(0.30, "1", "practice")
    """Largest ratio of the final error to the first (of amplitudes) for ``mostly_explained``."""
    explained_excess_chi2: float = _is(0.4, "1", "simulated")
    """Largest chi2 - 1, fitted or held out, for ``explained``, and for ``clean`` where the residual is immaterial. The
    right effects at three times their usual size and in slightly different forms leave at most 0.3."""
    mostly_explained_excess_chi2: float = _is(1.5, "1", "practice")
    """Largest chi2 - 1 for ``mostly_explained``."""
    immaterial_excess_chi2: float = _is(4.0, "1", "practice")
    """Largest chi2 - 1 for ``mostly_explained`` where the residual is within ``explained_fraction`` and immaterial.
    A hidden effect that was not named left 7.8."""
    other_form_share: float = _is(0.33, "1", "simulated")
    """Part of chi2 - 1 that a mixture of the named effects' forms has to take up for ``explained_in_another_form``.
    Where the form was another it took up 0.38 to 0.69, where an effect was missing 0.04 to 0.28. Two missing effects
    that act much like a dead time left it 0.76 and 0.86, but chi2 above 25."""
    noise_accuracy_excess_chi2: float = _is(0.15, "1", "practice")
    """chi2 - 1 attributed to the noise estimate's error: quantum, colour and ripple of a reading are known to a few
    percent each."""
    clean_excess_chi2: float = _is(1.0, "1", "simulated")
    """Largest chi2 - 1 for ``clean`` where the residual is negligible."""
    negligible_voltage: float = _is(5e-4, "1", "practice")
    """Residual relative to the excitation's voltage that is negligible: below it, sensors have small errors."""
    shape_widths: float = _is(4.0, "1", "simulated")
    """Largest deviation of a shape parameter from typical, in standard deviations of its prior."""
    large_effect_widths: float = _is(1.5, "1", "simulated")
    """Size, in standard deviations of its prior, beyond which an effect is larger than in most drives."""
    large_effects: int = _is(3, "1", "simulated")
    """Number of such large effects from which they are jointly implausible."""
    noise_of_excitation: float = _is(0.1, "1", "practice")
    """Noise relative to the excitation's rms voltage beyond which a good fit is no evidence."""
    current_error: float = _is(0.05, "1", "practice")
    """rms error of the simulated current relative to its range beyond which a good fit is no evidence."""
    chance_probability: float = _is(1e-6, "1", "practice")
    """Probability below which readings without current that contradict the model are not due to chance."""
    widest_band_percent: float = _is(1.0, "%", "practice")
    """Half width of the map's 95 % band, of the rated flux, beyond which the map is not reliable."""


class UncertaintyCriteria(Strict):
    """Detection of the scatter that a modulator's timer causes."""

    scatter_chance: float = _is(1e-4, "1", "practice")
    """Probability below which a difference in voltage scatter between PWM frequencies is not due to a timer."""


class Criteria(Strict):
    """All settings of a diagnosis, grouped by package."""

    weak_form: WeakFormCriteria = WeakFormCriteria()
    fitting: FittingCriteria = FittingCriteria()
    selection: SelectionCriteria = SelectionCriteria()
    materiality: MaterialityCriteria = MaterialityCriteria()
    verdict: VerdictCriteria = VerdictCriteria()
    uncertainty: UncertaintyCriteria = UncertaintyCriteria()
    design: DesignCriteria = DesignCriteria()
    rehearsal: RehearsalCriteria = RehearsalCriteria()
