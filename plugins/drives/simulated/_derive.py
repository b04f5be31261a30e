"""Parameters of the plant from options and nameplate; omitted options are scaled by the nameplate."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from plugins.drives.simulated._derive_switching import Ratings, derive_bench, refuse_switched_options, without_bridge
from plugins.drives.simulated._energy import Magnetics, hessian
from plugins.drives.simulated._map import FluxTable, load_table, map_energy, usable_reach
from plugins.drives.simulated._model import apply_model
from plugins.drives.simulated._polynomial import COEFFICIENTS, nameplate_energy, polynomial_energy
from plugins.drives.simulated._sensing import BenchParameters, SensorParameters
from plugins.drives.simulated._state import SQRT3, PlantParameters
from plugins.drives.simulated.effects import Effects
from plugins.drives.simulated.options import MAX_SUBSTEPS, MapMagnetics, NameplateMagnetics, Plant, SimulatedOptions
from protocols import InputError, Motor


@dataclass(frozen=True)
class Nameplate:
    """The motor as the drive's nameplate has it; peak values."""

    pole_pairs: int
    rated_a: float
    resistance_ohm: float
    l_d_h: float
    l_q_h: float
    pm_flux_wb: float
    torque_nm: float
    rated_voltage_v: float | None
    """Rated length of the voltage vector."""


@dataclass(frozen=True)
class TruePlant:
    """The plant's true parameters."""

    magnetics: Magnetics
    parameters: PlantParameters
    """With the brake released; see `locked`."""
    sensors: SensorParameters
    options: Plant
    """The plant's options, updated by its `model.json` where there is one."""
    table: FluxTable | None
    """The flux map behind the magnetics, or None."""
    reach_a: float
    """Longest current vector for which the magnetics are known."""
    reach_positive_d_a: float
    """Largest i_d; less where a map had to be extrapolated to positive i_d."""
    bench: BenchParameters | None = None
    """The switched inverter with its sensors; None for an averaged one."""

    def locked(self, slip_torque_nm: float | None) -> PlantParameters:
        """The parameters with the brake engaged."""
        slip = math.inf if slip_torque_nm is None else slip_torque_nm
        return self.parameters._replace(friction_nm=self.parameters.friction_nm + slip)


def read_nameplate(motor: Motor) -> Nameplate:
    """The nameplate, with omitted values derived from the others.

    Raises
    ------
    InputError
        Where the motor lacks a value that the control is tuned by.
    """
    needed = ("rated_current_rms_a", "stator_resistance_ohm", "d_inductance_h", "q_inductance_h")
    for field in needed:
        if getattr(motor, field) is None:
            raise InputError("motor", field, "the simulated drive tunes its current control from it; give a value")
    rated = motor.rated_current_a or 0.0
    l_d, l_q = motor.d_inductance_h or 0.0, motor.q_inductance_h or 0.0
    flux, torque = motor.pm_flux_wb, motor.rated_torque_nm
    if flux is None:
        flux = 0.0 if torque is None else torque / (1.5 * motor.pole_pairs * rated)
    if torque is None:
        torque = 1.5 * motor.pole_pairs * (flux * rated + 0.5 * abs(l_q - l_d) * rated**2)
    voltage = motor.rated_voltage_rms_v
    return Nameplate(
        pole_pairs=motor.pole_pairs,
        rated_a=rated,
        resistance_ohm=motor.stator_resistance_ohm or 0.0,
        l_d_h=l_d,
        l_q_h=l_q,
        pm_flux_wb=flux,
        torque_nm=max(torque, 1e-9),
        rated_voltage_v=None if voltage is None else voltage * math.sqrt(2.0 / 3.0),
    )


def bus_voltage(options: SimulatedOptions, nameplate: Nameplate) -> float:
    """DC-bus voltage [V]; raises `InputError` where neither options nor nameplate state it."""
    if options.dc_bus_voltage_v is not None:
        return options.dc_bus_voltage_v
    if nameplate.rated_voltage_v is None:
        raise InputError("drive", "dc_bus_voltage_v", "give it, or motor.rated_voltage_rms_v to derive it from")
    return 2.0 * SQRT3 * nameplate.rated_voltage_v


