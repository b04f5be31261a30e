"""Flux maps as MATLAB files: the SyR-e layout, and the parameters of MathWorks' flux-based motor blocks."""

from __future__ import annotations

import io
from typing import Any

import numpy as np

from orchestrator.flux_maps.exporting._products import FileContent, Products, lookup_error


def syre_file(products: Products) -> FileContent:
    """`Id, Iq, Fd, Fq, T` as meshgrids with i_d along the columns, PM axes (magnet on d), peak values.

    The layout that SyR-e's `MMM_load_fdfq.m` reads (https://github.com/SyR-e/syre_public); NaN where not measured.
    """
    flux_map = products.flux_map
    i_d, i_q = np.meshgrid(flux_map.i_d, flux_map.i_q)
    content: dict[str, Any] = {"Id": i_d, "Iq": i_q, "Fd": flux_map.psi_d.T, "Fq": flux_map.psi_q.T}
    content |= {"T": products.torque_nm.T, "fluxbench": _extras(products)}
    note = () if products.surface.known.all() else ("NaN where not measured",)
    return FileContent(_savemat(content), products.measured_percent, notes=note)


def simulink_file(products: Products) -> FileContent:
    """`flux_d, flux_q, id, iq` of the Flux-Based PMSM block, 51 x 51, rows along `flux_d`.

    Also `id_index, iq_index, lambda_d, lambda_q` of the Flux-Based PM Controller block, rows along `id_index`
    (MathWorks, "Generate Parameters for Flux-Based PMSM Block" and "Generate Feed-Forward Flux Parameters"). The
    blocks take no NaN: what lies outside the measured region is continued by least curvature, and is false in
    `id_measured` and `lambda_measured`.
    """
    flux_map, surface, inverse, motor = products.flux_map, products.surface, products.inverse, products.motor
    i_d, i_q = inverse.filled()
    content: dict[str, Any] = {"flux_d": inverse.psi_d, "flux_q": inverse.psi_q, "id": i_d, "iq": i_q}
    content |= {"id_index": np.asarray(flux_map.i_d), "iq_index": np.asarray(flux_map.i_q)}
    content |= {"lambda_d": surface.filled[0], "lambda_q": surface.filled[1]}
    content |= {"id_measured": inverse.measured, "lambda_measured": surface.known, "P": float(motor.pole_pairs)}
    if motor.stator_resistance_ohm is not None:
        content["Rs"] = motor.stator_resistance_ohm
    content["fluxbench"] = _extras(products)
    rms, worst = lookup_error(inverse.psi_d, inverse.psi_q, (i_d, i_q), surface.fluxes, surface.currents)
    filled = int((~inverse.measured).sum())
    notes = (
        f"linear lookup in id, iq deviates from the measured currents by {rms:.2g} A rms, {worst:.2g} A at most",
        f"{filled} of {inverse.measured.size} nodes lie outside the measured region and are continued; "
        "id_measured marks them",
    )
    return FileContent(_savemat(content), 100.0 * float(inverse.measured.mean()), filled_nodes=filled, notes=notes)


def _extras(products: Products) -> dict[str, Any]:
    """A struct of the values without a name in the layouts; grids with i_d along the columns."""
    flux_map, salient = products.flux_map, products.saliency
    grids = {name: getattr(flux_map, name).T for name in type(flux_map).model_fields if name.startswith("l_")}
    grids |= {name: getattr(flux_map, name).T for name in ("psi_d_std", "psi_q_std")}
    grids |= {"l_max": salient.l_max.T, "l_min": salient.l_min.T}
    grids |= {"saliency_ratio": salient.ratio.T, "saliency_angle_rad": salient.angle_rad.T}
    struct: dict[str, Any] = {"method": flux_map.method, "motor": products.motor.name, "recording": products.recording}
    struct |= {"pole_pairs": float(products.motor.pole_pairs), "notes": "\n".join(products.notes), **grids}
    for name, curve in (("mtpa", products.mtpa), ("mtpv", products.mtpv)):
        if curve is not None:
            struct[name] = dict(vars(curve))
    return struct


def _savemat(content: dict[str, Any]) -> bytes:
    from scipy.io import savemat

    buffer: Any = io.BytesIO()  # the published stubs of savemat know paths only
    savemat(buffer, content, do_compression=True, oned_as="row", long_field_names=True)
    content_bytes: bytes = buffer.getvalue()
    return content_bytes
