"""A script that runs the exported machine of `flux_map.npz` in motulator's drive. Runs nothing."""

from __future__ import annotations

from orchestrator.flux_maps.exporting._products import FileContent, Products
from protocols import InputError

_SCRIPT = '''\
"""{title}: a speed step and a load step in motulator (pip install motulator), under current-vector control.

{notes}
Written by fluxbench; reads flux_map.npz (`fluxbench export --format npz`) beside it. Recording: {recording}.
"""

from pathlib import Path

import numpy as np
from motulator.drive import model
from motulator.drive.control import sm
from scipy.interpolate import RegularGridInterpolator

POLE_PAIRS = {pole_pairs}
R_S_OHM = {resistance:.6g}
CURRENT_A = {current:.6g}  # peak: {current_from}
DC_BUS_V = {bus:.6g}  # {bus_from}
INERTIA_KGM2 = {inertia:.3g}  # assumed: the rated torque takes 0.1 s to the speed below
SPEED_RAD_S = {speed:.6g}  # mechanical: half of what the bus voltage allows without field weakening
LOAD_NM = {load:.6g}  # a third of the torque at that current on q

with np.load(Path(__file__).parent / "flux_map.npz") as held:
    axes = held["inverse_flux_d"], held["inverse_flux_q"]
    current = RegularGridInterpolator(axes, held["inverse_i_s_dq"], bounds_error=False, fill_value=None)


def current_of(psi_s_dq):
    """Stator current over flux linkage, both complex; extrapolated linearly beyond the table."""
    psi = np.asarray(psi_s_dq, dtype=complex)
    i = current(np.stack((psi.real, psi.imag), axis=-1)).reshape(psi.shape)
    return i if psi.ndim else complex(i)


machine = model.SaturatedSynchronousMachinePars(n_p=POLE_PAIRS, R_s=R_S_OHM, i_s_dq_fcn=current_of)
estimates = sm.SynchronousMachinePars(
    n_p=POLE_PAIRS, R_s=R_S_OHM, L_d={l_d:.6g}, L_q={l_q:.6g}, psi_f={psi_m:.6g}
)
drive = model.Drive(
    model.SynchronousMachine(machine),
    model.MechanicalSystem(J=INERTIA_KGM2),
    model.VoltageSourceConverter(u_dc=DC_BUS_V),
)
control = sm.VectorControlSystem(
    sm.CurrentVectorController(estimates, sm.CurrentVectorControllerCfg(i_s_max=CURRENT_A, sensorless=False)),
    sm.SpeedController(J=INERTIA_KGM2, alpha_s=2 * np.pi * 4),
)
control.set_speed_ref(lambda t: (t > 0.1) * SPEED_RAD_S)
drive.mechanics.set_external_load_torque(lambda t: (t > 0.8) * LOAD_NM)
results = model.Simulation(drive, control, show_progress=False).simulate(t_stop=1.5)
machine_results = results.mdl.machine
print(f"speed {{results.mdl.mechanics.w_M[-1]:.4g}} rad/s, torque {{machine_results.tau_M[-1]:.4g}} Nm, ", end="")
print(f"current {{machine_results.i_s_dq[-1]:.4g}} A, flux {{machine_results.psi_s_dq[-1]:.4g}} Vs")
'''


def motulator_file(products: Products) -> FileContent:
    """`flux_map_motulator.py`, with the source of each number, the nameplate or an assumption, in a comment.

    Raises
    ------
    InputError
        Where R_s is unknown, or the map lacks zero current or a motoring half.
    """
    import numpy as np

    motor, surface = products.motor, products.surface
    rest = products.rest_wb
    if motor.stator_resistance_ohm is None:
        raise InputError("motulator", "stator_resistance_ohm", "a machine that runs needs a resistance")
    if rest is None or not products.motors:
        raise InputError("motulator", "flux_map", "a machine that runs needs zero current and i_q > 0 in its map")
    reach = float(surface.i_q[-1])
    rated = motor.rated_current_a
    current = reach if rated is None else min(rated, reach)
    slopes = surface.jacobian(np.zeros((1, 2)))[0]
    (psi_d, psi_q) = surface.psi(np.array([[0.0, current]]))[0]
    torque = 1.5 * motor.pole_pairs * psi_d * current
    volts = motor.rated_voltage_rms_v
    # Peak phase voltage of a bus is 1 / sqrt 3 of it; a rated voltage is line to line.
    bus = 1.2 * np.sqrt(2.0) * volts if volts else 540.0
    speed = 0.5 * bus / np.sqrt(3.0) / float(np.hypot(psi_d, psi_q)) / motor.pole_pairs
    text = _SCRIPT.format(
        title=_safe(motor.name),
        notes=_safe("; ".join(products.notes) or "No fault was found in the map."),
        recording=_safe(products.recording or "unknown"),
        pole_pairs=motor.pole_pairs,
        resistance=motor.stator_resistance_ohm,
        current=current,
        current_from="rated" if rated is not None and rated <= reach else "the map's reach",
        bus=bus,
        bus_from="1.2 times the peak of the rated voltage" if volts else "assumed",
        inertia=0.1 * torque / speed,
        speed=speed,
        load=torque / 3.0,
        l_d=float(slopes[0, 0]),
        l_q=float(slopes[1, 1]),
        psi_m=max(rest, 0.0),
    )
    return FileContent(text.encode("utf-8"), products.measured_percent, notes=("needs flux_map.npz beside it",))


def _safe(text: str) -> str:
    """Text that cannot end the script's opening string."""
    return " ".join(text.replace("\\", "/").replace('"', "'").split())