def bus_notes(options: SimulatedOptions, motor: Motor, dc_bus_v: float) -> tuple[str, ...]:
    """A note on a bus voltage that follows from the nameplate; none for the procedures' own example motor."""
    if options.dc_bus_voltage_v is not None or getattr(motor, "example", False):
        return ()
    text = f"simulated with a bus of {dc_bus_v:.4g} V, twice the rated voltage's peak between lines"
    return (f"{text}: state drive.dc_bus_voltage_v where yours differs",)


def derive(options: SimulatedOptions, nameplate: Nameplate, dc_bus_v: float) -> TruePlant:
    """The plant's energy, parameters and sensors.

    Raises
    ------
    InputError
        Where the magnetics do not describe a motor, or a map cannot be read.
    """
    plant, table = apply_model(options.plant)
    options = options.model_copy(update={"plant": plant})
    magnetics, table = (map_energy(table), table) if table is not None else _magnetics(plant, nameplate)
    energy = magnetics.energy
    map_ohm = table.motor.stator_resistance_ohm if table is not None and table.motor is not None else None
    resistance = plant.resistance_ohm or map_ohm or nameplate.resistance_ohm
    sample_s = 1.0 / options.sampling_frequency_hz
    steepest = max(energy.outside_d, energy.outside_q)
    refuse_switched_options(options)
    switched = plant.inverter == "switched"
    averaged = without_bridge(options) if switched else options
    parameters = _parameters(averaged, nameplate, magnetics, resistance, dc_bus_v)
    parameters = parameters._replace(off_ohm=0.5 / (steepest * sample_s))
    if plant.substeps is None:
        parameters = parameters._replace(substeps=_substeps(parameters, magnetics))
    reach, reach_d = math.inf, math.inf
    if table is not None:
        reach = usable_reach(table, magnetics, positive_d=False)
        reach_d = usable_reach(table, magnetics, positive_d=True)
    sensors, bench = _sensors(plant, nameplate), None
    if switched:
        ratings = Ratings(nameplate.rated_a, min(nameplate.l_d_h, nameplate.l_q_h), dc_bus_v, sensors)
        parameters, bench = derive_bench(options, parameters, ratings)
    return TruePlant(magnetics, parameters, sensors, plant, table, reach, reach_d, bench)


def _magnetics(plant: Plant, nameplate: Nameplate) -> tuple[Magnetics, FluxTable | None]:
    m, n = plant.magnetics, nameplate
    if isinstance(m, NameplateMagnetics):
        return nameplate_energy(m, n.pm_flux_wb, n.l_d_h, n.l_q_h, n.rated_a), None
    if isinstance(m, MapMagnetics):
        table = load_table(m.name, m.file)
        return map_energy(table), table
    poly = np.array([getattr(m, name) for name in COEFFICIENTS])
    flux = n.pm_flux_wb if m.pm_flux_wb is None else m.pm_flux_wb
    l_d, l_q = m.d_inductance_h or n.l_d_h, m.q_inductance_h or n.l_q_h
    return polynomial_energy(flux, l_d, l_q, poly, 2.5 * n.rated_a), None


