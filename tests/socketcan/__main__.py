"""`python -m tests.socketcan [WORDS FOR PYTEST]`: run this directory's tests in a virtual machine."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from tests.socketcan.compiled import compile_for_any_cpu
from tests.socketcan.machine import Absent, Machine


def main(words: list[str]) -> int:
    """Exit code of pytest in the machine; 2 where something is missing on this one."""
    try:
        machine = Machine.of_this_host()
    except Absent as absent:
        print(absent, file=sys.stderr)
        return 2
    kernels = Path(sys.prefix) / "socketcan-kernels"
    compile_for_any_cpu(kernels)
    with tempfile.TemporaryDirectory() as folder:
        return machine.run(words, kernels, Path(folder))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
