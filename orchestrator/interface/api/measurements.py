"""An open run or recording: its waveforms as tables, and its stored results. Computes nothing."""

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
    """The waveforms and results of a recording; results are read on access.

    It may be used wherever a path is expected.

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
        """The manifest: motor, drive and segments."""
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
        match = next((s for s in self.segments if s.id == segment), None)
        if match is None:
            ids = f"{self.segments[0].id} to {self.segments[-1].id}" if self.segments else "none"
            raise InputError(str(self.path), segment, f"no such segment; there are {len(self.segments)}: {ids}")
        return self.recording.load(match)

    def waveforms(self, segment: str) -> pd.DataFrame:
        """The waveforms of a segment by its id, as a table.

        Returns
        -------
        DataFrame
            Indexed by ``time_s`` since the start of the experiment; peak-valued currents [A] and voltages [V] in the
            stator frame (``i_alpha_a``, ``v_alpha_v``, ...) and at the manifest's rotor angle (``i_d_a``, ``v_d_v``,
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
        """The latest estimates; raises `RecordingError` where there are none."""
        from orchestrator.estimation import load_estimates

        return load_estimates(self.path)

    @property
    def flux_map(self) -> xr.Dataset:
        """The recommended map over ``i_d``, ``i_q``; raises `RecordingError` where there is none."""
        from orchestrator.estimation import RECOMMENDED_MAP, flux_dataset, load_flux_map

        flux_map = load_flux_map(self.path / RECOMMENDED_MAP)
        return flux_dataset(flux_map, motor=self.manifest.motor.name, recording=self.manifest.name)

    @property
    def diagnosis(self) -> SavedDiagnosis:
        """The latest diagnosis: report, words, and steps for drawing; raises `InputError` where there is none."""
        from orchestrator.diagnosis import load_diagnosis

        diagnosis = load_diagnosis(self.path)
        if diagnosis is None:
            raise InputError(str(self.path), "", "was not diagnosed yet: `diagnose` does it")
        return diagnosis

    @property
    def model(self) -> MotorModel:
        """The current model; raises `RecordingError` where there is none."""
        return read_model(self.path)


def open(path: str | PathLike[str]) -> Measurements:
    """Open a run or recording.

    Raises
    ------
    RecordingError
        Where the path is none, with the file and field of the error.
    """
    return Measurements(open_any(Path(path)))
