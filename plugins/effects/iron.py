"""Iron and magnets: eddy currents, hysteresis, warm magnets, slots. Each says which current magnetises."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from numba import njit

from orchestrator.numerics.frames import to_ab, to_dq
from orchestrator.numerics.types import Array
from plugins.effects._filters import held_lag, lagged_steps
from protocols import EffectLayer, EffectParameter, ParameterRole, Signals


class EddyCurrents:
    """Eddy currents in the iron: i = i_m + (dpsi/dt) / R_c [A], R_c in ohm, dpsi/dt = v - R_s i.

    A sample taken just before the voltage changes has seen the voltage of the interval before. In the flexible form
    the eddy current's path has an inductance too, and follows within `lag_s`. Source: the core-loss resistance of
    the equivalent circuit, e.g. S. Morimoto et al., doi:10.1109/28.315238.
    """

    name: ClassVar[str] = "eddy_currents"
    summary: ClassVar[str] = "Eddy currents in the iron add a current in step with the voltage."
    signature: ClassVar[str] = "A square current in the ripple, linear in the injected amplitude."
    layer: ClassVar[EffectLayer] = EffectLayer.IRON
    family: ClassVar[str] = "core_loss"
    twins: ClassVar[tuple[str, ...]] = ()
    experiments: ClassVar[tuple[str, ...]] = ("inject at a second amplitude", "inject at a second frequency")
    gauge: ClassVar[str] = ""
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter(
            name="core_loss_ohm",
            unit="ohm",
            typical=1000.0,
            prior_width=1000.0,
            low=20.0,
            high=1e7,
            neutral=1e7,
            strong_when_small=True,
        ),
        EffectParameter(
            name="lag_s",
            unit="s",
            typical=1e-5,
            prior_width=2e-5,
            low=0.0,
            high=1e-3,
            neutral=0.0,
            role=ParameterRole.REFINEMENT,
        ),
    )

    def correct(self, signals: Signals, values: Mapping[str, float]) -> Signals:
        """Take the eddy current from the magnetising current, and its steps from the resistive drop."""
        core = values["core_loss_ohm"]
        if core >= self.parameters[0].neutral or not signals.bridge_on:
            return signals
        before = np.concatenate([signals.v_ab[:1], signals.v_ab[:-1]])
        eddy = (before - signals.resistance_ohm[:, None] * signals.i_ab) / core
        late = values.get("lag_s", 0.0) * signals.sampling_frequency_hz
        if late > 0.0:
            # Voltage held over an interval: at its end the current has come this much nearer to it.
            eddy = held_lag(np.ascontiguousarray(eddy), math.exp(-1.0 / late))
        step = (0.5 - late) * signals.resistance_ohm[:, None] * (signals.v_ab - before) / core
        return signals.model_copy(update={"i_m_ab": signals.i_m_ab - eddy, "v_ab": signals.v_ab - step})


@njit(cache=True, nogil=True)
def _stops(psi: Array, stiffness: Array, limits: Array) -> Array:
    """Sum of vector stop operators of the flux (n, 2), after a first pass that brings them to their loop."""
    n = psi.shape[0]
    out = np.zeros((n, 2))
    for m in range(limits.shape[0]):
        limit = limits[m]
        a = 0.0
        b = 0.0
        for turn in range(2):
            # The end of a periodic record is what came before its start.
            start = n - n // 4 if turn == 0 else 0
            for k in range(start, n):
                if k > start:
                    a += stiffness[m] * (psi[k, 0] - psi[k - 1, 0])
                    b += stiffness[m] * (psi[k, 1] - psi[k - 1, 1])
                size = math.sqrt(a * a + b * b)
                if size > limit:
                    a *= limit / size
                    b *= limit / size
                if turn == 1:
                    out[k, 0] += a
                    out[k, 1] += b
    return out


class Hysteresis:
    """Hysteresis of the iron: i = grad H(psi) + sum of vector stop operators of psi [A].

    A stop follows kappa psi until it reaches its limit. Both limits add up to `half_width_a`, half the
    loop's width; small loops see 1/L + kappa instead of 1/L, so `reversible_ratio` = 1 / (1 + kappa L).
    In the flexible form the two stops have limits 1 -+ sqrt(`variance`), and the first has `early_share` of kappa.
    Source: A. Bergqvist, Physica B 233 (1997), doi:10.1016/S0921-4526(97)00319-0.
    """

    name: ClassVar[str] = "hysteresis"
    summary: ClassVar[str] = "The iron's hysteresis lags the flux behind the current, whatever the speed."
    signature: ClassVar[str] = "A loop that does not depend on rate; the inductance of small ripple is smaller."
    layer: ClassVar[EffectLayer] = EffectLayer.IRON
    family: ClassVar[str] = "hysteresis"
    twins: ClassVar[tuple[str, ...]] = ()
    experiments: ClassVar[tuple[str, ...]] = ("inject at a second amplitude", "sweep minor loops")
    gauge: ClassVar[str] = ""
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter(name="half_width_a", unit="A", typical=0.03, prior_width=0.05, low=0.0, high=0.5, neutral=0.0),
        EffectParameter(
            name="reversible_ratio",
            unit="1",
            typical=0.93,
            prior_width=1.0,
            low=0.6,
            high=0.999,
            neutral=0.93,
            role=ParameterRole.SHAPE,
        ),
        EffectParameter(
            name="variance",
            unit="1",
            typical=0.0,
            prior_width=0.25,
            low=0.0,
            high=0.9,
            neutral=0.0,
            role=ParameterRole.REFINEMENT,
        ),
        EffectParameter(
            name="early_share",
            unit="1",
            typical=0.5,
            prior_width=0.2,
            low=0.05,
            high=0.95,
            neutral=0.5,
            role=ParameterRole.REFINEMENT,
        ),
    )

    def correct(self, signals: Signals, values: Mapping[str, float]) -> Signals:
        """Take what the stops hold from the magnetising current."""
        width = values["half_width_a"]
        if width == 0.0:
            return signals
        psi = _flux(signals)
        stiffness = (1.0 / values["reversible_ratio"] - 1.0) / _inductance(signals)
        early, spread = values.get("early_share", 0.5), math.sqrt(values.get("variance", 0.0))
        held = _stops(
            psi,
            stiffness * np.array([early, 1.0 - early]),
            0.5 * width * np.array([1.0 - spread, 1.0 + spread]),
        )
        return signals.model_copy(update={"i_m_ab": signals.i_m_ab - held})


def _flux(signals: Signals) -> Array:
    """Flux linkage (n, 2), up to a constant."""
    if signals.psi_smooth_ab is not None:
        return np.ascontiguousarray(signals.psi_smooth_ab, dtype=np.float64)
    drop = signals.v_ab - signals.resistance_ohm[:, None] * signals.i_ab
    return np.asarray(np.cumsum(drop, axis=0) / signals.sampling_frequency_hz)


def _inductance(signals: Signals) -> float:
    """A typical one: the nameplate's, or else the swing of flux over that of current [H]."""
    motor = signals.motor
    if motor is not None and motor.d_inductance_h is not None and motor.q_inductance_h is not None:
        return math.sqrt(motor.d_inductance_h * motor.q_inductance_h)
    swing = float(np.ptp(signals.i_m_ab, axis=0).max())
    return float(np.ptp(_flux(signals), axis=0).max()) / swing if swing > 0.0 else 1.0


