"""Parameters of the switched inverter and its sensors, derived from the options and checked."""

from __future__ import annotations

import math
from dataclasses import dataclass

from plugins.drives.simulated._bridge import BridgeParameters, Three
from plugins.drives.simulated._sensing import BenchParameters, SensingParameters, SensorParameters
from plugins.drives.simulated._state import PlantParameters
from plugins.drives.simulated._switching import SwitchingParameters
from plugins.drives.simulated.options import SimulatedOptions
from plugins.drives.simulated.switching import PhaseSensors
from protocols import InputError

INVERTER_KEY = "drive.plant.switching"
SENSORS_KEY = "drive.plant.sensors"
SWITCHED_ONLY = "needs plant.inverter: switched"
MAX_STEP_DECAY = 0.015
"""Largest R h / L of an integration interval h: an interval is exact to first order in it."""


@dataclass(frozen=True)
class Ratings:
    """Ratings from which omitted options are scaled."""

    rated_a: float
    l_h: float
    """The smaller inductance."""
    dc_bus_v: float
    sensors: SensorParameters
    """Parameters of sensors a and b."""


def carrier_frequencies(options: SimulatedOptions) -> tuple[float, ...]:
    """The supported PWM frequencies [Hz]; raises `InputError` for one that the sampling does not fit."""
    default_hz = options.pwm_frequency_hz or options.sampling_frequency_hz
    choices = options.pwm_frequencies_hz or (0.5 * default_hz, default_hz, 2.0 * default_hz)
    if options.plant.inverter == "averaged":
        return tuple(sorted({*choices, default_hz}))
    for field, given in (("pwm_frequency_hz", (default_hz,)), ("pwm_frequencies_hz", options.pwm_frequencies_hz or ())):
        for f in given:
            if not _fits(options, f):
                delay = options.voltage_delay_samples
                late = f" (also {delay:g} samples later)" if delay else ""
                message = f"rows{late} have to coincide with carrier peaks or valleys; at {f:g} Hz they do not"
                raise InputError("drive", field, message)
    return tuple(sorted({default_hz, *(f for f in choices if _fits(options, f))}))


def _fits(options: SimulatedOptions, pwm_hz: float) -> bool:
    half_periods = 2.0 * pwm_hz / options.sampling_frequency_hz
    delay = half_periods * options.voltage_delay_samples
    return half_periods > 0.5 and all(abs(n - round(n)) < 1e-9 for n in (half_periods, delay))


def declared_delay(options: SimulatedOptions) -> float:
    """Delay n in samples: v[k] acts from t_k + n Ts. A reading averaged over a sample is half a sample old."""
    return options.voltage_delay_samples + (0.5 if options.current_sampling == "averaged" else 0.0)


def refuse_switched_options(options: SimulatedOptions) -> None:
    """Raises `InputError` for options of the switched inverter where the inverter is averaged."""
    plant = options.plant
    if plant.inverter == "switched":
        return
    for owner, field, given in (
        ("drive.plant", "switching", "switching" in plant.model_fields_set),
        ("drive", "current_sensors", options.current_sensors == 3),
        ("drive", "current_sampling", options.current_sampling == "averaged"),
        *((SENSORS_KEY, name, name in plant.sensors.model_fields_set) for name in PhaseSensors.model_fields),
    ):
        if given:
            raise InputError(owner, field, SWITCHED_ONLY)


def without_bridge(options: SimulatedOptions) -> SimulatedOptions:
    """The options without the effects that the switched bridge and its sensors simulate themselves."""
    effects = options.plant.effects
    eddy = effects.eddy_currents
    if eddy is not None and eddy.time_constant_s is None:
        eddy = eddy.model_copy(update={"time_constant_s": 1.0 / options.sampling_frequency_hz})
    simulated = dict.fromkeys(("dead_time", "device_drop", "bus_sag", "voltage_delay", "current_filter"))
    remaining = effects.model_copy(update={**simulated, "eddy_currents": eddy})
    plant = options.plant.model_copy(update={"effects": remaining})
    return options.model_copy(update={"plant": plant, "voltage_delay_samples": 0.0})


