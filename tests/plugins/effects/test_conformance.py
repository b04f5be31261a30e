"""Every built-in effect keeps the contract of effects."""

from __future__ import annotations

from orchestrator.testing import EffectConformance
from plugins.effects.frame import BrakeCompliance, RotorMisalignment
from plugins.effects.inverter import BusSag, DeadTime, DeviceDrop, VoltageBias
from plugins.effects.iron import EddyCurrents, Hysteresis, MagnetHeating, SlotHarmonics
from plugins.effects.resistance import PhaseResistanceImbalance, SkinEffect, WindingHeating
from plugins.effects.sensors import CurrentGainMismatch, CurrentNonlinearity, CurrentOffset
from plugins.effects.timing import CurrentFilter, VoltageDelay
from protocols import Effect


class TestDeadTime(EffectConformance):
    def make_effect(self) -> Effect:
        return DeadTime()


class TestDeviceDrop(EffectConformance):
    def make_effect(self) -> Effect:
        return DeviceDrop()


class TestVoltageBias(EffectConformance):
    def make_effect(self) -> Effect:
        return VoltageBias()


class TestBusSag(EffectConformance):
    def make_effect(self) -> Effect:
        return BusSag()


class TestVoltageDelay(EffectConformance):
    def make_effect(self) -> Effect:
        return VoltageDelay()


class TestCurrentFilter(EffectConformance):
    def make_effect(self) -> Effect:
        return CurrentFilter()


class TestCurrentGainMismatch(EffectConformance):
    def make_effect(self) -> Effect:
        return CurrentGainMismatch()


class TestCurrentOffset(EffectConformance):
    def make_effect(self) -> Effect:
        return CurrentOffset()


class TestCurrentNonlinearity(EffectConformance):
    def make_effect(self) -> Effect:
        return CurrentNonlinearity()


class TestPhaseResistanceImbalance(EffectConformance):
    def make_effect(self) -> Effect:
        return PhaseResistanceImbalance()


class TestWindingHeating(EffectConformance):
    def make_effect(self) -> Effect:
        return WindingHeating()


class TestSkinEffect(EffectConformance):
    def make_effect(self) -> Effect:
        return SkinEffect()


class TestRotorMisalignment(EffectConformance):
    def make_effect(self) -> Effect:
        return RotorMisalignment()


class TestBrakeCompliance(EffectConformance):
    def make_effect(self) -> Effect:
        return BrakeCompliance()


class TestEddyCurrents(EffectConformance):
    def make_effect(self) -> Effect:
        return EddyCurrents()


class TestHysteresis(EffectConformance):
    def make_effect(self) -> Effect:
        return Hysteresis()


class TestMagnetHeating(EffectConformance):
    def make_effect(self) -> Effect:
        return MagnetHeating()


class TestSlotHarmonics(EffectConformance):
    def make_effect(self) -> Effect:
        return SlotHarmonics()
