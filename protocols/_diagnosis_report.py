"""What a diagnosis reports: the JSON of `fluxbench diagnose`, `explain`, `add` and `remove`.

Every number is finite or null. What other versions have written is read: keys that are not known are passed over.
"""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field

from protocols._base import Lenient
from protocols._comparison_report import NoiseFloor
from protocols._estimates import Interval
from protocols._remarks import Number, Remarked
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

LARGE_REMAINDER_FRACTION = 0.5
"""Part of the first error, beyond the noise, above which most of it is left."""


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
    """Probability that it, or one of its twins in its place, is present beside all others in the model."""
    share: Number = None
    """Part of the first model's error, rms; the largest over holds, sweeps, means under injection and ripple."""
    share_in: str | None = None
    """Which of these it is of: a kind of stage, or ``ripple``. Files of older versions have none."""
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
        return self.verdict == "unknown_remains" and fraction is not None and fraction > LARGE_REMAINDER_FRACTION


class EffectBasis(Lenient):
    """Evidence for a named effect."""

    name: str
    relative_size: Number
    log_evidence: Number
    """Gain of the move that added it [nat]."""
    probability: Number
    share: Number
    """Share of the first model's error."""
    share_in: str | None = None
    """Kind of stage that this share is of, or ``ripple``."""
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
    next_steps: tuple[str, ...] = ()
    """What to do with the map and the model, as the report says it; an indented line is a detail of the one before."""
    notes: tuple[str, ...] = ()
    """What the named effects remark on their sizes, such as which leg to look at."""


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
