"""Every threshold of a diagnosis, in one place: what it is, its unit, why it is what it is, and where it comes from.

`orchestrator.thresholds` lists the sources. The thresholds of the recording checks and of the experiment design are
fields of `Criteria`, too: the report of a diagnosis says which values it was made with.
"""

from __future__ import annotations

from orchestrator.experiment_design.criteria import DesignCriteria, RehearsalCriteria
from orchestrator.recording_checks.criteria import ConventionCriteria
from orchestrator.thresholds import threshold as _is
from protocols import Strict


class WeakFormCriteria(Strict):
    """How a recording is cut into segments' signals and windows, and its noise measured."""

    hat_s: float = _is(0.010, "s", "simulated")
    """Distance of the hats in trapezoids; a hat is twice as long. Short beside a trapezoid, long beside a sample."""
    held_out_from: int = _is(10, "1", "practice")
    """Injection points below which none is kept out: the map needs them."""
    most_samples: int = _is(2_400_000, "1", "budget")
    """Of injection that are read; longer recordings are thinned."""
    averaged_step: float = _is(0.002, "1", "simulated")
    """Largest step of the current from one averaged sample to the next, as a part of the segment's largest current."""
    averaged_noise: float = _is(0.2, "1", "theory")
    """The same as a part of the noise's standard deviation: what is moved less is lost in it."""
    most_averaged_at_rest: int = _is(25, "1", "budget")
    """Readings of a hold or with gates off in one averaged sample."""
    most_averaged_in_sweeps: int = _is(5, "1", "simulated")
    """The same of a sweep, whose plateaus and corners are short."""


