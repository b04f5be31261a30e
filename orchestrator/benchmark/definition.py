"""What the benchmark is: its name and version, its recordings by seed, and the names that an answer may use.

`missing-physics-1.csv` is frozen: a row a recording, with the SHA-256 of its data and of its sealed truth. A set with
other rows, plants or seeds has another version.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

NAME = "fluxbench-missing-physics"
VERSION = 1
TABLE = Path(__file__).with_name("missing-physics-1.csv")
MANIFEST, RECORDINGS, TRUTHS = "benchmark.json", "recordings", "truth"
"""In the folder of a set."""
LOG, MAPPING = "log.csv", "mapping.yaml"
"""In the folder of a recording that is a log of another tool."""
OWN_PLANTS = ("blind",)
"""Plants on which settings of fluxbench were chosen; the others are outer ones."""


@dataclass(frozen=True)
class Row:
    """One recording of the set: what it is made from, and what was made when the set was frozen.

    Attributes
    ----------
    kind : str
        Class of the benchmark.
    plant, case, index, seed : str, str, int, int
        What the plant draws the recording from.
    motor, plan : str
        Whose nameplate, and which experiment.
    without : str
        A name that answers may not use; empty where all may be used.
    log : bool
        Whether it is kept as a log of another tool.
    data_sha256, truth_sha256 : str
        Empty before the set is frozen.
    """

    id: str
    kind: str
    plant: str
    case: str
    index: int
    seed: int
    motor: str
    plan: str
    without: str
    log: bool
    data_sha256: str = ""
    truth_sha256: str = ""

    @property
    def origin(self) -> str:
        """``own`` or ``outer``."""
        return "own" if self.plant in OWN_PLANTS else "outer"


def frozen_rows(table: Path = TABLE) -> list[Row]:
    """The recordings of the set, in the order of their ids."""
    with table.open(encoding="utf-8", newline="") as file:
        return [
            Row(
                id=row["id"], kind=row["class"], plant=row["plant"], case=row["case"], index=int(row["index"]),
                seed=int(row["seed"]), motor=row["motor"], plan=row["plan"], without=row["without"],
                log=row["log"] == "yes", data_sha256=row["data_sha256"], truth_sha256=row["truth_sha256"],
            )
            for row in csv.DictReader(file)
        ]  # fmt: skip


@dataclass(frozen=True)
class Size:
    """The one number that an answer may state of an effect."""

    parameter: str
    """As the library of fluxbench calls it."""
    unit: str
    meaning: str


EFFECTS: dict[str, Size] = {
    "brake_backlash": Size("gap_rad", "rad", "play of the locked rotor, electrical"),
    "brake_compliance": Size("rad_per_nm", "rad/Nm", "twist of the locked rotor, electrical, over torque"),
    "bus_sag": Size("per_watt", "1/W", "part of the voltage that is lost, over power"),
    "current_filter": Size("time_constant_s", "s", "lag of the current readings"),
    "current_gain_mismatch": Size("gain_a_minus_b", "1", "gain of sensor a minus gain of sensor b"),
    "current_nonlinearity": Size("cubic_per_a2", "1/A^2", "c in reading = i + c i^3"),
    "current_offset": Size("offset_a_a", "A", "offset of sensor a"),
    "current_offset_drift": Size("rate_a_a_per_s", "A/s", "drift of sensor a"),
    "dead_time": Size("voltage_v", "V", "lost by a leg at large currents, at the drive's PWM frequency"),
    "device_drop": Size("voltage_v", "V", "lost by a leg at large currents, at any PWM frequency"),
    "eddy_currents": Size("core_loss_ohm", "ohm", "resistance parallel to the induced voltage"),
    "hysteresis": Size("half_width_a", "A", "half the loop's width"),
    "magnet_heating": Size("flux_change_wb", "Wb", "change of the magnet's flux"),
    "phase_resistance_imbalance": Size("extra_a_ohm", "ohm", "resistance of phase a minus that of phase c"),
    "resistance_with_temperature": Size("per_k", "1/K", "rise of R_s over the logged temperature"),
    "rotor_misalignment": Size("angle_rad", "rad", "true electrical angle minus believed one"),
    "sampling_offset": Size("offset_s", "s", "instant of the readings after the carrier's valley"),
    "skin_effect": Size("extra_ohm", "ohm", "resistance at high frequencies minus that at direct current"),
    "slot_harmonics": Size("relative", "1", "saliency of the slots over the mean inductance"),
    "third_current_sensor": Size("gain_c_minus_1", "1", "gain of sensor c minus one"),
    "voltage_bias": Size("bias_a_v", "V", "constant error of leg a"),
    "voltage_delay": Size("delay_s", "s", "by which the voltage acts late"),
    "winding_heating": Size("rise_per_watt", "1/W", "relative rise of R_s over lost power, in the end"),
}
"""Names that an answer may use."""
