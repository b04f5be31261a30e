"""The recording, version 1: the hinge between the rig and the analysis.

`recording.json` is a `Manifest`; `captures/<segment id>.parquet` holds one `Capture` a segment.
Whatever ran the motor ends up as one, and everything right of the hinge reads nothing else.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from typing import Annotated, Any, Literal, Protocol

from pydantic import Field, model_validator

from protocols._base import ArrayModel, Lenient, Phases, Samples, Vectors
from protocols._motor import Motor, Positive

SegmentId = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$", max_length=200)]
"""It names a file, and file systems take 255 bytes with all that is put before and behind it."""


class SegmentStage(StrEnum):
    """Purpose of a segment."""

    GATES_OFF = "gates_off"
    ALIGNMENT = "alignment"
    LOCK_CHECK = "lock_check"
    RESISTANCE = "resistance"
    CLASSICAL = "classical"
    INJECTION = "injection"
    STEPS = "steps"
    """Voltage steps: +-U on one axis or both, turned round where a current limit is met; nothing rests."""
    SPIN = "spin"
    """The rotor turns, driven or with the bridge off (the voltage is then the measured one): its angle is a column
    `theta_rad`, or goes on from the segment's by the setting `speed_rad_s` (electrical)."""


class Capture(ArrayModel):
    """Uniformly sampled waveforms in the stator frame, amplitude-invariant Clarke.

    Row k is taken at ``start_s + k / sampling_frequency_hz``: the current at that instant, before
    the voltage of the same row, held until the next row, acts. A drive yields one segment as
    consecutive captures; a recording hands a segment out as one.
    """

    start_s: float
    """Time of row 0 since the start of the experiment [s]."""
    sampling_frequency_hz: float
    i_ab: Vectors
    """Measured current (alpha, beta) [A], shape (n, 2)."""
    v_ab: Vectors
    """Commanded voltage (alpha, beta) [V], shape (n, 2)."""
    v_dc: Samples
    """DC-bus voltage [V], shape (n,)."""
    i_abc: Phases | None = None
    """Phase currents [A], shape (n, 3), where the drive measures all three."""
    temperature_c: Samples | None = None
    theta_rad: Samples | None = None
    """Electrical angle of the believed d axis at each row, where the rotor turns and its angle is logged."""
    clipped_rows: int = 0
    """Rows with a reading or voltage at the end of its scale, as far as the drive detects it."""

    def __len__(self) -> int:
        return int(self.i_ab.shape[0])


class DriveRecord(Lenient):
    """The drive as a recording's manifest describes it."""

    name: str
    sampling_frequency_hz: Positive
    pwm_frequency_hz: Positive | None = None
    dc_bus_voltage_v: Positive
    voltage_delay_samples: Annotated[float, Field(ge=0, le=1000)] | None = None
    """n, where v[k] acts from t_k + n Ts."""


class Segment(Lenient):
    """One uninterrupted stretch of samples, and the excitation's settings."""

    id: SegmentId
    stage: SegmentStage
    start_s: float
    samples: Annotated[int, Field(ge=1)]
    rotor_angle_rad: float = 0.0
    """The electrical angle that the operator believes in."""
    settings: dict[str, Any] = Field(default_factory=dict)
    """The set-points, never the values that were reached."""
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")] | None = None
    clipped_rows: Annotated[int, Field(ge=0)] = 0
    """Rows with a reading or voltage at the end of its scale (clipped)."""


class Manifest(Lenient):
    """`recording.json`: who was measured, by what, and which segments are complete."""

    format: Literal["fluxbench-recording"]
    version: Literal[1]
    name: str
    created: str
    motor: Motor
    drive: DriveRecord
    segments: tuple[Segment, ...]

    @model_validator(mode="after")
    def _ids_are_unique(self) -> Manifest:
        seen: set[str] = set()
        for segment in self.segments:
            if segment.id in seen:
                raise ValueError(f"segments: the id {segment.id!r} appears twice")
            seen.add(segment.id)
        return self


class RecordingReader(Protocol):
    """A recording for estimators and effects: the manifest, and waveforms on demand."""

    @property
    def manifest(self) -> Manifest:
        """The validated manifest."""
        ...

    def segments(self, *stages: SegmentStage) -> Sequence[Segment]:
        """The segments of these stages (of all, where none is named), in order of time."""
        ...

    def load(self, segment: Segment) -> Capture:
        """The segment's waveforms; raises `RecordingError` where they are not what they should be."""
        ...
