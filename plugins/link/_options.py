"""Options that drives on every link have. They choose; they open nothing."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from plugins.wire import TELEMETRY_PERIOD_S
from protocols import Strict

Seconds = Annotated[float, Field(gt=0.0)]


class LinkOptions(Strict):
    """Options of every drive behind a link."""

    capture: Literal["raw", "demodulated"] = "raw"
    """Injections sample by sample, or as ripple demodulated on the drive: a hundredth of the data."""
    connect_timeout_s: Seconds = 2.0
    """Time to be taken up by a drive that is starting, that another host seems to have armed, or that ramps down."""
    answer_timeout_s: Seconds = 0.8
    """A request that is not answered within this time is given up."""
    telemetry_period_s: Annotated[float, Field(ge=0.001, le=10.0)] = TELEMETRY_PERIOD_S
    """Period of the drive's status; silence for three of them is a lost link."""
    clear_fault: bool = False
    """Forget the fault that the drive has latched, on connecting: after somebody has seen to its cause."""
