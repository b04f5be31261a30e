"""Answer one recording of the benchmark with numpy and pyarrow alone: R_s by a straight line, and whether it is one.

python first_answer.py SET ID >> answers.jsonl
python scorer.py answers.jsonl SET/truth --answered
"""

import json
import sys
import time
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

start = time.perf_counter()
folder = Path(sys.argv[1]) / "recordings" / sys.argv[2]
manifest = json.loads((folder / "recording.json").read_text())
amps, volts = [], []
for segment in manifest["segments"]:
    if segment["stage"] != "resistance" or "pwm_frequency_hz" in segment["settings"]:
        continue
    rows = pq.read_table(folder / "captures" / f"{segment['id']}.parquet").slice(segment["samples"] // 2)
    to_dq = np.exp(-1j * segment["rotor_angle_rad"])
    amps.append(np.mean(rows["i_alpha"].to_numpy() + 1j * rows["i_beta"].to_numpy()) * to_dq)
    volts.append(np.mean(rows["v_alpha"].to_numpy() + 1j * rows["v_beta"].to_numpy()) * to_dq)
i, v = np.array(amps).view(float), np.array(volts).view(float)
ohm = i @ v / (i @ i)
left = v - ohm * i
std = np.sqrt(left @ left / (len(i) - 1) / (i @ i))
straight = np.sqrt(np.mean(left**2)) < 0.002 * np.sqrt(np.mean(v**2))
answer = {"id": sys.argv[2], "verdict": "clean" if straight else "unknown", "seconds": time.perf_counter() - start}
answer["resistance_ohm"] = {"value": ohm, "low": ohm - 1.96 * std, "high": ohm + 1.96 * std}
print(json.dumps(answer))
