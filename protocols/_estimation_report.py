"""What estimation reports: `estimates.json` and the JSON of `fluxbench estimate`.

Every number is finite or null. What other versions have written is read: keys that are not known are passed over.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Self

from pydantic import Field, computed_field

from protocols._base import Lenient
from protocols._estimates import AxisPercent, Basis, ClosedForm, MapChecks, ResistanceEstimate
from protocols._remarks import Number, Remark, Remarks
from protocols._usability import CheckOutcome, MapCriteria, Usability, UsabilityCheck


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
