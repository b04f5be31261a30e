"""C code for firmware: the codec (by cantools), the register table as a header, and a reference firmware."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from enum import IntEnum, IntFlag
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path

from orchestrator.recording import replace_file
from plugins.wire._blocks import DESCRIPTION_CAPTURE, LAST_CAPTURE, MAX_CAPTURE_BYTES, RIPPLE_FLAG
from plugins.wire._dbc import message_database
from plugins.wire._messages import PROTOCOL_MAJOR, PROTOCOL_MINOR, AckStatus, Capability, Fault, Op, Phase, PowerState
from plugins.wire._program import AXES, KINDS, WAVEFORMS
from plugins.wire._registers import registers
from plugins.wire._rows import CaptureFormat, Channel
from protocols import InputError

FILES = ("fluxbench.h", "fluxbench.c", "fluxbench_registers.h")
_HEADER = """\
/* Registers of the fluxbench drive protocol {major}.{minor}: index, access, range, unit.
   Made by `fluxbench wire`; do not edit. */

#ifndef FLUXBENCH_REGISTERS_H
#define FLUXBENCH_REGISTERS_H

#define FLUXBENCH_PROTOCOL_MAJOR {major}
#define FLUXBENCH_PROTOCOL_MINOR {minor}

typedef enum {{ FLUXBENCH_READ, FLUXBENCH_SETUP, FLUXBENCH_PROGRAM }} fluxbench_access_t;

typedef struct {{
    unsigned char index;
    fluxbench_access_t access;
    unsigned char whole;
    float low, high, initial;
}} fluxbench_register_t;

#define FLUXBENCH_DESCRIPTION {description}u /* capture number of the description */
#define FLUXBENCH_RIPPLE {ripple}u /* added to a capture's number: its ripple rows */
#define FLUXBENCH_LAST_CAPTURE {last}u /* 1 follows it */
#define FLUXBENCH_LONGEST_CAPTURE {longest}u /* bytes */
#define FLUXBENCH_MOST_ROWS {most}u

{indices}
#define FLUXBENCH_REGISTERS_END {end} /* past the last index */

{constants}

/* The whole table: one row a register, in order of the index. */
#define FLUXBENCH_REGISTERS \\
{rows}

#endif
"""


_ENUMERATIONS: Mapping[str, type[IntEnum] | type[IntFlag]] = {
    "CAN": Capability,
    "CHANNEL": Channel,
    "FORMAT": CaptureFormat,
    "STATE": PowerState,
    "PHASE": Phase,
    "FAULT": Fault,
    "OP": Op,
    "ACK": AckStatus,
}


def write_codec(directory: Path) -> tuple[Path, ...]:
    """Write the codec and the register table atomically and return the paths.

    Raises
    ------
    InputError
        The directory cannot be created or written to.
    StorageError
        The disk is full.
    """
    return _write("--c", directory, dict(zip(FILES, (*codec_source(), registers_header()), strict=True)))


def write_firmware(directory: Path) -> tuple[Path, ...]:
    """Write the reference firmware with its boards beside the codec (docs/firmware.md); raises as `write_codec`."""
    codec = dict(zip(FILES, (*codec_source(), registers_header()), strict=True))
    return _write("--firmware", directory, codec | dict(_sources(files("plugins.wire") / "firmware")))


def _sources(folder: Traversable, below: str = "") -> Iterator[tuple[str, str]]:
    for entry in sorted(folder.iterdir(), key=lambda entry: entry.name):
        if entry.is_dir():
            yield from _sources(entry, f"{below}{entry.name}/")
        elif entry.name == "Makefile" or entry.name.endswith((".c", ".h", ".ld")):
            yield below + entry.name, entry.read_text(encoding="utf-8")


def _write(option: str, directory: Path, texts: Mapping[str, str]) -> tuple[Path, ...]:
    paths = tuple(directory / name for name in texts)
    for folder in (directory, *sorted({path.parent for path in paths} - {directory})):
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(option, str(folder), f"cannot be created: {error.strerror or error}") from None
        if not os.access(folder, os.W_OK | os.X_OK):
            raise InputError(option, str(folder), "cannot be written to")
    occupied = next((path for path in paths if path.is_dir()), None)
    if occupied is not None:
        raise InputError(option, str(occupied), "is a folder")
    for path, text in zip(paths, texts.values(), strict=True):
        replace_file(path, text.encode("utf-8"))
    return paths


def codec_source() -> tuple[str, str]:
    """Header and source of the codec, as by ``cantools generate_c_source --database-name fluxbench``."""
    from cantools.database.can.c_source import generate

    header, source, *_ = generate(message_database(), "fluxbench", FILES[0], FILES[1], "fluxbench_fuzz.c")
    return str(header), str(source)


def registers_header() -> str:
    """Register numbers, enumerations, and the register table as rows of an X macro."""
    names = [(f"FLUXBENCH_REG_{register.name.upper()}", register) for register in registers().values()]
    indices = "\n".join(f"#define {name} {register.index} /* {register.text} */" for name, register in names)
    rows = ", \\\n".join(
        f"    {{ {name}, FLUXBENCH_{register.access.upper()}, {int(register.whole)}, "
        f"{register.range[0]!r}f, {register.range[1]!r}f, {float(register.default)!r}f }}"
        for name, register in names
    )
    numbers = {f"{prefix}_{member.name}": member.value for prefix, kind in _ENUMERATIONS.items() for member in kind}
    for prefix, names_in_order in (("KIND", KINDS), ("AXIS", AXES), ("WAVEFORM", WAVEFORMS)):
        numbers |= {f"{prefix}_{name.upper()}": number for number, name in enumerate(names_in_order)}
    return _HEADER.format(
        major=PROTOCOL_MAJOR,
        minor=PROTOCOL_MINOR,
        description=DESCRIPTION_CAPTURE,
        ripple=RIPPLE_FLAG,
        last=LAST_CAPTURE,
        longest=MAX_CAPTURE_BYTES,
        most=int(registers()["capture_rows"].range[1]),
        indices=indices,
        end=max(register.index for register in registers().values()) + 1,
        constants="\n".join(f"#define FLUXBENCH_{name} {number}" for name, number in numbers.items()),
        rows=rows,
    )
