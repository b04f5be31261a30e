"""The firmware's C: it compiles without a warning, and packs and unpacks what Python does."""

from __future__ import annotations

import random
import resource
import shutil
import struct
import subprocess
from pathlib import Path

import pytest

from plugins.wire import registers
from plugins.wire._command import command
from plugins.wire._dbc import layouts
from plugins.wire._firmware import FILES, write_codec
from protocols import InputError, StorageError
from tests.plugins.wire.test_codec import database, random_payload

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror")
ROUND_TRIPS = 2000
RECORD = struct.Struct("<HB64s")

HARNESS = """
#include <stdio.h>
#include <stdint.h>
#include <string.h>
#include "fluxbench.h"
#include "fluxbench_registers.h"

static const fluxbench_register_t table[] = {{ FLUXBENCH_REGISTERS }};

int main(void)
{{
    uint8_t in[67], out[64];
    if (sizeof(table) / sizeof(table[0]) != {registers}) return 3;
    while (fread(in, 1, sizeof(in), stdin) == sizeof(in)) {{
        unsigned id = in[0] | (unsigned)in[1] << 8;
        size_t size = in[2];
        memset(out, 0, sizeof(out));
        switch (id) {{
{cases}
        default: return 2;
        }}
        fwrite(out, 1, sizeof(out), stdout);
    }}
    return 0;
}}
"""
CASE = """        case {id}: {{
            struct fluxbench_{name}_t message;
            if (fluxbench_{name}_unpack(&message, in + 3, size)) return 1;
            if (fluxbench_{name}_pack(out, &message, sizeof(out)) != (int)size) return 1;
            break;
        }}"""


def compiler() -> str:
    found = shutil.which("gcc") or shutil.which("cc")
    if found is None:
        pytest.fail("no C compiler here: the firmware's codec cannot be checked (install gcc)")
    return found


def c_name(name: str) -> str:
    from cantools.database.can.c_source import camel_to_snake_case

    return str(camel_to_snake_case(name))


def test_c_codec_compiles_strictly_and_round_trips_what_python_sends(tmp_path: Path) -> None:
    write_codec(tmp_path)
    cases = "\n".join(CASE.format(id=m.frame_id, name=c_name(name)) for name, m in layouts().items())
    (tmp_path / "main.c").write_text(HARNESS.format(cases=cases, registers=len(registers())))
    build = [compiler(), *STRICT, "-O1", "-o", "codec", "main.c", "fluxbench.c"]
    compiled = subprocess.run(build, cwd=tmp_path, capture_output=True, text=True)
    assert compiled.returncode == 0, compiled.stderr
    rng = random.Random(11)
    messages = [rng.choice(database().messages) for _ in range(ROUND_TRIPS)]
    payloads = [random_payload(message, rng) for message in messages]
    records = b"".join(
        RECORD.pack(m.frame_id, len(payload), payload) for m, payload in zip(messages, payloads, strict=True)
    )
    done = subprocess.run([tmp_path / "codec"], input=records, capture_output=True, check=True)
    assert len(done.stdout) == 64 * ROUND_TRIPS
    for k, (message, payload) in enumerate(zip(messages, payloads, strict=True)):
        assert done.stdout[64 * k : 64 * k + len(payload)] == payload, message.name
    assert {message.name for message in messages} == set(layouts())


def test_the_command_writes_the_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert command(["--c", str(tmp_path / "fw")]) == 0
    assert sorted(path.name for path in (tmp_path / "fw").iterdir()) == sorted(FILES)
    assert str(tmp_path / "fw" / "fluxbench.h") in capsys.readouterr().out


def test_a_directory_that_cannot_be_made_is_one_clear_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="file"):
        write_codec(tmp_path / "file" / "below")


def test_a_full_disk_leaves_the_old_files_and_no_half_ones(tmp_path: Path) -> None:
    write_codec(tmp_path)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, hard))
    try:
        with pytest.raises(StorageError):
            write_codec(tmp_path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before
