"""What estimation, comparison and diagnosis report: the JSON that is printed, kept and sent, as pydantic models.

Every number is finite or null. What other versions have written is read: keys that are not known are passed over.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from typing import Any, Literal, Self

from pydantic import Field, computed_field

from protocols._base import Lenient
from protocols._estimates import AxisPercent, Basis, ClosedForm, Interval, MapChecks, ResistanceEstimate
from protocols._remarks import Noted, Number, Remark, Remarks
from protocols._search_trace import SearchEvent
from protocols._verdict import Reason, Verdict, VerdictRecord

ShapeGroup = Literal[
    "odd_phase_current",
    "even_phase_current",
    "constant",
    "anisotropic_resistance",
    "time_resistance",
    "power_voltage",
    "sweep_direction",
    "ripple_in_phase",
    "ripple_edges",
    "map_not_even",
    "reciprocity_broken",
    "map_detail",
    "periodic",
    "other",
]


MOST = 0.5
"""Part of the first error, beyond the noise, above which most of it is left."""


class Remarked(Lenient):
    """A report with remarks; `notes` has their sentences alone."""

    remarks: Noted = ()

    @computed_field  # type: ignore[prop-decorator]
    @property
    def notes(self) -> tuple[str, ...]:
        """The remarks' sentences."""
        return tuple(remark.text for remark in self.remarks)

    def with_remark(self, remark: Remark) -> Self:
        """A copy with one more remark."""
        return self.model_copy(update={"remarks": (*self.remarks, remark)})


class NoiseFloor(Lenient):
    """Expected residual of sensor noise alone."""

    rms_v: Number
    heldout_rms_v: Number = None
    """Expected residual of the held-out stages; noise makes more of some stages than of others."""


class Companion(Lenient):
    """Another parameter, without which a recording does not determine one: where one is zero, the other moves."""

    effect: str
    parameter: str
    total: Number = None
    """The sum of both, where it is the sum that is determined; likewise its 95 % interval."""
    total_low: Number = None
    total_high: Number = None


class ParameterValue(Lenient):
    """A fitted parameter with its 95 % interval."""

    value: Number
    low: Number
    high: Number
    unit: str
    bends_form: bool = False
    """Whether it only bends the form of its effect, and has no size of its own."""
    determined_with: Companion | None = None
    """Where zero fits, but not at the other's value: the recording determines a combination of the two."""


class FoundEffect(Lenient):
    """An effect that the data ask for."""

    name: str
    parameters: dict[str, ParameterValue]
    twins: tuple[str, ...]
    """Effects that do as well in its place, in this recording."""
    derived: dict[str, ParameterValue] = Field(default_factory=dict)
    """Its parameters as quantities of a drive's data sheet, such as a dead time in seconds."""
    relative_size: Number
    """|first parameter| over its typical value (inverted where small is strong)."""
    typical: ParameterValue | None = None
    """That typical value on this machine, as the quantity of a drive's data sheet where there is one."""
    log_evidence: Number
    probability: Number = None
    """Probability that it is present, given all others in the model."""
    share: Number = None
    """Part of the first model's error, rms; the largest over holds, sweeps, means under injection and ripple."""
    material: bool | None = None
    """Whether it moves the map or the voltage by more than `Materiality` says."""


class Materiality(Lenient):
    """Sizes from which an effect is material, whatever the noise."""

    flux_percent: Number
    """Change of the map in % of the rated flux, rms over the map."""
    voltage_percent: Number
    """Voltage in % of the excitation's rms voltage, in any kind of stage."""


class JointEntry(Lenient):
    """One effect in the joint fit of the whole library."""

    name: str
    relative_size: Number
    z: Number
    parameter: str = ""
    """The amplitude that is the surest of all that the effect has."""
    size: ParameterValue | None = None
    """That amplitude with its 95 %; `high` is null where a small one is strong. Files of older versions have none."""


