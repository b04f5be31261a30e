"""The drive's conformance kit: all checks in one class to subclass."""

from __future__ import annotations

from orchestrator.testing._drive_captures import DriveCaptureChecks
from orchestrator.testing._drive_contract import DriveContractChecks
from orchestrator.testing._drive_instruments import DriveInstrumentChecks
from orchestrator.testing._drive_interlocks import DriveInterlockChecks
from orchestrator.testing._drive_safety import DriveSafetyChecks


class DriveConformance(
    DriveContractChecks, DriveCaptureChecks, DriveInstrumentChecks, DriveInterlockChecks, DriveSafetyChecks
):
    """Checks that a drive plugin keeps the contract of `protocols.Drive`.

    Subclass it in a test file, in a class whose name begins with ``Test``, and give two methods:

    - ``make_drive(setup)`` returns a new drive, not connected;
    - ``setup()`` returns its `DriveSetup`: nameplate, options, seed.

    Held currents stay below three fifths of the rated one, a ripple goes up to it; all is sized by
    the nameplate and by what the drive says of itself. On hardware: rotor locked, somebody beside
    it, and a minute. The class attributes ending in ``_tolerance`` may be widened up to the bound
    that each names, for drives that measure coarsely; `prepare` is the place for what has to be
    done after connecting (the kit engages the brake, where there is one); where an instrument shows
    whether the bridge is on, `bridge_is_on` reads it, and where interlock inputs can be opened,
    `open_interlocks` opens them.
    """
