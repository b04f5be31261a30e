"""An initramfs: the cpio format "newc", as the kernel's Documentation/driver-api/early-userspace describes it."""

from __future__ import annotations

_DIRECTORY, _FILE = 0o040755, 0o100644
_EXECUTABLE = 0o111


class Archive:
    """Put in, in order, directories before what is in them."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []

    def directory(self, name: str) -> None:
        self._add(name, b"", _DIRECTORY)

    def file(self, name: str, content: bytes, *, executable: bool = False) -> None:
        self._add(name, content, _FILE | (_EXECUTABLE if executable else 0))

    def whole(self) -> bytes:
        """The archive with its end."""
        ended = Archive()
        ended._parts = list(self._parts)
        ended._add("TRAILER!!!", b"", 0)
        return b"".join(ended._parts)

    def _add(self, name: str, content: bytes, mode: int) -> None:
        coded = name.encode() + b"\0"
        # inode, mode, uid, gid, links, mtime, size, device and rdevice (major, minor each), length of the name, check
        fields = (len(self._parts) + 1, mode, 0, 0, 1, 0, len(content), 0, 0, 0, 0, len(coded), 0)
        head = b"070701" + b"".join(b"%08X" % field for field in fields) + coded
        self._parts.append(_padded(head) + _padded(content))


def _padded(data: bytes) -> bytes:
    return data + bytes(-len(data) % 4)