def _parameters(
    options: SimulatedOptions, nameplate: Nameplate, magnetics: Magnetics, resistance: float, dc_bus_v: float
) -> PlantParameters:
    effects, rated = options.plant.effects, nameplate.rated_a
    sample_s = 1.0 / options.sampling_frequency_hz
    h_dd, _, h_qq = hessian(*magnetics, magnetics.energy.psi_m, 0.0)
    stiffness = 0.5 * (h_dd + h_qq)
    dead, drop, sag, bias = effects.dead_time, effects.device_drop, effects.bus_sag, effects.voltage_bias
    uneven, skin, eddy, slots = (
        effects.phase_resistance_imbalance,
        effects.skin_effect,
        effects.eddy_currents,
        effects.slot_harmonics,
    )
    heat, magnets, brake = effects.winding_heating, effects.magnet_heating, effects.brake_compliance
    stop_slope, stop_limit = _stops(effects, stiffness)
    branches = _branches(options.plant, sample_s)
    inertia, viscous, coulomb = _mechanics(options.plant, nameplate)
    dead_per_a = 1.0 / ((dead and dead.threshold_a) or 0.04 * rated)
    drop_per_a = 1.0 / ((drop and drop.threshold_a) or 0.01 * rated)
    dead_v, drop_v = dead.voltage_v if dead else 0.0, drop.voltage_v if drop else 0.0
    delay_samples = (effects.voltage_delay.delay_s if effects.voltage_delay else 0.0) / sample_s
    if options.voltage_delay_samples + delay_samples > 3.99:
        raise InputError("drive.plant.effects", "voltage_delay", "the delay is longer than three samples in all")
    extra = (uneven.extra_a_ohm, uneven.extra_b_ohm) if uneven else (0.0, 0.0)
    on_ohm = drop.on_resistance_ohm if drop else 0.0
    skin_ohm = skin.extra_ohm if skin else 0.0
    slope = resistance + max(extra) + on_ohm + skin_ohm + 1.5 * (dead_v * dead_per_a + drop_v * drop_per_a)
    bias_a, bias_b = (bias.bias_a_v, bias.bias_b_v) if bias else (0.0, 0.0)
    return PlantParameters(
        sample_s=sample_s,
        substeps=options.plant.substeps or 1,
        pole_pairs=float(nameplate.pole_pairs),
        resistance_ohm=resistance,
        extra_a_ohm=extra[0],
        extra_b_ohm=extra[1],
        on_resistance_ohm=on_ohm,
        dead_time_v=dead_v,
        dead_time_per_a=dead_per_a,
        drop_v=drop_v,
        drop_per_a=drop_per_a,
        bias_alpha_v=bias_a,
        bias_beta_v=(bias_a + 2 * bias_b) / SQRT3,
        dc_bus_v=dc_bus_v,
        sag_per_watt=sag.per_watt if sag else 0.0,
        delay_samples=options.voltage_delay_samples + delay_samples,
        skin_ohm=skin_ohm,
        skin_rate=2 * math.pi * skin.corner_hz if skin else 0.0,
        eddy_siemens=1.0 / eddy.core_loss_ohm if eddy and not branches.core_rate else 0.0,
        **branches._asdict(),
        inverter_slope_ohm=slope,
        stop_slope=stop_slope,
        stop_limit_a=stop_limit,
        stop_d_over_q=1.0 / effects.hysteresis.q_over_d if effects.hysteresis else 1.0,
        has_stops=effects.hysteresis is not None,
        slot_per_h=slots.relative * stiffness if slots else 0.0,
        slot_order=float(slots.order) if slots else 0.0,
        slot_phase=slots.phase_rad if slots else 0.0,
        magnet_final_a=magnets.flux_change_wb * h_dd if magnets else 0.0,
        magnet_step=-math.expm1(-sample_s / magnets.time_constant_s) if magnets else 0.0,
        heat_per_watt=heat.rise_per_watt if heat else 0.0,
        heat_step=-math.expm1(-sample_s / heat.time_constant_s) if heat else 0.0,
        has_housing=heat is not None and (heat.housing_rise_per_watt, heat.ambient_rise_per_s) != (0.0, 0.0),
        housing_per_watt=heat.housing_rise_per_watt if heat else 0.0,
        housing_step=-math.expm1(-sample_s / heat.housing_time_constant_s) if heat else 0.0,
        ambient_step=heat.ambient_rise_per_s * sample_s if heat else 0.0,
        twist_rad_per_nm=brake.rad_per_nm if brake else 0.0,
        twist_lag_s=brake.lag_s if brake else 1.0,
        torsion_rate=2 * math.pi * brake.resonance_hz if brake and brake.resonance_hz else 0.0,
        torsion_damping=brake.damping if brake else 1.0,
        backlash_rad=brake.backlash_rad if brake else 0.0,
        backlash_nm=0.02 * nameplate.torque_nm,
        inertia=inertia,
        viscous=viscous,
        friction_nm=coulomb,
        filter_s=effects.current_filter.time_constant_s if effects.current_filter else 0.0,
        uneven=max(extra) > 0.0 or on_ohm > 0.0 or dead_v > 0.0 or drop_v > 0.0,
        twists=brake is not None,
        off_ohm=0.0,
    )