class Rung(Lenient):
    """The error after one more effect."""

    added: str | None
    chi2: Number
    """Per degree of freedom of the whitened training residual."""
    rms_v: Number
    heldout_rms_v: Number
    current_rms_a: Number
    effects: tuple[str, ...] = ()
    """All effects of this model: some, too small to be causes, are added without a rung of their own."""


class ShapeShare(Lenient):
    """How much of the leftover has one shape."""

    group: ShapeGroup
    share: Number


class Unexplained(Lenient):
    """What is left."""

    fraction: Number
    """sqrt((chi2_after - 1) / (chi2_before - 1))."""
    shape: tuple[ShapeShare, ...]


class NextExperiment(Lenient):
    """The stage of a procedure that separates two effects."""

    stage: dict[str, Any]
    separates: tuple[str, str]
    minutes: float
    sigmas: Interval | None = None
    """Predicted separation in standard deviations, for the sizes that the recording found, with its 95 % interval: of
    the size and of the noise. None where it cannot be predicted."""
    least_sigmas: Number = None
    """Separation from which two effects count as separated."""


class Inseparable(Lenient):
    """Two effects that no stage of the catalogue separates on this bench, at the sizes that the recording found."""

    separates: tuple[str, str]
    best_sigmas: float
    """The best stage's predicted separation in standard deviations; of those that were not measured yet."""
    least_sigmas: float
    reached_sigmas: Number = None
    """Separation by the recording, where a stage that was to separate the two has been measured; else None."""


class ManifestCorrection(Lenient):
    """Correction of manifest or mapping; a program can apply it where `field` is given."""

    text: str
    field: (
        Literal["currents", "voltages", "sampling_frequency_hz", "voltage_delay_samples", "rotor_angle_rad", "axes"]
        | None
    ) = None
    """What is to be corrected; ``axes``: the rotor's angle, with set-points and nameplate that are in its frame."""
    factor: float | None = None
    """Factor on its values."""
    matrix: tuple[tuple[float, float], tuple[float, float]] | None = None
    """Matrix on (alpha, beta), row by row."""
    add: float | None = None
    """Term to add to its value."""


class Convention(Lenient):
    """Something that manifest or logger have another way than it is: named before any physics is."""

    kind: str
    """Kind in snake_case: ``scaled_currents``."""
    what: str
    evidence: str
    correction: ManifestCorrection


class DiagnosisReport(Remarked):
    """`fluxbench diagnose --json`."""

    recording: str
    noise_floor: NoiseFloor
    verdict: Verdict
    reasons: tuple[Reason, ...] = ()
    """Why this verdict and no better one, the deciding reasons first; empty in files of older versions."""
    verdict_record: VerdictRecord | None = None
    """What the verdict follows from; null with a convention, which ends a diagnosis before any fit."""
    effects: tuple[FoundEffect, ...]
    """Sorted by share, largest first."""
    minor: tuple[FoundEffect, ...] = ()
    """Effects in the model whose share of the error is too small to name them as causes."""
    traces: tuple[str, ...]
    """Names of the minor effects, then of detected ones that are not in the model."""
    joint: tuple[JointEntry, ...]
    ladder: tuple[Rung, ...]
    unexplained: Unexplained
    next_experiment: NextExperiment | None
    convention: Convention | None = None
    """With the verdict ``convention``: no effects were searched for."""
    reproduces_current_percent: Number = None
    """rms error of the simulated current over the current's range, in percent."""
    map_error_percent: Number = None
    """Half width of the map's 95 % band, rms over the visited plane, in percent of the rated flux."""
    materiality: Materiality | None = None
    seconds: Number
    criteria: dict[str, dict[str, Any]] = Field(default_factory=dict)
    """The thresholds that it was made with, by room."""
    search: tuple[SearchEvent, ...] = ()
    """Every move of the search, in order."""

    @property
    def leaves_most(self) -> bool:
        """Whether most of the first error remains unknown: an effect that takes up a part is no cause then."""
        fraction = self.unexplained.fraction
        return self.verdict == "unknown_remains" and fraction is not None and fraction > MOST