class FittingCriteria(Strict):
    """When a fit ends, when its map is made finer, and how much may be computed."""

    roughness: float = _is(3.0, "L/I^2", "simulated")
    """Prior standard deviation of the map's fourth derivatives: saturation bends L by itself over the range I."""
    intervals: tuple[int, ...] = _is((6, 8, 10), "1", "simulated")
    """Spline intervals on each axis that are tried, one after the other."""
    sharper_intervals: tuple[int, ...] = _is((14, 20, 28, 40), "1", "practice")
    """The same along one axis, for iron that saturates sharply: machines with bridges or barriers bend within a tenth
    of the rated current."""
    rougher: float = _is(3.0, "1", "practice")
    """How much rougher than before such a map may be, at each step; ..."""
    roughest: float = _is(100.0, "1", "practice")
    """... and than usual, at most."""
    sharper_share: float = _is(0.1, "1", "practice")
    """Part of what is left that a sharper map has to take away: where it is the map's, most of it goes, and where it is
    another effect's, a little."""
    sharp_takes: float = _is(0.5, "1", "practice")
    """The same of all of its sharpness in the end, when all forms and what scatters are known: most of it."""
    most_map_numbers: int = _is(350, "1", "budget")
    """That such a map may have."""
    given_intervals: int = _is(28, "1", "practice")
    """Spline intervals on each axis that are laid through a given map."""
    least_range: float = _is(0.05, "1", "practice")
    """Range of the map on an axis where no current flowed, as a part of the other's."""
    beyond_map: float = _is(0.005, "1", "practice")
    """How far currents may leave the map, as a part of its range, before it is made wider: there it goes on linearly,
    and where a rotor lies is known after the map was laid."""
    finer_above_chi2: float = _is(1.03, "1", "theory")
    """chi2 per degree of freedom above which a finer map is tried: noise alone stays within a few hundredths of one."""
    finer_below_chi2: float = _is(10.0, "1", "simulated")
    """And below which on the whole recording: where much is missing it is not the map's detail."""
    finer_gain_per_freedom: float = _is(6.0, "1", "simulated")
    """Fall of the objective that each freedom of a finer map has to be worth (chance makes one), ..."""
    finer_gain: float = _is(30.0, "1", "simulated")
    """... and what it has to be worth beyond that."""
    ripple_matters: float = _is(0.02, "1", "theory")
    """R_s over the inductance, times the carrier's period, from which on what R_s takes of the ripple within a period
    is asked for: its square over 24, 2e-5 of the voltage, is what the best recordings show."""
    known_magnet: float = _is(0.05, "psi_M or L I", "practice")
    """How far a nameplate's magnet flux is from the magnet's, as a part of it or of what the current makes."""
    unknown_magnet: float = _is(10.0, "L I", "practice")
    """The same where the nameplate has none: machines have up to as much."""
    given_map_error: float = _is(1e-4, "L I", "practice")
    """Standard deviation of a given map's fluxes for the spline that is laid through them."""
    least_gain: float = _is(0.2, "1", "theory")
    """Fall of the objective below which a step is not worth its evaluation: a tenth in log evidence."""
    least_joint_gain: float = _is(2.0, "1", "theory")
    """The same for a round of all effects together, of which each costs as much as a whole fit of one: one nat."""
    slack: float = _is(0.05, "1", "theory")
    """Rise of the objective that is rounding and renewed noise, not failure."""
    renewal_change: float = _is(1e-3, "1", "theory")
    """Relative change of chi2 below which a frame need not be renewed again."""
    first_damping: float = _is(0.1, "1", "practice")
    """Damping (of Levenberg and Marquardt) with which a step that failed is tried again; tenfold each time, ..."""
    least_damping: float = _is(2e-3, "1", "practice")
    """... a tenth after each step that kept its promise, and none from here on, ..."""
    most_damping: float = _is(50.0, "1", "practice")
    """... and the one beyond which no more is tried."""
    promise_kept: float = _is(0.75, "1", "practice")
    """Part of its promise that a damped step keeps where the next one may be damped less."""
    least_promise: float = _is(2.0, "1", "theory")
    """A promise that is not worth a second try where the first did not keep it: one in log evidence."""
    widest_step: float = _is(1.0, "1", "theory")
    """How far a shape moves in one step along kept columns, in standard deviations of its prior."""
    good_step: float = _is(0.5, "1", "practice")
    """Part of its promise that such a step keeps where the next one may be made along the same columns, and wider."""
    shorter_step: float = _is(0.3, "1", "practice")
    """By how much the next step is shorter after one that did not keep it, ..."""
    shortest_step: float = _is(0.01, "1", "practice")
    """... and the one below which no more is tried."""
    flux_turns: int = _is(2, "1", "theory")
    """How often the flux that effects see is read again where the rotor lies, and of the current that magnetises, by
    them: what a twist of 0.03 rad leaves of the torque is less by that factor each time. Once, from an earlier one."""
    same_inductance: float = _is(0.01, "1", "simulated")
    """Relative change of the mean inductance that the noise's covariance bears."""
    same_inverter: float = _is(0.1, "1", "practice")
    """Change of an inverter effect's coordinate, relative to one or to itself, that the covariance bears too."""
    most_returns: int = _is(5, "1", "simulated")
    """Steps after one that missed, in which a fit may come back to a curved valley further on."""
    column_step: float = _is(0.01, "1", "simulated")
    """Step of a secant, relative to the coordinate: far above rounding, where an effect is still nearly linear."""
    least_amplitude: float = _is(0.02, "1", "practice")
    """Coordinate of an amplitude below which the secant's step does not shrink with it."""
    probe_every: int = _is(16, "1", "budget")
    """Every so many-th segment of a stage tells which columns have moved, and which effects answer to which."""
    few_columns: int = _is(6, "1", "budget")
    """Columns that are made throughout without asking, being so few."""
    same_column: float = _is(0.02, "1", "practice")
    """Relative change of a column below which it is not made anew on all segments: a step misses by as little."""
    silent_answer: float = _is(0.001, "1", "practice")
    """Share of an inner effect's answer in a column below which it is not asked. Where two effects all but cancel, what
    is left of both columns is as small: at 0.005 a descent has ended a thousand nats above its valley."""
    asked_again: float = _is(2.0, "1", "practice")
    """Growth of an effect beyond which it is asked again whether it answers."""
    evaluation_columns: int = _is(3, "1", "budget")
    """What an evaluation without effects costs, in columns."""
    most_effort: float = _is(3e8, "1", "budget")
    """Samples times columns that a search may take, ..."""
    most_effort_per_sample: float = _is(600.0, "1", "budget")
    """... and the same for each sample of a large recording."""
    widest_plane: float = _is(2.0, "1", "practice")
    """Times the largest current used that the rated one may count for: the map is smooth on that current's scale."""


