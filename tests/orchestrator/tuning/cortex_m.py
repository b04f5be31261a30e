"""The C code on an emulated Cortex-M: compiled by zig, executed by unicorn, instructions read by capstone.

Cycles are counted by the tables 3-1 and 7-1 of the Cortex-M4 technical reference manual (ARM 100166), with the longest
time where a range is named, and without wait states of the flash:

==================================== =================================
instruction                          cycles
==================================== =================================
division and square root of floats   14
product with a sum                   3 of floats, 2 of integers
division of integers                 12
load and store                       2, of n registers at once 1 + n
branch that is taken, write to pc    3 more
all others                           1
==================================== =================================
"""

from __future__ import annotations

import os
import re
import struct
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.orchestrator.tuning.closed_loop import STRICT, run
from tests.orchestrator.tuning.functions import RESULT_IS_FLOAT, Functions, Words

CORES = {
    "cortex-m4f": ("thumb-freestanding-eabihf", "cortex_m4+vfp4d16sp", "M4"),
    "cortex-m4": ("thumb-freestanding-eabi", "cortex_m4", "M4"),
    "cortex-m3": ("thumb-freestanding-eabi", "cortex_m3", "M3"),
    "cortex-m0": ("thumb-freestanding-eabi", "cortex_m0", "M0"),
}
"""Target and processor of the compiler, model of the emulator; the first one has floats."""
OPTIONS = ("-O2", "-fno-math-errno", "-fomit-frame-pointer", "-fno-sanitize=all")
MATH_H = "#define sqrtf __builtin_sqrtf\n#define fabsf __builtin_fabsf\n"
"""As a C library for this core has it: both are instructions."""
RAM, STOP, PAGE = 0x20000000, 0x30000000, 0x1000
"""Arguments and stack; where a call returns to."""
ARGUMENT_BYTES = 64
REFILL_CYCLES = 3
CYCLES = {
    **dict.fromkeys(("vdiv", "vsqrt"), 14),
    **dict.fromkeys(("sdiv", "udiv"), 12),
    **dict.fromkeys(("vmla", "vmls", "vnmla", "vnmls", "vfma", "vfms", "vfnma", "vfnms"), 3),
    **dict.fromkeys(("mla", "mls", "ldr", "ldrb", "ldrh", "ldrsb", "ldrsh", "str", "strb", "strh", "vldr", "vstr"), 2),
}
SEVERAL = {
    "push": 0,
    "pop": 0,
    "vpush": 0,
    "vpop": 0,
    "ldm": 1,
    "stm": 1,
    "vldmia": 1,
    "vstmia": 1,
    "ldrd": 1,
    "strd": 1,
}
"""Instructions with a list of registers, and how many operands beside these they have."""


