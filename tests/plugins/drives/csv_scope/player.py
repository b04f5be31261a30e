"""Plays what the drive `csv_scope` asks for on a simulated drive, as a script at a real-time simulator would."""

from __future__ import annotations

import json
import threading
import time
from pathlib import Path

import numpy as np
from pydantic import TypeAdapter

from plugins.drives.simulated import SimulatedDrive, SimulatedOptions
from protocols import DriveSetup, Excitation, Limits, Motor

MAPPING = """
current: {frame: abc, columns: {a: i_u, b: i_v, c: i_w}, unit: mA, scaling: amplitude_invariant}
voltage: {frame: alpha_beta, columns: {alpha: u_a, beta: u_b}, unit: V, scaling: amplitude_invariant}
bus: {column: u_dc, unit: V}
csv: {delimiter: ";"}
"""


class Player:
    """Answers each request in a folder, in order, from a thread of its own."""

    def __init__(self, folder: Path, motor: Motor) -> None:
        self.folder, self.over = folder, threading.Event()
        (folder / "mapping.yaml").write_text(MAPPING, encoding="utf-8")
        options = SimulatedOptions(watchdog_s=None)
        self.drive = SimulatedDrive(DriveSetup(motor=motor, options=options, seed=1))
        self.capabilities = self.drive.connect()
        self.thread = threading.Thread(target=self._play, name="player", daemon=True)
        self.faults: dict[str, str] = {}
        """What is answered instead, by the request's number."""

    def __enter__(self) -> Player:
        self.thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.over.set()
        self.thread.join()

    def _play(self) -> None:
        answered: set[Path] = set()
        while not self.over.is_set():
            for path in sorted(set(self.folder.glob("*.request.json")) - answered):
                answered.add(path)
                self._answer(path.name[:4], json.loads(path.read_text(encoding="utf-8")))
            time.sleep(0.005)

    def _answer(self, number: str, request: dict[str, object]) -> None:
        if number in self.faults:
            (self.folder / f"{number}.fault").write_text(self.faults[number], encoding="utf-8")
            return
        match request["request"]:
            case "arm":
                self.drive.disarm()
                self.drive.arm(Limits.model_validate(request["limits"]))
            case "ramp_down":
                self.drive.ramp_down()
            case "disarm":
                self.drive.disarm()
            case "play":
                excitation: Excitation = TypeAdapter(Excitation).validate_python(request["excitation"])
                self._measure(number, excitation)
        answer = self.folder / str(request["answer"])
        if request["request"] == "play":
            (self.folder / f"{number}.part").replace(answer)
        else:
            answer.touch()

    def _measure(self, number: str, excitation: Excitation) -> None:
        blocks = [block for block in self.drive.execute(excitation) if len(block)]
        alpha, beta = 1e3 * np.concatenate([block.i_ab for block in blocks]).T
        v = np.concatenate([block.v_ab for block in blocks])
        v_dc = np.concatenate([block.v_dc for block in blocks])
        third = np.sqrt(0.75) * beta
        table = np.column_stack([alpha, -0.5 * alpha + third, -0.5 * alpha - third, v, v_dc])
        np.savetxt(
            self.folder / f"{number}.part", table, "%.7g", delimiter=";", header="i_u;i_v;i_w;u_a;u_b;u_dc", comments=""
        )