def derive_bench(
    options: SimulatedOptions, plant: PlantParameters, known: Ratings
) -> tuple[PlantParameters, BenchParameters]:
    """Parameters of the plant, and those of the bridge and its sensors.

    Raises
    ------
    InputError
        Where an option exceeds what the carrier period or the drive permits.
    """
    if options.voltage_delay_samples > 2.0:
        raise InputError("drive", "voltage_delay_samples", "two samples at most on a switched inverter")
    default_hz = options.pwm_frequency_hz or options.sampling_frequency_hz
    half_periods = round(2.0 * default_hz / options.sampling_frequency_hz)
    intervals = max(1, math.ceil(0.5 * plant.resistance_ohm / (default_hz * known.l_h) / MAX_STEP_DECAY))
    s, effects, bus = options.plant.switching, options.plant.effects, options.plant.switching.bus
    dead = _dead_times(options, default_hz, known.dc_bus_v)
    switch_v, switch_ohm, diode_v, diode_ohm, knee = _devices(options, known)
    lag = effects.current_filter.time_constant_s if effects.current_filter else 0.0
    bridge = BridgeParameters(
        half_s=0.5 / default_hz,
        dead_s=dead,
        two_capacitances_f=2.0 * _capacitance(options, max(dead), known),
        charge_exponent=1.0 - s.grading,
        switch_v=switch_v,
        switch_ohm=switch_ohm,
        diode_v=diode_v,
        diode_ohm=diode_ohm,
        knee_a=knee,
        timer_s=s.timer_s,
        minimum_s=s.minimum_pulse_s,
        filter_s=lag,
        core_rate=plant.core_rate,
        damper_rate=plant.damper_rate,
    )
    sag = effects.bus_sag.per_watt * known.dc_bus_v**2 if effects.bus_sag else 0.0
    switching = SwitchingParameters(
        bridge=bridge,
        half_periods=half_periods,
        delay_half_periods=round(half_periods * options.voltage_delay_samples),
        shift_s=s.sampling_offset_s - (effects.voltage_delay.delay_s if effects.voltage_delay else 0.0),
        steps=math.ceil(plant.substeps / (half_periods * intervals)),
        intervals=intervals,
        nominal_v=known.dc_bus_v,
        compensated=bus.compensated,
        logged=bus.logged == "measured",
        bus_gain=bus.gain,
        source_ohm=bus.resistance_ohm or sag,
        bus_s=(bus.resistance_ohm or sag) * bus.capacitance_f,
        drop_per_k=s.drop_per_k,
        ohm_per_k=s.ohm_per_k,
        kelvin_per_watt=s.kelvin_per_watt,
        junction_step=-math.expm1(-plant.sample_s / s.device_time_constant_s),
        averaged=options.current_sampling == "averaged",
    )
    _check_timing(options, switching)
    _check_trip(options, switching, known, plant.resistance_ohm)
    return plant._replace(has_branches=False), BenchParameters(switching, _sensing(options, known))


def _dead_times(options: SimulatedOptions, default_hz: float, dc_bus_v: float) -> Three:
    given, effect = options.plant.switching.dead_time_s, options.plant.effects.dead_time
    if given is None:
        given = effect.voltage_v / (default_hz * dc_bus_v) if effect else 0.0
    return given if isinstance(given, tuple) else (given, given, given)


def _capacitance(options: SimulatedOptions, dead_s: float, known: Ratings) -> float:
    if (given := options.plant.switching.output_capacitance_f) is not None:
        return given
    effect = options.plant.effects.dead_time
    threshold = (effect and effect.threshold_a) or 0.04 * known.rated_a
    return 0.5 * threshold * dead_s / known.dc_bus_v


def _devices(options: SimulatedOptions, known: Ratings) -> tuple[float, float, float, float, float]:
    """Switch (V, ohm), diode (V, ohm) and the knee current of both [A]."""
    s, effect = options.plant.switching, options.plant.effects.device_drop
    volts, ohm = (effect.voltage_v, effect.on_resistance_ohm) if effect else (0.0, 0.0)
    switch_v = volts if s.switch_drop_v is None else s.switch_drop_v
    switch_ohm = ohm if s.switch_ohm is None else s.switch_ohm
    diode_v = switch_v if s.diode_drop_v is None else s.diode_drop_v
    diode_ohm = switch_ohm if s.diode_ohm is None else s.diode_ohm
    return (
        switch_v,
        switch_ohm,
        diode_v,
        diode_ohm,
        s.drop_knee_a or (effect and effect.threshold_a) or 0.01 * known.rated_a,
    )


