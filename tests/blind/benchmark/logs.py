"""A recording as a logger of another make would have written it: a CSV file, and a mapping of its columns."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from orchestrator.benchmark.definition import LOG, MAPPING

LABELS = ("pwm_frequency_hz", "amplitude_v", "frequency_hz", "rotation_hz", "waveform", "amplitude_a", "period_s")
"""Settings that somebody who writes a mapping knows of a series of points."""


def write_log(recording: Path, folder: Path) -> Path:
    """Write the log of a recording of one rotor angle; returns its folder."""
    import pyarrow.parquet as pq

    folder.mkdir(parents=True)
    manifest = json.loads((recording / "recording.json").read_text(encoding="utf-8"))
    drive, rate = manifest["drive"], manifest["drive"]["sampling_frequency_hz"]
    rules: list[dict[str, Any]] = []
    with (folder / LOG).open("w", encoding="ascii", newline="\n") as file:
        file.write("time,i_u,i_v,i_w,u_alpha,u_beta,u_dc,point\n")
        for segment in manifest["segments"]:
            labels = {name: segment["settings"][name] for name in LABELS if name in segment["settings"]}
            rule = {"stage": segment["stage"], "settings": labels}
            label = next((known["label"] for known in rules if {**known, **rule} == known), None)
            if label is None:
                label = f"{segment['stage']} {sum(known['stage'] == rule['stage'] for known in rules) + 1}"
                rules.append({"label": label, **rule})
            table = pq.read_table(recording / "captures" / f"{segment['id']}.parquet")
            alpha, beta, u_alpha, u_beta, u_dc = (
                table[name].to_numpy().astype(float) for name in ("i_alpha", "i_beta", "v_alpha", "v_beta", "v_dc")
            )
            phases = 1e3 * np.stack([alpha, -alpha / 2 + math.sqrt(0.75) * beta, -alpha / 2 - math.sqrt(0.75) * beta])
            time_s = segment["start_s"] + np.arange(len(alpha)) / rate
            rows = np.column_stack([time_s, *phases, u_alpha, u_beta, u_dc])
            np.savetxt(file, rows, fmt=f"%.7f,{','.join(['%.4f'] * 5)},%.2f,{label}")
    mapping = {
        "format": "fluxbench-import",
        "version": 1,
        "name": manifest["name"],
        "motor": {name: value for name, value in manifest["motor"].items() if value is not None},
        "drive": {name: value for name, value in drive.items() if name != "sampling_frequency_hz"},
        "time": {"column": "time", "unit": "s"},
        "sampling_frequency_hz": rate,
        "current": {"frame": "abc", "columns": {"a": "i_u", "b": "i_v", "c": "i_w"}, "unit": "mA"},
        "voltage": {
            "frame": "alpha_beta",
            "columns": {"alpha": "u_alpha", "beta": "u_beta"},
            "unit": "V",
            "scaling": "amplitude_invariant",
        },
        "bus": {"column": "u_dc", "unit": "V"},
        "rotor_angle": {"value": manifest["segments"][0]["rotor_angle_rad"], "unit": "rad"},
        "split_at_gaps": True,
        "segment_column": "point",
        "segments": rules,
    }
    (folder / MAPPING).write_text(yaml.safe_dump(mapping, sort_keys=False), encoding="utf-8")
    return folder
