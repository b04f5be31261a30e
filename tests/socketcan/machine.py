"""A virtual machine with a Debian kernel that sees this host's files, read-only, and runs pytest. Installs nothing.

Its own memory holds what it writes. It has no network and no disk. It is emulated, and some ten times slower than
its host: KVM is not needed.
"""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from tests.socketcan.archive import Archive
from tests.socketcan.buses import CLASSIC_BUS, FD_BUS
from tests.socketcan.compiled import ANY_CPU
from tests.socketcan.modules import NoModule, with_dependencies

REPOSITORY = Path(__file__).parents[2]
LONGEST_S = 1800.0
MEMORY_MB = 4096
_PROCESSOR = ("-machine", "q35", "-accel", "tcg,thread=multi", "-cpu", "max", "-smp", "2")
NEEDED = ("vcan", "can_raw", "9p", "9pnet_virtio", "virtio_pci")
_ENDED = "fluxbench-machine: exit "
_INIT = """#!/bin/busybox sh
busybox=/bin/busybox
$busybox mkdir -p /proc /sys /dev /host
$busybox mount -t devtmpfs dev /dev
for module in $($busybox cat /modules/order); do $busybox insmod /modules/$module; done
$busybox mount -t 9p -o trans=virtio,version=9p2000.L,ro,cache=loose,msize=524288 host /host
$busybox mount -t proc proc /host/proc
$busybox mount -t sysfs sys /host/sys
$busybox mount -t devtmpfs dev /host/dev
$busybox mkdir -p /host/dev/pts /host/dev/shm
$busybox mount -t devpts pts /host/dev/pts
$busybox mount -t tmpfs shm /host/dev/shm
$busybox mount -t tmpfs run /host/run
$busybox ip link set lo up
for bus in {classic}:16 {fd}:72; do
    $busybox ip link add dev ${{bus%:*}} type vcan
    $busybox ip link set ${{bus%:*}} mtu ${{bus#*:}}
    $busybox ip link set ${{bus%:*}} up
done
$busybox cp /job /host/run/job
$busybox chroot /host /bin/sh /run/job
echo "{ended}$?"
$busybox poweroff -f
"""
_JOB = """cd {repository}
export HOME=/run TMPDIR=/run PATH=/usr/sbin:/usr/bin:/sbin:/bin LANG=C.UTF-8 {settings}
export PYTHONDONTWRITEBYTECODE=1 OPENBLAS_NUM_THREADS=1 NUMBA_CACHE_DIR=/run/kernels HYPOTHESIS_STORAGE_DIRECTORY=/run
cp -r {kernels} /run/kernels
{python} -m pytest --basetemp=/run/pytest {words}
"""


class Absent(Exception):
    """This host lacks something; one line says which Debian packages bring it."""


@dataclass(frozen=True)
class Machine:
    """What a machine is made of."""

    qemu: Path
    busybox: Path
    kernel: Path
    modules: Path

    @classmethod
    def of_this_host(cls) -> Machine:
        """From what is installed; FLUXBENCH_KERNEL may name a directory with another kernel: an unpacked package."""
        qemu, busybox = shutil.which("qemu-system-x86_64"), _static_busybox()
        kernel = _newest_kernel(Path(os.environ.get("FLUXBENCH_KERNEL", "/")))
        found = {"qemu-system-x86": qemu, "busybox-static": busybox, "linux-image-amd64": kernel}
        missing = [package for package, there in found.items() if there is None]
        if qemu is None or busybox is None or kernel is None:
            raise Absent(f"no virtual machine without the Debian packages: {' '.join(missing)}")
        return cls(Path(qemu), busybox, *kernel)

    def run(self, words: list[str], kernels: Path, folder: Path) -> int:
        """Run pytest in the machine, and show what it prints; its exit code."""
        initramfs = folder / "initramfs"
        initramfs.write_bytes(self._initramfs(words, kernels))
        command = [str(self.qemu), *_PROCESSOR, "-m", str(MEMORY_MB), "-no-reboot", "-nodefaults", "-nic", "none"]
        command += ["-display", "none", "-serial", "stdio", "-kernel", str(self.kernel), "-initrd", str(initramfs)]
        command += ["-append", "console=ttyS0 quiet loglevel=3 panic=-1"]
        command += ["-virtfs", "local,path=/,mount_tag=host,security_model=none,readonly=on,multidevs=remap"]
        return _followed(command)

    def _initramfs(self, words: list[str], kernels: Path) -> bytes:
        modules = with_dependencies(NEEDED, self.modules)
        settings = " ".join(f"{name}={shlex.quote(value)}" for name, value in ANY_CPU.items())
        job = _JOB.format(
            repository=shlex.quote(str(REPOSITORY)),
            settings=settings,
            kernels=shlex.quote(str(kernels)),
            python=shlex.quote(sys.executable),
            words=shlex.join(words or ["tests/socketcan"]),
        )
        archive = Archive()
        for name in ("bin", "modules"):
            archive.directory(name)
        archive.file("bin/busybox", self.busybox.read_bytes(), executable=True)
        archive.file("init", _INIT.format(classic=CLASSIC_BUS, fd=FD_BUS, ended=_ENDED).encode(), executable=True)
        archive.file("job", job.encode())
        archive.file("modules/order", "\n".join(name for name, _ in modules).encode())
        for name, content in modules:
            archive.file(f"modules/{name}", content)
        return archive.whole()


def _static_busybox() -> Path | None:
    """The machine has nothing but this at first: one that needs libraries will not do."""
    found = shutil.which("busybox")
    if found is None or b"/lib64/ld-linux" in (content := Path(found).read_bytes()) or not content:
        return None
    return Path(found)


def _newest_kernel(root: Path) -> tuple[Path, Path] | None:
    """The newest kernel that has the modules beside it, and their directory."""
    for image in sorted((root / "boot").glob("vmlinuz-*"), key=lambda path: path.stat().st_mtime, reverse=True):
        for lib in (root / "lib" / "modules", root / "usr" / "lib" / "modules"):
            folder = lib / image.name.removeprefix("vmlinuz-")
            try:
                with_dependencies(NEEDED, folder)
            except NoModule:
                continue
            return image, folder
    return None


def _followed(command: list[str]) -> int:
    """Show what comes as it comes; the exit code is its last line."""
    deadline, reported = time.monotonic() + LONGEST_S, b""
    with subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        while data := os.read(process.stdout.fileno(), 4096):
            sys.stdout.write(data.decode(errors="replace").replace("\r", ""))
            sys.stdout.flush()
            reported = (reported + data)[-200:]
            if time.monotonic() > deadline:
                process.kill()
    last = reported.decode(errors="replace").rpartition(_ENDED)[2].split()
    return int(last[0]) if last and last[0].isdigit() else 1