class EffectBasis(Lenient):
    """Evidence for a named effect."""

    name: str
    relative_size: Number
    log_evidence: Number
    """Gain of the move that added it [nat]."""
    probability: Number
    share: Number
    """Share of the first model's error."""
    material: bool | None
    twins: tuple[str, ...]
    steps: tuple[int, ...]
    """The moves of the search that took it."""


class Explanation(Lenient):
    """`fluxbench explain --json`: the evidence behind a diagnosis."""

    recording: str
    verdict: Verdict
    reasons: tuple[Reason, ...]
    verdict_record: VerdictRecord | None
    search: tuple[SearchEvent, ...]
    effects: tuple[EffectBasis, ...]
    model_changes: tuple[str, ...] = ()
    """What `add` and `remove` have changed in `model.json` since: "+ dead time (does not help)"."""
    to_decide: str = ""
    """The diagnosis' words on what to measure next."""


class StageError(Lenient):
    """The residual in one kind of stage, at one PWM frequency."""

    stage: str
    pwm_frequency_hz: Number = None
    rms_v: Number
    noise_rms_v: Number = None
    """What the noise of its readings alone would leave."""
    chi2: Number
    current_rms_a: Number


class WorstSegment(Lenient):
    """A segment that the model fits badly, with its mean current."""

    segment: str
    pwm_frequency_hz: Number = None
    i_d_a: Number
    i_q_a: Number
    rms_v: Number
    noise_rms_v: Number = None
    """What the noise of its readings alone would leave."""


class CompareReport(Remarked):
    """`fluxbench compare --json`."""

    recording: str
    model: str
    noise_floor: NoiseFloor
    rms_v: Number = None
    """Over all stages, as `noise_floor` and `chi2` are."""
    chi2: Number
    stages: tuple[StageError, ...]
    worst: tuple[WorstSegment, ...]
    parity: AxisPercent
    reciprocity_percent: Number
    crossings: AxisPercent


class AddReport(Remarked):
    """`fluxbench add --json`, and `remove`."""

    effects: tuple[FoundEffect, ...]
    ladder: tuple[Rung, ...]
    unexplained: Unexplained


class DiagnosisWords(Lenient):
    """The diagnosis in words, one slot a question."""

    where_it_fails: str
    what_it_looks_like: str
    likely_cause: str
    if_added: str
    to_decide: str


class InductanceRange(Lenient):
    """Incremental inductances over a map."""

    l_dd_low_h: float
    l_dd_high_h: float
    l_qq_low_h: float
    l_qq_high_h: float
    l_dq_largest_h: float
    """In size."""


class MapReport(Lenient):
    """Summary of one flux map's file."""

    basis: Basis | None = None
    checks: MapChecks
    inductances: InductanceRange | None = None
    form: ClosedForm | None = None


class SeenByInjection(Lenient):
    """What sensorless control by injection sees at one frequency and size of the ripple, beside the large-signal map.

    The map's inductances are the slopes of its flux, which currents follow that move far; a small and fast ripple sees
    less of hysteresis and through eddy currents. Angles are electrical.
    """

    method: str
    """Method of the large-signal map."""
    frequency_hz: float
    amplitude_v: float
    """rms."""
    points: int
    """Number of injection points that the map covers too."""
    l_dd_percent: Number
    """Mean difference to the map's L_dd, in percent of that; likewise L_qq."""
    l_qq_percent: Number
    saliency_low: Number
    """Largest over smallest inductance, the least over the points and the most."""
    saliency_high: Number
    map_saliency_low: Number
    """Saliency of the map, likewise."""
    map_saliency_high: Number
    angle_error_rad: Number
    """The largest: how far cross-saturation turns the axis of least inductance, which a tracking takes for d."""
    angle_error_i_d_a: Number = None
    """Current at which it is the largest, likewise i_q."""
    angle_error_i_q_a: Number = None
    left_by_map_rad: Number
    """The largest error that is left where this turn is taken from the map instead of from the ripple."""


