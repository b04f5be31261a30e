"""C for firmware: the message codec by cantools, and the register table as a header. Made from the same two files."""

from __future__ import annotations

import os
from enum import IntEnum, IntFlag
from pathlib import Path

from orchestrator.recording import replace_file
from plugins.wire._dbc import message_database
from plugins.wire._messages import PROTOCOL_MAJOR, PROTOCOL_MINOR, Capability
from plugins.wire._program import AXES, KINDS, WAVEFORMS
from plugins.wire._registers import registers
from plugins.wire._rows import CaptureFormat, Channel
from protocols import InputError

FILES = ("fluxbench.h", "fluxbench.c", "fluxbench_registers.h")
_HEADER = """\
/* Registers of the fluxbench drive protocol {major}.{minor}: index, access, range, unit.
   Made by `fluxbench wire --c`; do not edit. */

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

{indices}

{constants}

/* The whole table: one row a register, in order of the index. */
#define FLUXBENCH_REGISTERS \\
{rows}

#endif
"""


def write_firmware(directory: Path) -> tuple[Path, ...]:
    """Write the C files, each whole or not at all, and return their paths.

    Raises
    ------
    InputError
        The directory cannot be made, or nothing can be written to it.
    StorageError
        The disk is full.
    """
    texts = (*codec_source(), registers_header())
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError("--c", str(directory), f"cannot be made: {error.strerror or error}") from None
    if not os.access(directory, os.W_OK | os.X_OK):
        raise InputError("--c", str(directory), "cannot be written to")
    paths = tuple(directory / name for name in FILES)
    occupied = next((path for path in paths if path.is_dir()), None)
    if occupied is not None:
        raise InputError("--c", str(occupied), "is a folder")
    for path, text in zip(paths, texts, strict=True):
        replace_file(path, text.encode("utf-8"))
    return paths


def codec_source() -> tuple[str, str]:
    """Header and source of the codec, as ``cantools generate_c_source --database-name fluxbench`` makes them."""
    from cantools.database.can.c_source import generate

    header, source, *_ = generate(message_database(), "fluxbench", FILES[0], FILES[1], "fluxbench_fuzz.c")
    return str(header), str(source)


def registers_header() -> str:
    """Register numbers, enumerations, and the table as an X macro's rows."""
    names = [(f"FLUXBENCH_REG_{register.name.upper()}", register) for register in registers().values()]
    indices = "\n".join(f"#define {name} {register.index} /* {register.text} */" for name, register in names)
    rows = ", \\\n".join(
        f"    {{ {name}, FLUXBENCH_{register.access.upper()}, {int(register.whole)}, "
        f"{register.range[0]!r}f, {register.range[1]!r}f, {float(register.default)!r}f }}"
        for name, register in names
    )
    constants = [
        *_constants(Capability),
        *_constants(Channel),
        *_constants(CaptureFormat),
        *(f"#define FLUXBENCH_KIND_{kind.upper()} {number}" for number, kind in enumerate(KINDS)),
        *(f"#define FLUXBENCH_AXIS_{axis.upper()} {number}" for number, axis in enumerate(AXES)),
        *(f"#define FLUXBENCH_WAVEFORM_{wave.upper()} {number}" for number, wave in enumerate(WAVEFORMS)),
    ]
    return _HEADER.format(
        major=PROTOCOL_MAJOR, minor=PROTOCOL_MINOR, indices=indices, constants="\n".join(constants), rows=rows
    )


def _constants(kind: type[IntEnum] | type[IntFlag]) -> list[str]:
    prefix = {"Capability": "CAN", "Channel": "CHANNEL", "CaptureFormat": "FORMAT"}[kind.__name__]
    return [f"#define FLUXBENCH_{prefix}_{member.name} {member.value}" for member in kind]