def _stops(effects: Effects, stiffness: float) -> tuple[float, float]:
    """Slope of each of three stops [A/Wb], and the first one's limit [A]; the limits are 1:2:3."""
    if effects.hysteresis is None:
        return 0.0, 0.0
    ratio = effects.hysteresis.reversible_ratio
    return (1.0 / ratio - 1.0) * stiffness / 3.0, effects.hysteresis.half_width_a / 6.0


class _Branches(NamedTuple):
    """Branches parallel to the magnetising inductance, with the field names of `PlantParameters`."""

    core_d_per_h: float = 0.0
    core_q_per_h: float = 0.0
    core_rate: float = 0.0
    damper_d_per_h: float = 0.0
    damper_q_per_h: float = 0.0
    damper_rate: float = 0.0
    has_branches: bool = False


def _branches(plant: Plant, sample_s: float) -> _Branches:
    rates, eddy, damper = _Branches(), plant.effects.eddy_currents, plant.damper
    if eddy is not None and (eddy.core_loss_q_ohm is not None or eddy.time_constant_s is not None):
        rate = 1.0 / (eddy.time_constant_s or 0.1 * sample_s)
        along_q = eddy.core_loss_q_ohm or eddy.core_loss_ohm
        rates = rates._replace(
            core_d_per_h=rate / eddy.core_loss_ohm, core_q_per_h=rate / along_q, core_rate=rate, has_branches=True
        )
    if damper is not None:
        rate = 1.0 / damper.time_constant_s
        along_d, along_q = (rate / damper.ohm, 0.0) if damper.axis == "d" else (0.0, rate / damper.ohm)
        rates = rates._replace(damper_d_per_h=along_d, damper_q_per_h=along_q, damper_rate=rate, has_branches=True)
    return rates


def _mechanics(plant: Plant, nameplate: Nameplate) -> tuple[float, float, float]:
    """Inertia, viscous and Coulomb friction; by default for 8 Hz and damping 0.35 about the rated current vector."""
    rotor, swing = plant.rotor, 2 * math.pi * 8.0
    inertia = rotor.inertia_kg_m2 or nameplate.pole_pairs * nameplate.torque_nm / swing**2
    viscous = 2 * 0.35 * inertia * swing if rotor.viscous_nm_s is None else rotor.viscous_nm_s
    coulomb = 5e-4 * nameplate.torque_nm if rotor.coulomb_nm is None else rotor.coulomb_nm
    return inertia, viscous, coulomb


def _sensors(plant: Plant, nameplate: Nameplate) -> SensorParameters:
    effects, sensors = plant.effects, plant.sensors
    mismatch = effects.current_gain_mismatch.gain_a_minus_b if effects.current_gain_mismatch else 0.0
    offset = effects.current_offset
    return SensorParameters(
        gain_a=1.0 + 0.5 * mismatch,
        gain_b=1.0 - 0.5 * mismatch,
        cubic_per_a2=effects.current_nonlinearity.cubic_per_a2 if effects.current_nonlinearity else 0.0,
        offset_a=offset.offset_a_a if offset else 0.0,
        offset_b=offset.offset_b_a if offset else 0.0,
        noise_a=0.0017 * nameplate.rated_a if sensors.noise_a is None else sensors.noise_a,
        quantum_a=0.0004 * nameplate.rated_a if sensors.quantum_a is None else sensors.quantum_a,
    )


def _substeps(p: PlantParameters, magnetics: Magnetics) -> int:
    """Integration steps a sample: accurate within the motor's range, stable everywhere."""
    h_dd, _, h_qq = hessian(*magnetics, magnetics.energy.psi_m, 0.0)
    usual, steepest = 1.7 * max(h_dd, h_qq), max(magnetics.energy.outside_d, magnetics.energy.outside_q)
    fastest = max(p.inverter_slope_ohm * usual / 0.9, p.inverter_slope_ohm * steepest / 2.0)
    if p.torsion_rate > 0.0:
        fastest = max(fastest, p.torsion_rate)
    elif p.twist_rad_per_nm > 0.0:
        fastest = max(fastest, 1.0 / (0.5 * p.twist_lag_s))
    if not fastest * p.sample_s <= MAX_SUBSTEPS:
        problem = f"so stiff a plant needs over {MAX_SUBSTEPS} integration steps a sample; make its effects smaller"
        raise InputError("drive.plant", "effects", problem)
    return max(1, math.ceil(fastest * p.sample_s))
