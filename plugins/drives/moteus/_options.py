"""Options of the drive `moteus`. They choose; they open nothing."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from protocols import Positive, Strict


class MoteusOptions(Strict):
    """Options of the drive `moteus`: either `port`, or a bus by `interface` and `channel`."""

    port: Annotated[str, Field(min_length=1)] | None = None
    """Serial port of an fdcanusb (or of the board's own UART)."""
    interface: Annotated[str, Field(min_length=1)] = "socketcan"
    """CAN FD interface, as python-can names it."""
    channel: Annotated[str, Field(min_length=1)] | None = None
    """Channel of the CAN FD interface."""
    id: Annotated[int, Field(ge=1, le=126)] = 1
    """The board's identifier on its bus."""
    sampling_frequency_hz: Annotated[float, Field(ge=1.0, le=200.0)] = 20.0
    """Readings a second while capturing; each takes several exchanges on the bus."""
    watchdog_s: Annotated[float, Field(ge=0.05, le=5.0)] = 0.3
    """Without a heartbeat for this long the board stops by itself."""
    connect_timeout_s: Positive = 3.0
    """Time for the board to say who it is and how it is configured."""
    clear_fault: bool = False
    """Forget the fault that the board has latched, on connecting: after somebody has seen to its cause."""

    @model_validator(mode="after")
    def _one_way_to_the_board(self) -> Self:
        if (self.port is None) == (self.channel is None):
            raise ValueError("give either port (an fdcanusb) or channel (a CAN FD bus)")
        return self

    @property
    def where(self) -> str:
        """The board's address, for messages."""
        return f"moteus {self.id} on {self.port or f'{self.interface}:{self.channel}'}"
