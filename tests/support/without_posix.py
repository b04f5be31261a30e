"""Takes from the project what Windows lacks: POSIX's modules, and attributes of `os`, `signal`, `select`, `socket`.

The project's own modules alone lack them, since libraries that were built for this system need them. In the place of
Windows' own modules stand models: `msvcrt.locking` locks one byte as there, without waiting, and
`_winapi.PeekNamedPipe` counts the bytes in a pipe. A plugin of pytest: ``pytest -p tests.support.without_posix``.
"""

from __future__ import annotations

import builtins
import errno
import fcntl
import importlib
import os
import select
import signal
import socket
import struct
import sys
import termios
from pathlib import Path
from types import ModuleType
from typing import Any

PACKAGES = ("protocols", "orchestrator", "plugins", "fluxbench")
MODULES = ("fcntl", "grp", "pty", "pwd", "resource", "syslog", "termios", "tty")
ATTRIBUTES: dict[ModuleType, str] = {
    os: """O_CLOEXEC O_DIRECTORY O_NOCTTY O_NOFOLLOW O_NONBLOCK WNOHANG chown fdatasync fork forkpty getgid getloadavg
        getpgid getuid killpg mkfifo nice openpty posix_spawn pread pwrite sched_getaffinity sched_param
        sched_setscheduler set_blocking setsid statvfs sysconf ttyname""",
    signal: """ITIMER_REAL SIGALRM SIGCONT SIGHUP SIGKILL SIGQUIT SIGSTOP SIGTSTP SIGUSR1 SIGUSR2 alarm pause
        pthread_sigmask setitimer sigwait""",
    select: "epoll poll",
    socket: "AF_UNIX",
}


class _Lacking(ModuleType):
    """A module as the project sees it: without the attributes of POSIX."""

    def __init__(self, module: ModuleType, lacking: str) -> None:
        super().__init__(module.__name__)
        self.__module, self.__lacking = module, frozenset(lacking.split())

    def __getattr__(self, name: str) -> Any:
        if name in self.__lacking:
            raise AttributeError(f"{self.__module.__name__}.{name} is not of Windows")
        return getattr(self.__module, name)

    def __dir__(self) -> list[str]:
        return sorted(set(dir(self.__module)) - self.__lacking)


def remove_posix(*others: str) -> None:
    """Take it all away, for the rest of the process, from the project and from these packages."""
    packages = (*PACKAGES, *others)
    for name in ("asyncio", "getpass", "multiprocessing.pool", "subprocess"):  # they look for msvcrt as they load
        importlib.import_module(name)
    sys.modules["msvcrt"], sys.modules["_winapi"] = msvcrt_model(), winapi_model()
    lacking = {module.__name__: _Lacking(module, names) for module, names in ATTRIBUTES.items()}
    plain_import = builtins.__import__

    def guarded(name: str, globals: Any = None, locals: Any = None, fromlist: Any = (), level: int = 0) -> Any:
        importer = str((globals or {}).get("__name__", ""))
        if level or importer.partition(".")[0] not in packages:
            return plain_import(name, globals, locals, fromlist, level)
        if name in MODULES:
            raise ImportError(f"{importer} imports {name}, which is not of Windows")
        return lacking[name] if name in lacking else plain_import(name, globals, locals, fromlist, level)

    builtins.__import__ = guarded


def own_modules(root: Path) -> list[str]:
    """Names of all modules of the project."""
    files = [file for package in PACKAGES for file in sorted((root / package).rglob("*.py"))]
    kept = [file.relative_to(root).with_suffix("") for file in files if "templates" not in file.parts]
    return [".".join(file.parts).removesuffix(".__init__") for file in kept if file.name != "__main__"]


def msvcrt_model() -> ModuleType:
    """Windows' locks of bytes, and handles of descriptors."""
    no_waiting = 2

    def locking(descriptor: int, mode: int, byte_count: int) -> None:
        assert mode == no_waiting
        where = os.lseek(descriptor, 0, os.SEEK_CUR)
        can_write = fcntl.fcntl(descriptor, fcntl.F_GETFL) & (os.O_WRONLY | os.O_RDWR)
        kind = fcntl.F_WRLCK if can_write else fcntl.F_RDLCK  # of a file that is open to be read, the nearest there is
        try:
            fcntl.fcntl(descriptor, fcntl.F_OFD_SETLK, struct.pack("hhqqi", kind, os.SEEK_SET, where, byte_count, 0))
        except OSError:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES)) from None

    module = ModuleType("msvcrt")
    vars(module).update(
        LK_NBLCK=no_waiting, locking=locking, get_osfhandle=int, kbhit=lambda: bool(select.select([0], [], [], 0.0)[0])
    )
    return module


def winapi_model() -> ModuleType:
    """Windows' look into a pipe."""

    def peek(handle: int, size: int) -> tuple[int, int]:
        assert size == 0
        present = struct.unpack("i", fcntl.ioctl(handle, termios.FIONREAD, b"\0" * 4))[0]
        if not present and select.select([handle], [], [], 0.0)[0]:
            raise BrokenPipeError
        return present, 0

    module = ModuleType("_winapi")
    vars(module).update(PeekNamedPipe=peek)
    return module


def pytest_load_initial_conftests() -> None:
    """As a plugin: before any module of the project is imported; the tests lack it too."""
    remove_posix("tests")
