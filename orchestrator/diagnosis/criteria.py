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
    """Distance of the test functions in trapezoids, half the length of one: short beside a trapezoid."""
    held_out_from: int = _is(10, "1", "practice")
    """Injection points below which none is kept out of the fits for validation: the map needs them."""
    most_samples: int = _is(2_400_000, "1", "budget")
    """Samples of injection that are read; longer recordings are thinned."""
    averaged_step: float = _is(0.002, "1", "simulated")
    """Largest step of the current from one averaged sample to the next, as a part of the segment's largest current."""
    averaged_noise: float = _is(0.2, "1", "theory")
    """Largest such step as a part of the noise's standard deviation: a smaller one is lost in the noise."""
    most_averaged_at_rest: int = _is(25, "1", "budget")
    """Readings of a hold, or with gates off, in one averaged sample."""
    most_averaged_in_sweeps: int = _is(5, "1", "simulated")
    """Readings of a sweep in one averaged sample: its plateaus and corners are short."""


class FittingCriteria(Strict):
    """Resolution and smoothness of the map, and how much may be computed."""

    roughness: float = _is(3.0, "L/I^2", "simulated")
    """Prior standard deviation of the map's fourth derivatives: saturation bends L by itself over the range I."""
    intervals: tuple[int, ...] = _is((6, 8, 10), "1", "simulated")
    """Spline intervals on each axis that are tried, one after the other."""
    sharper_intervals: tuple[int, ...] = _is((14, 20, 28, 40), "1", "practice")
    """Spline intervals along one axis for iron that saturates sharply: machines with bridges or barriers bend within a
    tenth of the rated current."""
    most_map_numbers: int = _is(350, "1", "budget")
    """Coefficients that such a fine map may have."""
    most_effort: float = _is(3e8, "1", "budget")
    """Samples times columns that a search may take."""
    most_effort_per_sample: float = _is(600.0, "1", "budget")
    """Columns that a search may take for each sample of a large recording, where that is more."""


class SelectionCriteria(Strict):
    """What it takes for an effect to be added to the model and to be named. The verdict has limits of its own."""

    detected_chi2: float = _is(1.08, "1", "simulated")
    """chi2 per degree of freedom above which the search goes on: noise alone stays within 1.00 +- 0.05."""
    log_evidence: float = _is(16.0, "nat", "theory")
    """Gain for an effect to be added: chance alone reaches this once in some 1e6 tries, and some twenty effects with
    shapes to choose from are tried on each recording."""
    prior_probability: float = _is(0.2, "1", "practice")
    """Probability that any one effect of the library shows in a recording, before it is examined."""
    tie: float = _is(3.0, "nat", "theory")
    """Difference in log evidence below which two models are indistinguishable: odds of twenty to one."""
    named_share: float = _is(0.05, "1", "practice")
    """Part of the first model's error, rms in any kind of stage, from which an effect is named as a cause."""
    most_trials: int = _is(5, "1", "budget")
    """Effects that are refitted in one round."""
    most_effects: int = _is(6, "1", "practice")
    """Effects that a model may have."""
    few_views: int = _is(16, "1", "simulated")
    """Operating points below which a note says that they are few."""


class MaterialityCriteria(Strict):
    """What counts for an engineer, whatever the noise lets see."""

    material_flux: float = _is(0.002, "1", "practice")
    """Part of the rated flux by which an effect has to move the map to be material."""
    material_voltage: float = _is(0.005, "1", "practice")
    """Part of the excitation's rms voltage, in any kind of stage, from which an effect is material."""


class VerdictCriteria(Strict):
    """Limits of the verdict, by their names in `VerdictLimits`. The search knows them only through the verdict."""

    noise_chi2: float = _is(1.08, "1", "simulated")
    """chi2 per degree of freedom up to which a model fits within the noise."""
    chance_sigmas: float = _is(3.0, "1", "theory")
    """Excess chi2 that chance makes where there are few readings, in its standard deviations sqrt(2 / dof)."""
    explained_fraction: float = _is(0.05, "1", "practice")
    """Part of the first error (an amplitude) that may be left for ``explained``."""
    mostly_explained_fraction: float = _is(0.30, "1", "practice")
    """Part of the first error (an amplitude) that may be left for ``mostly_explained``."""
    explained_excess_chi2: float = _is(0.4, "1", "simulated")
    """Largest chi2 - 1, fitted or held out, for ``explained``. The right effects at three times their usual size, in
    slightly other forms, leave 0.3 at most."""
    mostly_explained_excess_chi2: float = _is(1.5, "1", "practice")
    """Largest chi2 - 1 for ``mostly_explained``."""
    immaterial_excess_chi2: float = _is(4.0, "1", "practice")
    """Largest chi2 - 1 for ``mostly_explained`` where the residual is within ``explained_fraction`` and immaterial.
    A hidden effect that was not named left 7.8."""
    noise_accuracy_excess_chi2: float = _is(0.15, "1", "practice")
    """chi2 - 1 that the accuracy of the noise permits where the residual is immaterial: quantum, colour and ripple of a
    reading are known to some percent each."""
    clean_excess_chi2: float = _is(1.0, "1", "simulated")
    """Largest chi2 - 1 for ``clean`` where the residual is negligible."""
    negligible_voltage: float = _is(5e-4, "1", "practice")
    """Part of the excitation's voltage that is negligible: readings with far less noise have errors of their own."""
    shape_widths: float = _is(4.0, "1", "simulated")
    """Standard deviations of its prior by which a shape parameter may be off the usual."""
    large_effect_widths: float = _is(1.5, "1", "simulated")
    """Standard deviations of its prior beyond which an effect is larger than in most drives."""
    large_effects: int = _is(3, "1", "simulated")
    """Number of such large effects from which they are jointly implausible."""
    noise_of_excitation: float = _is(0.1, "1", "practice")
    """Noise over the excitation's rms voltage beyond which a good fit proves nothing."""
    current_error: float = _is(0.05, "1", "practice")
    """rms error of the simulated current over its range beyond which a good fit proves nothing."""
    chance_probability: float = _is(1e-6, "1", "practice")
    """Probability below which readings without current that contradict the model are not due to chance."""
    widest_band_percent: float = _is(1.0, "%", "practice")
    """Half width of the map's 95 % band, of the rated flux, beyond which the map is not reliable."""


class UncertaintyCriteria(Strict):
    """What counts as the scatter of a modulator's timer."""

    scatter_chance: float = _is(1e-4, "1", "practice")
    """Probability below which voltages that scatter more at one PWM frequency than at another are no timer's."""


class Criteria(Strict):
    """All settings of a diagnosis, by the room that they belong to."""

    weak_form: WeakFormCriteria = WeakFormCriteria()
    fitting: FittingCriteria = FittingCriteria()
    selection: SelectionCriteria = SelectionCriteria()
    materiality: MaterialityCriteria = MaterialityCriteria()
    verdict: VerdictCriteria = VerdictCriteria()
    uncertainty: UncertaintyCriteria = UncertaintyCriteria()
    design: DesignCriteria = DesignCriteria()
    rehearsal: RehearsalCriteria = RehearsalCriteria()