class SelectionCriteria(Strict):
    """What it takes for a recording to be diagnosed, for an effect to be named, and for what is left to be forgiven."""

    detected_chi2: float = _is(1.08, "1", "simulated")
    """chi2 per degree of freedom above which a model misses something: noise alone stays within 1.00 +- 0.05."""
    chance_sigmas: float = _is(3.0, "1", "theory")
    """... or how far chance takes it where there are few readings, in its standard deviations sqrt(2 / dof)."""
    explained: float = _is(0.05, "1", "practice")
    """Part of the error (an amplitude) that may be left for ``explained``."""
    mostly_explained: float = _is(0.30, "1", "practice")
    """The same for ``mostly_explained``."""
    explained_left: float = _is(0.4, "1", "simulated")
    """Most of chi2 - 1, fitted or held out, that may be left for ``explained``, whatever there was at first: the right
    effects at three times their usual size, in slightly other forms, leave 0.3 at most, ..."""
    mostly_left: float = _is(1.5, "1", "practice")
    """... and for ``mostly_explained``, ..."""
    immaterial_left: float = _is(4.0, "1", "practice")
    """... and where that is under ``explained`` of the first error and ``material_voltage`` of the excitation besides:
    a hidden effect that nobody had named was left over at 7.8."""
    noise_known: float = _is(0.15, "1", "practice")
    """chi2 - 1 up to which what no effect explains is how well the noise is known, where it is immaterial besides:
    quantum, colour and ripple of a reading are told to some percent each."""
    most_floor: float = _is(0.1, "1", "practice")
    """Noise over the excitation's rms voltage beyond which a good fit says nothing, ..."""
    most_current_error: float = _is(0.05, "1", "practice")
    """... and rms error of the simulated current over its range."""
    too_quiet_chi2: float = _is(0.8, "1", "theory")
    """chi2 per degree of freedom below which the readings' scatter is not the noise that it was taken for."""
    formless_left: float = _is(1.0, "1", "simulated")
    """chi2 - 1 up to which what a search has found is taken for all there is, beyond which a form must be wrong."""
    strained: float = _is(4.0, "1", "simulated")
    """Standard deviations of its prior by which a refinement bends its effect's form further than such effects are."""
    rare_size: float = _is(1.5, "1", "simulated")
    """Standard deviations of its prior beyond which an effect is larger than most drives have it, ..."""
    rare_count: int = _is(3, "1", "simulated")
    """... and the number of such effects at once from which on something else may stand behind them."""
    noteworthy_chi2: float = _is(1.5, "1", "practice")
    """chi2 per degree of freedom left without an effect, above which that is no refinement of another's form."""
    log_evidence: float = _is(16.0, "nat", "theory")
    """Gain for an effect to be added: chance alone reaches this once in some 1e6 tries, and some twenty effects with
    shapes to choose from are tried on each recording."""
    few_effects: int = _is(2, "1", "budget")
    """Effects that are looked for one by one; where they do not explain the error, all are fitted together: ..."""
    many_missing: float = _is(3.0, "1", "simulated")
    """... at once, where all of them leave so many times less than the best one more, to first order: behind one effect
    it was 3.6 to 29 on six benches of many effects, and 1.0 to 1.1 on eight of one or two."""
    named_share: float = _is(0.05, "1", "practice")
    """Part of the first model's error, rms in any kind of stage, from which on an effect is named as a cause, ..."""
    clear_of_left: float = _is(3.0, "1", "practice")
    """... and times the part that is left in the end: of one form's error another effect takes about as much."""
    material_flux: float = _is(0.002, "1", "practice")
    """Part of the rated flux by which an effect has to move the map to be material, ..."""
    material_voltage: float = _is(0.005, "1", "practice")
    """... or part of the excitation's rms voltage that it has to make in any kind of stage."""
    nothing_left: float = _is(5e-4, "1", "practice")
    """... and a tenth of that, which nobody would miss: readings whose noise is far below have errors of their own."""
    no_chance: float = _is(1e-6, "1", "practice")
    """Probability below which what a reading without current says against a model is no chance."""
    widest_band_percent: float = _is(1.0, "%", "practice")
    """Half width of the map's 95 % band, of the rated flux, beyond which the map is no longer one to be relied on."""
    overlooked_beside: float = _is(0.3, "1", "practice")
    """Part of the most that an absent effect promises from which on another is tried together with it."""
    near_enough: float = _is(3.0, "1", "budget")
    """Of chi2 with what scatters taken for noise, up to which a descent without that is gone on with where it ended."""
    joint_rounds: tuple[int, int] = _is((6, 15), "1", "budget")
    """How often the columns of all effects together are made anew: amplitudes alone, and with shapes."""
    formings: int = _is(3, "1", "budget")
    """How often all effects' forms and what scatters beside them are told anew, each in the light of the other."""
    weighings: int = _is(2, "1", "practice")
    """How often the model's own error is weighed, where it is much, and all is fitted again."""
    joint_tolerance: float = _is(1e-2, "1", "practice")
    """Gain of a round of the joint fit, as a part of the excess chi2, below which it ends."""
    prior_probability: float = _is(0.2, "1", "practice")
    """That any one effect of the library shows in a recording, before it is looked at."""
    bent_later: float = _is(0.3, "1", "simulated")
    """Part of what a flexible form brings, to first order, that is left to later: few of its numbers bring most of it,
    and with these where they belong the others look different."""
    stands_before_form: float = _is(0.5, "1", "theory")
    """Part of what is left that an absent effect has to explain to be asked before a form: the larger part."""
    detail_share: float = _is(0.5, "1", "simulated")
    """Part of what is left that a form's details have to bring to be freed: what they bring less of is another's."""
    most_bends: int = _is(8, "1", "budget")
    """Times that more of a flexible form is freed."""
    tie: float = _is(3.0, "nat", "theory")
    """Rivals this near in log evidence cannot be told apart: odds of twenty to one."""
    least_size: float = _is(0.02, "1", "simulated")
    """Effects smaller than this part of their typical size are traces."""
    least_share: float = _is(0.2, "1", "simulated")
    """Part of the excess chi2 - 1 that an effect has to remove to be added (half of it in the linear estimate)."""
    hopeful: float = _is(0.3, "1", "simulated")
    """Rivals whose linear gain is at least this part of the best one's are refitted too."""
    stand_in: float = _is(0.8, "1", "simulated")
    """Look-alikes that explain this part of what the best one does are its twins."""
    near_best: float = _is(2.0, "1", "simulated")
    """Rivals whose excess chi2 is within this factor of the best one's are fitted to the end."""
    shape_starts: tuple[float, ...] = _is((-2.0, -1.0, 1.0), "1", "theory")
    """Shapes from which a refit may start beside the typical one, in standard deviations of the prior."""
    flexible_form_needed: float = _is(1000.0, "1", "simulated")
    """Loss of chi2 beyond which, to first order, an effect's simple form cannot do."""
    hopeless: float = _is(0.1, "1", "practice")
    """Part of an effect's log evidence that may be missing after one step with another in its place; beyond, no more
    steps are taken."""
    hopeless_form: float = _is(10.0, "1", "simulated")
    """Times the chi2 of an effect's first form that its second may leave after one step; beyond, no more are taken. On
    switching benches it was 1.1 where the second form did better, and 90 where it did not."""
    most_trials: int = _is(5, "1", "budget")
    """Effects that are refitted in one round."""
    most_effects: int = _is(6, "1", "practice")
    """Effects that a model may have."""
    minor_size: float = _is(0.15, "1", "simulated")
    """Effects smaller than this part of their typical size are asked whether they can be spared."""
    spare: float = _is(0.03, "1", "simulated")
    """What minor effects may leave of chi2 - 1 when they go, over the root of what there was before the first."""
    obvious: float = _is(10.0, "1", "simulated")
    """How many times that an effect has to be worth, to first order, not to be asked at all."""
    undetected_size: float = _is(0.03, "1", "simulated")
    """Relative size of an effect that is named though the model fits without it."""
    least_certainty: float = _is(5.0, "1", "theory")
    """Amplitude of a minor effect that is named, in standard deviations with the scatter between blocks."""
    balanced_share: float = _is(10.0, "1", "practice")
    """Times the first model's whole error that an effect may take away while something unknown remains; what takes
    more is balanced by another. Sound ones took 1.7 times at most, one that stood in for another alone 3.6, balanced
    ones 28 to 236."""
    balanced_pair: float = _is(2.0, "1", "practice")
    """The same of two or more that take as much each: these balance each other. Such pairs took 2.0 to 3.6 each."""
    least_constancy: float = _is(0.2, "1", "simulated")
    """Largest scatter, relative to itself, of an effect that is named while something unknown remains."""
    one_column: float = _is(0.995, "1", "simulated")
    """Correlation above which two effects are one in the joint fit; the priors hold those that are merely alike."""
    outweighs: float = _is(1.5, "1", "simulated")
    """How much larger than all that was named the joint fit's first has to be to be spoken of, in typical sizes."""
    certain: float = _is(4.0, "1", "theory")
    """Standard deviations beyond which chance has not made an effect."""
    view_change: float = _is(0.01, "1", "simulated")
    """Relative change of chi2 beyond which effects have to be scored anew."""
    leftover_share: float = _is(0.02, "1", "practice")
    """Part of the leftover below which a shape is not worth a word, ..."""
    leftover_chi2: float = _is(20.0, "1", "theory")
    """... and the chi2 that it has to explain at least: chance makes so much of a shape's few signals once in 1e3."""
    least_current: float = _is(0.02, "1", "practice")
    """Part of the rated current that has to have flowed, ..."""
    least_current_to_noise: float = _is(5.0, "1", "theory")
    """... and how many standard deviations of a reading."""
    least_hold_s: float = _is(0.01, "s", "practice")
    """Length of a hold that tells something."""
    least_rows: int = _is(10, "1", "practice")
    """Equations of a sweep or an injection that tells something."""
    least_views: int = _is(6, "1", "practice")
    """Places of the current plane below which no cause can be named: fewer than the unknowns of the simplest map."""
    few_views: int = _is(16, "1", "simulated")
    """Places below which a note says so."""
    views_of_a_sweep: int = _is(2, "1", "theory")
    """Places that a sweep sees, both its sides; a hold and an injection see one."""
    same_current: float = _is(0.02, "1", "practice")
    """Currents nearer to each other than this part of the largest are one."""
    amplitudes_apart: float = _is(1.3, "1", "practice")
    """Ratio of two injected amplitudes that are told apart."""
    noisier_ripple: float = _is(1.1, "1", "practice")
    """Ratio of the readings' scatter under injection to that at rest from which on a note says so."""