class MagnetHeating:
    """Magnets that warm up: their flux falls (about -0.11 %/K for NdFeB), and the map slides along i_d.

    i_m = i + Delta psi(t) / L_d on the d axis [A]; Delta psi follows the copper loss through a thermal lag
    and is `flux_change_wb` at the end of the experiment [Wb]. With the rotor locked it induces nothing.
    """

    name: ClassVar[str] = "magnet_heating"
    summary: ClassVar[str] = "The magnets warm up and lose flux."
    signature: ClassVar[str] = "A map that slides along i_d as the experiment goes on."
    layer: ClassVar[EffectLayer] = EffectLayer.IRON
    family: ClassVar[str] = "heating"
    twins: ClassVar[tuple[str, ...]] = ()
    experiments: ClassVar[tuple[str, ...]] = ("repeat one injection point at the end",)
    gauge: ClassVar[str] = "The magnet's flux itself is invisible to a locked rotor; only its change shows."
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter(
            name="flux_change_wb", unit="Wb", typical=0.005, prior_width=0.01, low=-0.1, high=0.1, neutral=0.0
        ),
        EffectParameter(
            name="time_constant_s",
            unit="s",
            typical=300.0,
            prior_width=1.0,
            low=5.0,
            high=20000.0,
            neutral=300.0,
            role=ParameterRole.SHAPE,
        ),
    )

    def correct(self, signals: Signals, values: Mapping[str, float]) -> Signals:
        """Slide the map along the d axis by the flux lost so far."""
        if values["flux_change_wb"] == 0.0:
            return signals
        now = signals.start_s + np.arange(len(signals.v_dc)) / signals.sampling_frequency_hz
        if signals.losses is None:
            part = signals.heat_j / max(float(signals.heat_j[-1]), 1e-12)
        else:
            warm = lagged_steps(signals.losses.time_s, signals.losses.power_w, values["time_constant_s"])
            part = np.interp(now, signals.losses.time_s, warm / max(float(warm[-1]), 1e-12))
        inductance = (signals.motor.d_inductance_h if signals.motor is not None else None) or _inductance(signals)
        slide = values["flux_change_wb"] / inductance * part
        axis = np.stack([np.cos(signals.theta_rad), np.sin(signals.theta_rad)], axis=1)
        return signals.model_copy(update={"i_m_ab": signals.i_m_ab + slide[:, None] * axis})


