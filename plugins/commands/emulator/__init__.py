"""The simulated plant as a device with the drive protocol and a microcontroller's limits, in its own process."""

from plugins.commands.emulator._device import Device
from plugins.commands.emulator._emulation import Emulation, LinkSettings, run_emulation
from plugins.commands.emulator._line import Losses
from plugins.commands.emulator._programs import DeviceSettings

__all__ = ["Device", "DeviceSettings", "Emulation", "LinkSettings", "Losses", "run_emulation"]