class UncertaintyCriteria(Strict):
    """How far a fitted effect is trusted."""

    blocks: int = _is(8, "1", "practice")
    """Of the recording, between which amplitudes are compared."""
    interval: float = _is(1.96, "1", "theory")
    """Standard deviations on either side of 95 % of a normal distribution."""
    most_offset_scatter: float = _is(0.002, "1", "practice")
    """Part of the rated current by which the readings' zero may wander from segment to segment (rms) and be noise: a
    sound sensor's does, in warm-up and over minutes; more is a fault, and has to be found as one."""
    most_timer_step_s: float = _is(3.5e-8, "s", "practice")
    """Step of a modulator's timer that scatters held voltages and is noise: those of drives run at 30 MHz and more."""
    least_timer_step_s: float = _is(2e-9, "s", "practice")
    """The finest step of a timer that is looked for: those of half a gigahertz are finer than control trembles."""
    scatter_chance: float = _is(1e-4, "1", "practice")
    """Probability below which voltages that scatter more at one PWM frequency than at another are no timer's."""
    form_doubt: float = _is(5e-4, "1", "simulated")
    """Standard deviation of what any effect's form leaves out, as a part of the effect.

    A knee of another shape than any in the family shifts an inverter's fitted voltage by some 0.01 to 0.1 %, which is
    less than a user cares for and more than the noise of half a million samples.
    """
    ripple_doubt: float = _is(0.02, "1", "simulated")
    """The same where the ripple shows the effect and nothing at rest does.

    What currents at rest show is measured by several stages; where the form is wrong they contradict each other, and
    the segments' disagreement says so. The ripple has no second witness: it is one frequency, sampled some twenty
    times a period. What a sampled form leaves out there is of order R_s Ts / L, half a percent to one, and the form's
    course over frequency is carried on from that one to all others. Against a plant with forms of its own, effects
    that the ripple shows come out 2 % off (rms, one in twenty by more than 4 %), however little the noise and however
    near chi2 is to one.
    """


