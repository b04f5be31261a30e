"""The simulated plant behind the drive protocol, as a process of its own with a microcontroller's limits."""

from plugins.commands.emulator._device import Device
from plugins.commands.emulator._emulation import Emulation, LinkSettings, run_emulation
from plugins.commands.emulator._line import Losses
from plugins.commands.emulator._programs import DeviceSettings

__all__ = ["Device", "DeviceSettings", "Emulation", "LinkSettings", "Losses", "run_emulation"]