class CheckOutcome(StrEnum):
    """Outcome of a map's check."""

    PASSED = "passed"
    FAILED = "failed"
    NOT_POSSIBLE = "not_possible"
    """The recording does not allow it."""


class UsabilityCheck(Lenient):
    """One of the checks that decide whether a map can be relied on."""

    name: str
    """Name in snake_case: ``parity``."""
    outcome: CheckOutcome
    required: bool
    """Whether the map is not usable without it; one that is not required may be missing, but must not fail."""
    value: Number = None
    """None: not measured, or no number."""
    limit: Number = None
    """Largest `value` that passes."""
    unit: str = ""
    remark: Remark
    """Finding, or missing data."""

    @property
    def is_met(self) -> bool:
        """Whether it does not stand in the way of using the map."""
        missing = self.outcome is CheckOutcome.NOT_POSSIBLE and not self.required
        return missing or self.outcome is CheckOutcome.PASSED


class Usability(StrEnum):
    """Whether a map can be relied on."""

    USABLE = "usable"
    NOT_USABLE = "not_usable"
    """A check failed."""
    NOT_JUDGED = "not_judged"
    """No check failed, but one that is required was not possible: a diagnosis decides."""


class MapCriteria(Lenient):
    """Requirements on a usable flux map; per cent of the rated flux unless stated otherwise."""

    accuracy_percent: float = 1.0
    """What a usable map promises of its flux, rms; independent maps that differ by more cannot show it."""
    crossings_percent: float = 5.0
    """Largest difference where current paths cross. Each of two paths errs by half of it, and the largest of some ten
    crossings is 2 to 3 times their rms: more belongs to a map that errs by more than 1 % rms."""
    parity_percent: float = 5.0
    """Largest break of the symmetry in i_q, which a wrong rotor angle makes; as large as what crossings may be."""
    reciprocity_percent: float = 10.0
    """By which the slopes of a map that is not symmetric by construction may differ, of its inductance; with too few
    points it was a third and more."""
    energy_percent: float = 2.0
    """rms by which an energy may be off the map by a method that errs; one that is off all of them is wrong itself."""
    least_flux_ratio: float = 0.01
    """Injection's flux is so much larger or smaller than integration's, as a ratio less 1, where that is worth one."""
    flux_ratio_stds: float = 2.0
    """Minimum deviation in standard deviations of the ratio."""
    frequency_ratio: float = 1.5
    """Two injections are independent where their frequencies are so many times apart: delay, filter and eddy currents
    act with the frequency."""
    resistance_percent: float = 19.6
    """Half width of the 95 % interval of R_s: a nameplate without a stated error is believed as closely."""
    scatter_ratio: float = 2.0
    """Scatter of successive readings of R_s, in their own errors, beyond which it is no chance."""
    nameplate_apart: float = 0.2
    """Relative deviation of R_s and the unsaturated inductances from the nameplate that gives a remark."""
    nameplate_factor: float = 1.35
    """Ratio of theirs that no tolerance makes; all of them off the same way are a scale of the readings."""
    resistance_factor: float = 4.0
    """Ratio of R_s that nothing explains: a delta's phase has 3 times its star's R, times a tolerance of 1.35."""


