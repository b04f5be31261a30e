"""One axis of a servo drive by ingenialink: registers by name, its power stage, and a window of monitored rows."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from protocols import DriveFault, FaultCause, PluginError

CURRENT_MODE = 2
ROW_OCTETS = 4
MARGIN_S = 2.0
POLL_S = 0.02
ROWS = ("CL_CUR_D_VALUE", "CL_CUR_Q_VALUE", "CL_VOL_D_CMD", "CL_VOL_Q_CMD", "DRV_PROT_VBUS_VALUE")


class Servo:
    """A drive at the other end of a network; errors of its library become `DriveFault`.

    Parameters
    ----------
    host : str
    port : int
    dictionary : path
        The drive's own, an .xdf file of its maker.
    axis : int
    """

    def __init__(self, host: str, port: int, dictionary: Path, axis: int) -> None:
        self.where, self._axis = f"Novanta drive at {host}:{port}", axis
        self._talk = threading.RLock()
        try:
            from ingenialink.ethernet.network import EthernetNetwork
            from ingenialink.exceptions import ILError
        except ImportError as error:
            raise PluginError("drive", "novanta", f"needs pip install ingenialink ({error})") from error
        self._errors: tuple[type[Exception], ...] = (ILError, OSError, ValueError)
        self._network = EthernetNetwork()
        with self._link_errors():
            self._servo: Any = self._network.connect_to_slave(host, str(dictionary), port)

    def read(self, name: str, axis: int | None = None) -> float:
        """A register of the axis, or of another one."""
        with self._link_errors():
            return float(self._servo.read(name, subnode=self._axis if axis is None else axis))

    def write(self, values: Mapping[str, float], axis: int | None = None) -> None:
        """Write registers, one after the other."""
        with self._link_errors():
            for name, value in values.items():
                self._servo.write(name, value, subnode=self._axis if axis is None else axis)

    def state(self) -> str:
        """The state of the power stage in the library's own words: RDY, ENABLED, FAULT, ..."""
        with self._link_errors():
            return str(self._servo.get_state(self._axis).name)

    def enable(self) -> None:
        """Power stage on."""
        with self._link_errors():
            self._servo.enable(self._axis)

    def disable(self) -> None:
        """Power stage off."""
        with self._link_errors():
            self._servo.disable(self._axis)

    def forget_fault(self) -> None:
        """Reset what the drive has latched."""
        with self._link_errors():
            self._servo.fault_reset(self._axis)

    # Rows

    def most_rows(self) -> int:
        """What the drive's monitoring memory has room for."""
        return int(self.read("MON_MAX_SIZE", axis=0)) // (ROW_OCTETS * len(ROWS))

    def monitor(self, rows: int, divider: int) -> None:
        """Begin a window of so many rows, now."""
        with self._link_errors():
            self._servo.monitoring_disable()
            self._servo.monitoring_remove_all_mapped_registers()
        window = {"MON_CFG_SOC_TYPE": 0, "MON_CFG_TRIGGER_DELAY": 0, "MON_CFG_WINDOW_SAMP": rows}
        self.write({"MON_DIST_FREQ_DIV": divider, **window}, axis=0)
        with self._link_errors():
            for channel, name in enumerate(ROWS):
                self._servo.monitoring_set_mapped_register(channel, name, ROW_OCTETS, axis=self._axis)
            self._servo.monitoring_enable()
        self.write({"MON_CMD_FORCE_TRIGGER": 1}, axis=0)

    def monitored(self, rows: int, within_s: float) -> Iterator[np.ndarray | None]:
        """None while the window fills, then its rows, shape (rows, 5); raises `DriveFault` where it does not fill."""
        deadline = time.monotonic() + within_s + MARGIN_S
        while self._waiting() < rows * ROW_OCTETS * len(ROWS):
            if time.monotonic() > deadline:
                raise DriveFault(FaultCause.NO_ANSWER, f"{self.where}: no {rows} rows within {within_s + MARGIN_S:g} s")
            time.sleep(POLL_S)
            yield None
        with self._link_errors():
            self._servo.monitoring_read_data()
            channels = [self._servo.monitoring_channel_data(channel) for channel in range(len(ROWS))]
            self._servo.monitoring_disable()
        if any(len(channel) != rows for channel in channels):
            raise DriveFault(FaultCause.WRONG_DATA, f"{self.where}: rows are missing")
        yield np.array(channels, dtype=float).T

    def _waiting(self) -> int:
        with self._link_errors():
            return int(self._servo.monitoring_actual_number_bytes())

    def check(self) -> None:
        """Nothing to check: each call raises where the network is lost."""

    def close(self) -> None:
        """Let go of the network."""
        with self._link_errors():
            self._network.disconnect_from_slave(self._servo)

    def angle_rad(self) -> float:
        """The electrical angle of the drive's own frame."""
        return 2.0 * math.pi * self.read("COMMU_ANGLE_VALUE")

    @contextmanager
    def _link_errors(self) -> Iterator[None]:
        with self._talk:
            try:
                yield
            except self._errors as error:
                lines = str(error).splitlines() or [type(error).__name__]
                raise DriveFault(FaultCause.LINK_LOST, f"{self.where}: {lines[0]}") from None