class CortexM:
    """An emulated core with a source in its flash.

    Parameters
    ----------
    name : str
        One of `CORES`.
    files : mapping
        Header and source of the symbol `motor`.
    folder : Path
        An empty one for the files.

    Attributes
    ----------
    flash_bytes : int
        Code and tables, and what the compiler's library adds, such as 64-bit division.
    """

    def __init__(self, name: str, files: Mapping[str, bytes], folder: Path) -> None:
        unicorn, capstone = (_module(module) for module in ("unicorn", "capstone"))
        for file, content in ({"math.h": MATH_H.encode()} | dict(files)).items():
            (folder / file).write_bytes(content)
        target, processor, model = CORES[name]
        header = next(content.decode() for file, content in files.items() if file.endswith(".h"))
        kept = "-Wl,--gc-sections,-e,0" + "".join(f",-u,{x}" for x in re.findall(r"^\w+ (motor_\w+)\(", header, re.M))
        source = next(file for file in files if file.endswith(".c"))
        words = ("-target", target, f"-mcpu={processor}", *OPTIONS, "-g")
        _zig(*words, kept, source, "-o", "motor.elf", folder=folder)
        program = _Elf((folder / "motor.elf").read_bytes())
        self._entries = program.symbols()
        self._registers, self._hook = unicorn.arm_const, unicorn.UC_HOOK_CODE
        self._core = core = unicorn.Uc(unicorn.UC_ARCH_ARM, unicorn.UC_MODE_THUMB | unicorn.UC_MODE_MCLASS)
        core.ctl_set_cpu_model(getattr(unicorn.arm_const, f"UC_CPU_ARM_CORTEX_{model}"))
        for address, size in ((RAM, 16 * PAGE), (STOP, PAGE)):
            core.mem_map(address, size)
        loaded = [part for part in program.sections if part[0] in (".text", ".rodata")]
        self.flash_bytes = sum(len(content) for _, _, content in loaded)
        first, last = (end(at + n for _, at, part in loaded for n in (0, len(part))) for end in (min, max))
        core.mem_map(first // PAGE * PAGE, (last // PAGE + 1) * PAGE - first // PAGE * PAGE)
        for _, address, content in loaded:
            core.mem_write(address, content)
        self._cycles = {}
        reader = capstone.Cs(capstone.CS_ARCH_ARM, capstone.CS_MODE_THUMB | capstone.CS_MODE_MCLASS)
        reader.skipdata = True  # constants between the functions
        for section, address, content in loaded:
            if section == ".text":
                self._cycles = {i.address: _cycles(i.mnemonic, i.op_str) for i in reader.disasm(content, address)}

    def call_float(self, name: str, *arguments: float | Words) -> int | float:
        """Call with pointers in the registers of integers and numbers in those of floats."""
        passed = [a for a in arguments if isinstance(a, np.ndarray)]
        for k, number in enumerate(a for a in arguments if not isinstance(a, np.ndarray)):
            self._core.reg_write(self._registers.UC_ARM_REG_S0 + k, int(np.float32(number).view(np.uint32)))
        word = self.call_int32(name, *passed)
        if name in RESULT_IS_FLOAT:
            return float(np.uint32(self._core.reg_read(self._registers.UC_ARM_REG_S0)).view(np.float32))
        return word

    def call_int32(self, name: str, *arguments: int | NDArray[np.int32] | Words) -> int:
        """Call with four arguments in registers and the others on the stack; arrays are changed in place."""
        core, registers = self._core, self._registers
        places: dict[int, int] = {}
        words = []
        arrays = [a for a in arguments if isinstance(a, np.ndarray)]
        for k, array in enumerate(arrays):
            core.mem_write(places.setdefault(id(array), RAM + k * ARGUMENT_BYTES), array.tobytes())
        for argument in arguments:
            words.append(places[id(argument)] if isinstance(argument, np.ndarray) else argument % 2**32)
        for k, word in enumerate(words[:4]):
            core.reg_write(registers.UC_ARM_REG_R0 + k, word)
        stack = RAM + 16 * PAGE - ARGUMENT_BYTES
        core.mem_write(stack, struct.pack(f"<{len(words[4:])}I", *words[4:]))
        core.reg_write(registers.UC_ARM_REG_SP, stack)
        core.reg_write(registers.UC_ARM_REG_LR, STOP | 1)
        core.emu_start(self._entries[f"motor_{name}"] | 1, STOP)
        for array in arrays:
            array[:] = np.frombuffer(bytes(core.mem_read(places[id(array)], array.nbytes)), array.dtype)
        return int(np.uint32(core.reg_read(registers.UC_ARM_REG_R0)).view(np.int32))

    def cycles(self, call: Callable[[], object]) -> int:
        """Cycles of a call."""
        count, following = 0, None

        def add(_core: object, address: int, size: int, _data: object) -> None:
            nonlocal count, following
            count += self._cycles[address] + (REFILL_CYCLES if following not in (None, address) else 0)
            following = address + size

        self._core.ctl_flush_tb()  # code that was translated without the hook
        hook = self._core.hook_add(self._hook, add)
        call()
        self._core.hook_del(hook)
        self._core.ctl_flush_tb()
        return count + REFILL_CYCLES  # of the return


class EmulatedFunctions(Functions):
    """Those in float on a core that has them."""

    def __init__(self, core: CortexM) -> None:
        self._core = core

    def call(self, name: str, *arguments: float | Words) -> int | float:
        return self._core.call_float(name, *arguments)


class _Elf:
    """Sections and symbols of a file in ELF32, little-endian."""

    def __init__(self, content: bytes) -> None:
        (first,), (size, count, of_names) = (
            struct.unpack_from("<I", content, 32),
            struct.unpack_from("<3H", content, 46),
        )
        headers = [struct.unpack_from("<10I", content, first + k * size) for k in range(count)]
        names = content[headers[of_names][4] :]
        self.sections = [(_text(names, h[0]), h[3], content[h[4] : h[4] + h[5]]) for h in headers]

    def symbols(self) -> dict[str, int]:
        """Addresses by name."""
        of = {name: part for name, _, part in self.sections}
        return {_text(of[".strtab"], name): value for name, value, *_ in struct.iter_unpack("<3I4s", of[".symtab"])}


def _cycles(mnemonic: str, operands: str) -> int:
    """Cycles of an instruction that does not branch."""
    name = mnemonic.split(".")[0]
    if name in SEVERAL:
        registers = operands.split("{")[-1].count(",") + 1 if "{" in operands else 2
        return 1 + registers
    return CYCLES.get(name, 1)


def _text(table: bytes, at: int) -> str:
    return table[at : table.index(b"\0", at)].decode("ascii")


def _module(name: str) -> ModuleType:
    """A module; skips the test where it is not installed."""
    module: ModuleType = pytest.importorskip(
        name, reason=f"{name} is not installed (pip install ziglang unicorn capstone)"
    )
    return module


def _zig(*words: str, folder: Path) -> None:
    _module("ziglang")
    caches = {name: str(folder / "cache") for name in ("ZIG_GLOBAL_CACHE_DIR", "ZIG_LOCAL_CACHE_DIR")}
    run(sys.executable, "-m", "ziglang", "cc", *STRICT, "-I.", *words, folder=folder, environment=os.environ | caches)