def _check_timing(options: SimulatedOptions, s: SwitchingParameters) -> None:
    """Raises `InputError` for times that exceed the shortest supported carrier period."""
    fastest = max(carrier_frequencies(options))
    period, where = 1.0 / fastest, f"of the carrier at {fastest:g} Hz"
    if s.bridge.minimum_s >= period:
        raise InputError(
            INVERTER_KEY, "minimum_pulse_s", f"{_us(s.bridge.minimum_s)} is no shorter than the period {where}"
        )
    for field, value in (("dead_time_s", max(s.bridge.dead_s)), ("timer_s", s.bridge.timer_s)):
        if value >= 0.5 * period:
            raise InputError(INVERTER_KEY, field, f"{_us(value)} is no shorter than half the period {where}")
    if abs(s.shift_s) >= 0.5 * period:
        prefix = "with effects.voltage_delay, " if options.plant.effects.voltage_delay else ""
        raise InputError(
            INVERTER_KEY, "sampling_offset_s", f"{prefix}{_us(s.shift_s)} is half the period {where} or more"
        )


def _check_trip(options: SimulatedOptions, s: SwitchingParameters, known: Ratings, resistance_ohm: float) -> None:
    """Raises `InputError` where capacitances or bus resistance keep the current from reaching the trip level."""
    given, trip_a = options.plant.switching, _trip_a(options, known)
    at_trip, half_s = f"the {trip_a:.3g} A at which the drive trips", 0.5 / max(carrier_frequencies(options))
    swing_s = s.bridge.two_capacitances_f * known.dc_bus_v / trip_a
    if given.output_capacitance_f is not None and swing_s >= half_s:
        message = f"{at_trip} take {_us(swing_s)} to commutate, longer than half the carrier period ({_us(half_s)})"
        raise InputError(INVERTER_KEY, "output_capacitance_f", message)
    if not given.bus.resistance_ohm:
        return
    max_w, loss_w = known.dc_bus_v**2 / (4.0 * given.bus.resistance_ohm), 1.5 * resistance_ohm * trip_a**2
    if max_w <= loss_w:
        message = f"passes at most {max_w:.3g} W, and {at_trip} dissipate {loss_w:.3g} W in the winding"
        raise InputError(INVERTER_KEY, "bus.resistance_ohm", f"{given.bus.resistance_ohm:g} ohm {message}")


def _trip_a(options: SimulatedOptions, known: Ratings) -> float:
    return options.trip_ratio * (options.max_current_a or 2.5 * known.rated_a)


def _us(seconds: float) -> str:
    return f"{1e6 * seconds:.4g} us"


def _sensing(options: SimulatedOptions, known: Ratings) -> SensingParameters:
    sensors, two, three = options.plant.sensors, known.sensors, options.current_sensors == 3
    given = sensors.model_fields_set
    for field in ("gain_c_minus_1", "offset_c_a"):
        if field in given and not three:
            raise InputError(SENSORS_KEY, field, "this drive has two sensors: give drive.current_sensors: 3")
    quantum, full_scale = two.quantum_a, math.inf
    if sensors.bits is None:
        if "full_scale_a" in given:
            raise InputError(SENSORS_KEY, "full_scale_a", "belongs to a converter: give bits")
    else:
        if "quantum_a" in given:
            raise InputError(SENSORS_KEY, "bits", "give either bits or quantum_a")
        full_scale = sensors.full_scale_a or 4.0 * known.rated_a
        if full_scale < (trip := _trip_a(options, known)):
            message = f"{full_scale:g} A is below the {trip:.4g} A at which the drive trips"
            raise InputError(SENSORS_KEY, "full_scale_a", message)
        quantum = 2.0 * full_scale / 2**sensors.bits
    return SensingParameters(
        three=three,
        gain=(two.gain_a, two.gain_b, 1.0 + sensors.gain_c_minus_1),
        offset_a=(two.offset_a, two.offset_b, sensors.offset_c_a),
        cubic_per_a2=two.cubic_per_a2,
        even_per_a=sensors.even_per_a,
        noise_a=two.noise_a,
        drift_a=sensors.drift_a_per_sqrt_s / math.sqrt(options.sampling_frequency_hz),
        remanence_a=sensors.remanence_a,
        remanence_share=0.5 * sensors.remanence_a / known.rated_a,
        quantum_a=quantum,
        full_scale_a=full_scale,
    )
