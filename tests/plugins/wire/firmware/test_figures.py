"""What the firmware needs of a microcontroller, as docs/firmware.md says: code, memory, instructions a period."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from tests.plugins.wire.firmware.built import build, tool

MOST_CODE, MOST_RAM, MOST_INSTRUCTIONS = 24 * 1024, 8 * 1024, 1500
M4 = ("-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16", "-Os", "-ffreestanding")
ORDINARY = ("hold", "trapezoid", "injection", "injection-demodulated", "gates-off")
"""What a host asks for; raw rows and ripple rows of one injection together are more."""
FIGURES = Path(__file__).parent / "figures" / "figures.c"


@pytest.mark.slow
def test_code_and_memory_fit_a_small_microcontroller(tmp_path: Path) -> None:
    program = build(tmp_path, "mps2_an386", "")
    listed = subprocess.run([tool("arm-none-eabi-size"), "-A", program], capture_output=True, text=True, check=True)
    sizes = {line.split()[0]: int(line.split()[1]) for line in listed.stdout.splitlines() if line.startswith(".")}
    assert sizes[".text"] + sizes[".data"] <= MOST_CODE, "board and motor included"
    assert sizes[".data"] + sizes[".bss"] <= MOST_RAM, "beside the memory for captures, without the stack"


@pytest.mark.slow
def test_a_sampling_period_takes_few_instructions(tmp_path: Path) -> None:
    build(tmp_path, "mps2_an386", "")
    sources = [*sorted(tmp_path.glob("fb_*.c")), tmp_path / "fluxbench.c", tmp_path / "boards/motor/motor.c", FIGURES]
    includes = ("-I.", "-Iboards/mps2_an386", "-Iboards/motor")
    linking = ("-nostartfiles", "--specs=nano.specs", "-T", "boards/mps2_an386/memory.ld", "-Wl,--gc-sections")
    gcc = [tool("arm-none-eabi-gcc"), "-std=c99", *M4, "-ffunction-sections", "-fdata-sections"]
    subprocess.run([*gcc, *includes, "-o", "figures.elf", *map(str, sources), *linking], cwd=tmp_path, check=True)
    machine = [tool("qemu-system-arm"), "-M", "mps2-an386", "-icount", "shift=5", "-nographic", "-monitor", "none"]
    with subprocess.Popen(
        [*machine, "-serial", "stdio", "-kernel", "figures.elf"],
        cwd=tmp_path,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        longest = {}
        for line in iter(process.stdout.readline, "end\n"):
            name, most, _, ending = line.split()
            assert ending == "done", line
            longest[name] = int(most)
        process.kill()
    assert {name: longest[name] for name in ORDINARY if longest[name] > MOST_INSTRUCTIONS} == {}
