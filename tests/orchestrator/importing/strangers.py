"""The waveforms of a recording as somebody who has never received of this project would have logged them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv

from orchestrator.importing import ImportReport, import_files
from orchestrator.numerics.frames import to_phases
from orchestrator.recording import Recording, open_recording
from protocols import Capture, Segment
from tests.orchestrator.importing.benches import Numbers

REDUCED = Path(__file__).parents[2] / "data" / "pm400-reduced"
FEW = ("resistance-000", "resistance-014", "classical-005", "injection-012")
HEAD = "format: fluxbench-import\nversion: 1\nname: somebody's\nmotor: plate.yaml\ndrive: plate.yaml\n"
PLATE = """
motor: {name: 400 W, pole_pairs: 2, rated_current_rms_a: 1.66, rated_voltage_rms_v: 139.3, stator_resistance_ohm: 4.25,
  d_inductance_h: 0.04325, q_inductance_h: 0.06905}
drive: {name: bench, dc_bus_voltage_v: 540, pwm_frequency_hz: 10000, voltage_delay_samples: 0}
"""


@dataclass(frozen=True)
class Log:
    """Some segments of a recording one after another, as columns."""

    t: Numbers
    i: Numbers
    """(alpha, beta), shape (n, 2)."""
    v: Numbers
    dc: Numbers
    stage: list[str]
    angle_rad: float = 0.0
    """Electrical, of the locked rotor."""

    @property
    def phases(self) -> dict[str, Numbers]:
        return dict(zip(("ia", "ib", "ic"), to_phases(self.i).T, strict=True))

    @property
    def volts(self) -> dict[str, Numbers]:
        return dict(zip(("va", "vb", "vc"), to_phases(self.v).T, strict=True))

    def rows(self, part: slice) -> Log:
        return Log(self.t[part], self.i[part], self.v[part], self.dc[part], self.stage[part], self.angle_rad)

    def of(self, *stages: str) -> Log:
        """The rows of one stage or of several that follow each other."""
        inside = np.flatnonzero(np.isin(self.stage, stages))
        return self.rows(slice(int(inside[0]), int(inside[-1]) + 1))


def log_of(names: tuple[str, ...] = FEW, recorded: Path = REDUCED) -> Log:
    """The log of a laboratory that measured these segments, all of them where none is named."""
    recording = open_recording(recorded)
    rate = recording.manifest.drive.sampling_frequency_hz
    segments = [s for s in recording.segments() if s.id in names or not names]
    captures = [recording.load(s) for s in segments]
    return Log(
        np.concatenate([s.start_s + np.arange(s.samples) / rate for s in segments]),
        np.concatenate([np.asarray(c.i_ab, float) for c in captures]),
        np.concatenate([np.asarray(c.v_ab, float) for c in captures]),
        np.concatenate([np.asarray(c.v_dc, float) for c in captures]),
        [s.stage.value for s in segments for _ in range(s.samples)],
        segments[0].rotor_angle_rad,
    )


@dataclass
class Desk:
    """A folder with a stranger's files, and the mapping that somebody wrote for them."""

    folder: Path
    mapping: str = ""
    files: list[Path] = field(default_factory=list)
    plate: str = PLATE

    def write(self, name: str, columns: Mapping[str, Any]) -> Path:
        """A CSV file of these columns."""
        path = self.folder / name
        pyarrow.csv.write_csv(pa.table({key: np.asarray(values) for key, values in columns.items()}), path)
        self.files.append(path)
        return path

    def write_mapping(self) -> Path:
        (self.folder / "plate.yaml").write_text(self.plate)
        path = self.folder / "mapping.yaml"
        path.write_text(HEAD + self.mapping)
        return path

    def run(self, out: str = "recording") -> ImportReport:
        return import_files(self.write_mapping(), self.files, self.folder / out)

    def recording(self, out: str = "recording") -> Recording:
        return open_recording(self.folder / out)

    def segments(self, out: str = "recording") -> list[tuple[Segment, Capture]]:
        recording = self.recording(out)
        return [(segment, recording.load(segment)) for segment in recording.segments()]