class EstimatorsReport(Lenient):
    """What the estimators found; every number finite, or null where the recording does not allow it.

    The checks are the recommended map's; crossings those of the estimators where that is a diagnosed model's.
    """

    resistance: ResistanceEstimate | None
    method: str | None
    """Method of the recommended map."""
    crossings: AxisPercent | None
    parity: AxisPercent | None
    reciprocity_percent: float | None
    classical_against_injection_percent: float | None
    """rms of the flux difference between integration and injection over the latter's grid, of the rated flux."""
    usable: bool
    """Whether the recommended map can be relied on: there is one, and each of `checks` is met; see `usability`."""
    checks: tuple[UsabilityCheck, ...] = ()
    """All checks of the recommended map and of R_s, with what each found; files of older versions have none."""
    remarks: Remarks = ()
    """Objections to the map, and reasons for missing estimates."""
    maps: dict[str, MapReport] = Field(default_factory=dict)
    """Every map that was made, by method, the best first."""
    seen_by_injection: tuple[SeenByInjection, ...] = ()
    """By frequency; empty where nothing was injected, or no map rests on sweeps."""
    criteria: MapCriteria = MapCriteria()
    """Thresholds of the maps' checks."""
    files: dict[str, str] = Field(default_factory=dict)
    """The file of each result, by its name, in the folder where this report is."""

    @computed_field  # type: ignore[prop-decorator]
    @property
    def reasons(self) -> tuple[str, ...]:
        """The remarks' sentences."""
        return tuple(remark.text for remark in self.remarks)

    @computed_field  # type: ignore[prop-decorator]
    @property
    def usability(self) -> Usability:
        """Why a map is not `usable`, if it is not: a check failed, or one that is required was not possible."""
        if self.usable:
            return Usability.USABLE
        unmet = [check.outcome for check in self.checks if not check.is_met]
        is_open = self.method is not None and bool(unmet) and CheckOutcome.FAILED not in unmet
        return Usability.NOT_JUDGED if is_open else Usability.NOT_USABLE

    def with_resistance(self, resistance: ResistanceEstimate | None) -> Self:
        """The report with another R_s."""
        return self.model_copy(update={"resistance": resistance})

    def checked(self, checks: Sequence[UsabilityCheck]) -> Self:
        """The report with further checks; remarks of those not met come before all others."""
        against = tuple(check.remark for check in checks if not check.is_met)
        fields = {
            "usable": self.method is not None and all(check.is_met for check in (*self.checks, *checks)),
            "checks": (*self.checks, *checks),
            "remarks": (*against, *self.remarks),
        }
        return self.model_copy(update=fields)

    def without_check(self, name: str) -> Self:
        """The report without a check, and without its remark."""
        gone = [check.remark for check in self.checks if check.name == name]
        left = tuple(check for check in self.checks if check.name != name)
        remarks = tuple(remark for remark in self.remarks if remark not in gone)
        return self.model_copy(update={"checks": left, "remarks": remarks}).checked(())

    def objected(self, against: Sequence[Remark]) -> Self:
        """The report with objections to its use before all other remarks; unchanged where there are none."""
        if not against:
            return self
        return self.model_copy(update={"usable": False, "remarks": (*against, *self.remarks)})

    @property
    def recommended(self) -> MapReport | None:
        """The recommended map's; None where there is none."""
        return None if self.method is None else self.maps.get(self.method)

    @property
    def measured_symmetry(self) -> str | None:
        """The best method whose map has parity and reciprocity not by construction; None where all have."""
        return next((method for method, report in self.maps.items() if report.basis is not Basis.ENERGY), None)


class DeliveredModel(Lenient):
    """What a diagnosed model brought to the estimates beside its map: enough to join a later pass of the estimators."""

    title: str
    """The model in one line: where it started, and the effects that were added."""
    segments: str
    """Digest of the recording's segments: a model of other segments is an old one."""
    resistance: ResistanceEstimate
    objections: tuple[Remark, ...] = ()
    """Objections to its map."""


class EstimationReport(EstimatorsReport):
    """`estimates.json`: results of the estimators, and the model of a diagnosis."""

    model: DeliveredModel | None = None
    """The diagnosed model that has joined the estimators' maps; None before a diagnosis."""
    estimators: EstimatorsReport | None = None
    """The estimators' own report, where a diagnosed model was added."""

    @property
    def model_method(self) -> str | None:
        """The method under which `maps` has the diagnosed model's map; None where there is no model."""
        own = self.estimators.maps if self.estimators is not None else {}
        return None if self.model is None else next((name for name in self.maps if name not in own), None)