class PictureCriteria(Strict):
    """How much of a diagnosis is kept to be drawn."""

    most_rows: int = _is(4000, "1", "budget")
    """Rows of the residual that a step keeps."""
    most_dwells: int = _is(400, "1", "budget")
    """Points of the resistance's course."""
    least_dwell_current: float = _is(0.2, "1", "theory")
    """Part of the largest current below which a dwell says too little of R_s: its error grows as the inverse."""
    most_points: int = _is(400, "1", "budget")
    """Of one curve."""
    ripple_periods: int = _is(2, "1", "practice")
    """Injection periods that are shown."""
    longest_trapezoid_s: float = _is(2.5, "s", "budget")
    """Of a sweep."""
    settled_s: float = _is(0.1, "s", "practice")
    """Of a simulation, before a ripple is shown: the first current is a noisy sample."""
    simulated_s: float = _is(1.0, "s", "budget")
    """How much of each segment is simulated: many time constants, and both signs of a trapezoid."""
    worst_segments: int = _is(8, "1", "practice")
    """Segments that a comparison lists."""


class Criteria(Strict):
    """All thresholds of a diagnosis, by the room that they belong to."""

    weak_form: WeakFormCriteria = WeakFormCriteria()
    fitting: FittingCriteria = FittingCriteria()
    selection: SelectionCriteria = SelectionCriteria()
    uncertainty: UncertaintyCriteria = UncertaintyCriteria()
    conventions: ConventionCriteria = ConventionCriteria()
    design: DesignCriteria = DesignCriteria()
    pictures: PictureCriteria = PictureCriteria()
    rehearsal: RehearsalCriteria = RehearsalCriteria()
