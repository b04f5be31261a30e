"""A run or recording, opened: its waveforms as tables, and all that was made of them so far. Computes nothing."""

from __future__ import annotations

from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from orchestrator.recording import Recording, read_model
from orchestrator.runs import open_any
from protocols import Capture, EstimationReport, InputError, Manifest, MotorModel, RealArray, Segment

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

    from orchestrator.diagnosis import SavedDiagnosis


class Measurements:
    """What was measured, and what was made of it; results are read when they are asked for.

    It stands for its directory wherever a path is expected.

    Parameters
    ----------
    recording : Recording
    """

    def __init__(self, recording: Recording) -> None:
        self.recording = recording

    def __fspath__(self) -> str:
        return str(self.path)

    def __repr__(self) -> str:
        return f"<Measurements {self.manifest.name!r}: {len(self.segments)} segments in {self.path}>"

    @property
    def path(self) -> Path:
        """The directory."""
        return self.recording.path

    @property
    def manifest(self) -> Manifest:
        """Who was measured, and by what."""
        return self.recording.manifest

    @cached_property
    def segments(self) -> tuple[Segment, ...]:
        """All segments, in order of time."""
        return tuple(self.recording.segments())

    def capture(self, segment: str) -> Capture:
        """The waveforms of a segment by its id, as arrays.

        Raises
        ------
        InputError
            Where there is no such segment.
        RecordingError
            Where its file is damaged.
        """
        found = next((s for s in self.segments if s.id == segment), None)
        if found is None:
            ids = f"{self.segments[0].id} to {self.segments[-1].id}" if self.segments else "none"
            raise InputError(str(self.path), segment, f"no such segment; there are {len(self.segments)}: {ids}")
        return self.recording.load(found)

    def waveforms(self, segment: str) -> pd.DataFrame:
        """The waveforms of a segment by its id, as a table.

        Returns
        -------
        DataFrame
            Indexed by ``time_s`` since the start of the experiment; peak-valued currents [A] and voltages [V] in the
            stator frame (``i_alpha_a``, ``v_alpha_v``, ...) and at the believed rotor angle (``i_d_a``, ``v_d_v``,
            ...), the bus ``v_dc_v``, and ``temperature_c`` where it was measured.

        Raises
        ------
        InputError, RecordingError
            As `capture`.
        """
        import pandas as pd

        from orchestrator.numerics.frames import to_dq

        capture = self.capture(segment)
        angle = next(s.rotor_angle_rad for s in self.segments if s.id == segment)
        columns: dict[str, RealArray] = {}
        for symbol, unit, vectors in (("i", "a", capture.i_ab), ("v", "v", capture.v_ab)):
            for frame, x in ((("alpha", "beta"), vectors), (("d", "q"), to_dq(vectors, angle))):
                columns |= {f"{symbol}_{axis}_{unit}": x[:, k] for k, axis in enumerate(frame)}
        columns["v_dc_v"] = capture.v_dc
        if capture.temperature_c is not None:
            columns["temperature_c"] = capture.temperature_c
        time_s = capture.start_s + np.arange(len(capture.v_dc)) / capture.sampling_frequency_hz
        return pd.DataFrame(columns, index=pd.Index(time_s, name="time_s"))

    @property
    def estimates(self) -> EstimationReport:
        """What the estimators said last; raises `RecordingError` where nothing was estimated."""
        from orchestrator.estimation import load_estimates

        return load_estimates(self.path)

    @property
    def flux_map(self) -> xr.Dataset:
        """The recommended map over ``i_d``, ``i_q``; raises `RecordingError` where nothing was estimated."""
        from orchestrator.estimation import RECOMMENDED_MAP, flux_dataset, load_flux_map

        found = load_flux_map(self.path / RECOMMENDED_MAP)
        return flux_dataset(found, motor=self.manifest.motor.name, recording=self.manifest.name)

    @property
    def diagnosis(self) -> SavedDiagnosis:
        """The latest diagnosis: report, words, and steps to be drawn; raises `InputError` where there is none."""
        from orchestrator.diagnosis import load_diagnosis

        found = load_diagnosis(self.path)
        if found is None:
            raise InputError(str(self.path), "", "was not diagnosed yet: `diagnose` does it")
        return found

    @property
    def model(self) -> MotorModel:
        """The model as it stands; raises `RecordingError` where there is none."""
        return read_model(self.path)


def open(path: str | PathLike[str]) -> Measurements:
    """Open a run or recording.

    Raises
    ------
    RecordingError
        Where it is none, or what is wrong in it: file and field.
    """
    return Measurements(open_any(Path(path)))
