"""A copy of a recording in which an effect is hidden, for the test of its sizes.

The plant of the simulated drive knows its own effects alone. Here the readings of a recording are changed to those that
the effect's own `correct` turns back into the recorded ones: the drive would have logged them, had the motor felt the
same. A wrong sign in `correct` is a wrong sign here as well; it shows in how the readings have changed.
"""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from pathlib import Path

import numpy as np

from orchestrator.diagnosis.criteria import Criteria
from orchestrator.diagnosis.weak_form.preparation import prepare
from orchestrator.diagnosis.weak_form.segments import logged_fields
from orchestrator.formatting.sentences import listed
from orchestrator.recording import Recording, SegmentWriter, write_manifest
from orchestrator.runs import open_any
from protocols import (
    Capture,
    Correction,
    Effect,
    EffectLayer,
    EffectParameters,
    InputError,
    NotMeasuredError,
    Segment,
    Signals,
)

INVERTED = ("i_ab", "v_ab", "v_dc", "resistance_ohm")
"""Signals whose correction can be inverted in the readings; the rotor's angle and the iron would need another motor."""
FROM_HISTORY = ("start_temperature_c", "came_from_ab", "losses", "turned_rad")
"""Signals of the time before a segment, as a diagnosis derives them."""
OPTIONAL = ("i_abc", "temperature_c", "psi_ab", "inductance_ab")
"""Signals that a recording or a model may lack, and an effect may read."""
MAX_ITERATIONS = 100
TOLERANCE = 1e-9
"""Largest difference from the recorded readings, over the largest of each."""


def recording_with(
    place: str | PathLike[str], effect: Effect, out: str | PathLike[str], **parameters: float
) -> Recording:
    """A copy of a recording as it would be with an effect of this size in it.

    Parameters
    ----------
    place : path
        A recording or run, best of a motor that the library explains.
    effect : Effect
        It may change currents, voltages, the bus or the resistance.
    out : path
        Folder of the copy.
    **parameters : float
        In SI, by the names of the effect's parameters.

    Raises
    ------
    InputError
        Where the effect changes the rotor's angle or the magnetising current, nothing at all, or where its correction
        has no inverse.
    """
    source, folder = open_any(Path(place)), Path(out)
    history, values = _history(source), effect.Parameters(**parameters)
    _require_change(source, history, effect, values)
    folder.mkdir(parents=True, exist_ok=True)
    segments = []
    for segment in source.segments():
        capture = _with_effect(source, segment, history.get(segment.id), effect, values)
        with SegmentWriter(folder, segment.id) as writer:
            writer.append(capture)
            written = writer.finish()
        segments.append(segment.model_copy(update={"sha256": written.sha256}))
    name = f"{source.manifest.name} with {effect.name}"
    manifest = source.manifest.model_copy(update={"name": name, "segments": tuple(segments)})
    write_manifest(folder, manifest)
    return Recording(folder, manifest)


def _history(source: Recording) -> Mapping[str, Signals]:
    """What a diagnosis knows of the time before each segment that it reads."""
    try:
        return {piece.segment.id: piece.signals for piece in prepare(source, Criteria()).pieces}
    except NotMeasuredError:
        return {}


def _require_change(
    source: Recording, history: Mapping[str, Signals], effect: Effect, parameters: EffectParameters
) -> None:
    """Raise `InputError` where the effect changes no signal of any segment, with the signals that none has."""
    missing = set(OPTIONAL)
    for segment in source.segments():
        given = _signals(source, segment, source.load(segment), history.get(segment.id))
        missing -= {name for name in OPTIONAL if getattr(given, name) is not None}
        if _acts(effect, given):
            arrays = effect.correct(given, parameters).arrays
            if any(not np.array_equal(x, getattr(given, name)) for name, x in arrays.items()):
                return
    without = f" ({listed(sorted(missing))} {'is' if len(missing) == 1 else 'are'} not given)" if missing else ""
    raise InputError(effect.name, "", f"the effect changes nothing in this recording{without}")


def _acts(effect: Effect, signals: Signals) -> bool:
    return signals.bridge_on or effect.layer is EffectLayer.CURRENT_SENSORS


def _with_effect(
    source: Recording, segment: Segment, history: Signals | None, effect: Effect, parameters: EffectParameters
) -> Capture:
    """A segment's readings that the effect corrects to the recorded ones, by fixed-point iteration."""
    recorded = source.load(segment)
    given = _signals(source, segment, recorded, history)
    if not _acts(effect, given):
        return recorded
    readings = given
    for _ in range(MAX_ITERATIONS):
        corrected = effect.correct(readings, parameters)
        missing = _missing(effect, given, readings, corrected)
        readings = readings.replaced({name: getattr(readings, name) + more for name, more in missing.items()})
        largest = {name: max(float(np.abs(getattr(given, name)).max()), 1e-12) for name in missing}
        if all(float(np.abs(more).max()) <= TOLERANCE * largest[name] for name, more in missing.items()):
            change = {name: getattr(readings, name) for name in missing}
            return recorded.model_copy(update=change | ({"i_abc": None} if "i_ab" in change else {}))
    raise InputError(
        str(source.path),
        segment.id,
        f"{effect.name}: no readings found that it corrects to the recorded ones: smaller?",
    )


def _missing(effect: Effect, given: Signals, readings: Signals, corrected: Correction) -> dict[str, np.ndarray]:
    """What the readings still lack, by their names; a resistance that rises takes a larger voltage."""
    arrays = corrected.arrays
    other = sorted(arrays.keys() - set(INVERTED))
    if other:
        problem = (
            f"it changes {listed(other)}, which no recorded reading shows; expected {listed(list(INVERTED))} alone"
        )
        raise InputError(effect.name, "", problem)
    missing = {name: getattr(given, name) - x for name, x in arrays.items() if name != "resistance_ohm"}
    if "resistance_ohm" in arrays:
        felt_v = arrays.get("v_ab", readings.v_ab)
        drop_v = (arrays["resistance_ohm"] - given.resistance_ohm)[:, None] * given.i_ab
        missing["v_ab"] = given.v_ab + drop_v - felt_v
    return missing


def _signals(source: Recording, segment: Segment, capture: Capture, history: Signals | None) -> Signals:
    """A segment as an effect sees it, without the flux, which no reading shows."""
    manifest, samples, fs = source.manifest, len(capture), capture.sampling_frequency_hz
    i_ab = np.asarray(capture.i_ab, dtype=np.float64)
    resistance = manifest.motor.stator_resistance_ohm or 1.0
    return Signals(
        start_s=capture.start_s,
        sampling_frequency_hz=fs,
        pwm_frequency_hz=float(segment.settings.get("pwm_frequency_hz") or manifest.drive.pwm_frequency_hz or fs),
        i_ab=i_ab,
        v_ab=np.asarray(capture.v_ab, dtype=np.float64),
        v_dc=np.asarray(capture.v_dc, dtype=np.float64),
        theta_rad=np.full(samples, segment.rotor_angle_rad),
        resistance_ohm=np.full(samples, resistance),
        i_m_ab=i_ab,
        heat_j=(0.0 if history is None else history.heat_j[0])
        + 1.5 * resistance * np.cumsum(np.sum(i_ab**2, axis=1)) / fs,
        motor=manifest.motor,
        drive=manifest.drive,
        bridge_on=segment.stage.value != "gates_off",
        **logged_fields(capture, samples, 1),
        **({} if history is None else {name: getattr(history, name) for name in FROM_HISTORY}),
    )
