"""The firmware under clang's libFuzzer, with the address and undefined-behaviour sanitizers.

How many inputs: the environment variable FLUXBENCH_FUZZ (100,000 by default). What was found stays in its folder.
"""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from plugins.wire._firmware import write_firmware
from tests.plugins.wire.firmware.built import tool

INPUTS = int(os.environ.get("FLUXBENCH_FUZZ", "100000"))
FUZZ = Path(__file__).parent / "fuzz"
SANITIZERS = ("-fsanitize=fuzzer,address,undefined", "-fno-sanitize-recover=all")


@pytest.mark.slow
@pytest.mark.timeout(300 + INPUTS // 100)
def test_no_host_line_sensor_or_time_makes_it_unsound(tmp_path: Path) -> None:
    write_firmware(tmp_path)
    sources = [FUZZ / "fuzz.c", *sorted(tmp_path.glob("fb_*.c")), tmp_path / "fluxbench.c"]
    flags = ("-std=c99", "-O1", "-g", *SANITIZERS, f"-I{FUZZ}", f"-I{tmp_path}")
    clang = [tool("clang"), *flags, *map(str, sources), "-lm", "-o", "fuzz"]
    built = subprocess.run(clang, cwd=tmp_path, capture_output=True, text=True)
    if "fuzzer" in built.stderr and built.returncode != 0:
        pytest.skip("clang has no libFuzzer")
    assert built.returncode == 0, built.stderr
    words = ["./fuzz", f"-runs={INPUTS}", "-max_len=2048", "-seed=1", "-verbosity=0"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-4000:]