class SlotHarmonics:
    """Slots give the locked angle a saliency of its own: an L_dq that is even in i_q, `relative` times L.

    The energy r L i_d i_q beside the map's own, so that reciprocity is kept: its flux r L (i_q, i_d) [Wb] is taken
    out of the voltage. Which part of L(theta) appears depends on the angle at which the rotor is locked. In the
    flexible form it fades as the teeth saturate: r / (1 + f |i|^2), f in 1/A^2.
    """

    name: ClassVar[str] = "slot_harmonics"
    summary: ClassVar[str] = "The slots make the map depend on the angle at which the rotor is locked."
    signature: ClassVar[str] = "A fixed parity break at one angle, another one at the next."
    layer: ClassVar[EffectLayer] = EffectLayer.IRON
    family: ClassVar[str] = "frame"
    twins: ClassVar[tuple[str, ...]] = ("rotor_misalignment",)
    experiments: ClassVar[tuple[str, ...]] = ("lock at several angles",)
    gauge: ClassVar[str] = "A part that is even in the true i_q belongs to the map at this angle."
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter(name="relative", unit="1", typical=0.02, prior_width=0.03, low=-0.3, high=0.3, neutral=0.0),
        EffectParameter(
            name="fading_per_a2",
            unit="1/A^2",
            typical=0.0,
            prior_width=0.1,
            low=-0.03,
            high=10.0,
            neutral=0.0,
            role=ParameterRole.REFINEMENT,
        ),
    )

    def correct(self, signals: Signals, values: Mapping[str, float]) -> Signals:
        """Take the change of this flux from the voltage of each interval."""
        if values["relative"] == 0.0:
            return signals
        psi = values["relative"] * _inductance(signals) * _crossed(signals, values.get("fading_per_a2", 0.0))
        induced = np.diff(psi, axis=0, append=psi[-1:]) * signals.sampling_frequency_hz
        return signals.model_copy(update={"v_ab": signals.v_ab - induced})


def _crossed(signals: Signals, fading: float) -> Array:
    """Gradient of i_d i_q / (1 + f |i|^2) in the stator frame, shape (n, 2)."""
    d, q = to_dq(signals.i_m_ab, signals.theta_rad).T
    left = 1.0 / np.maximum(1.0 + fading * (d * d + q * q), 0.1)
    bend = 2.0 * fading * d * q * left * left
    psi_d, psi_q = q * left - bend * d, d * left - bend * q
    return to_ab(np.stack([psi_d, psi_q], axis=1), signals.theta_rad)
