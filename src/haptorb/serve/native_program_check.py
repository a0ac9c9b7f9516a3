"""Whether a program can load the native libraries: its ELF header says so before it fails inside the linker."""

from __future__ import annotations

import platform
import shutil
import struct
from pathlib import Path

from haptorb.errors import InputError, quote

__all__ = ["check_program"]

_EXECUTABLE_LOADER = 3  # PT_INTERP
_MACHINES = {"x86_64": 62, "aarch64": 183}
_MOST_SCRIPTS = 4  #: scripts that name a script as their interpreter


def check_program(name: str) -> Path:
    """The file that `name` runs, found as a shell finds it.

    Raises InputError if there is none, if it is a 32-bit program or one for another machine, or if it was linked with
    musl: the libraries are 64-bit ones for glibc.
    """
    found = shutil.which(name)
    if found is None:
        why = "is not executable" if Path(name).is_file() else "was not found"
        raise InputError(f"the program {quote(name)} {why}; give its path, or a name that PATH leads to")
    path = Path(found)
    _check_file(path, name)
    return path


def _check_file(path: Path, name: str) -> None:
    for _ in range(_MOST_SCRIPTS):
        try:
            with path.open("rb") as file:
                head = file.read(4096)
        except OSError:
            return  # a program that may be run and not read: the system will say what is wrong with it
        if not head.startswith(b"#!"):
            break
        words = head[2:].splitlines()[0].decode(errors="replace").split()
        interpreter = words[0] if words else ""
        if interpreter.endswith("/env"):
            interpreter = next((one for one in words[1:] if not one.startswith("-") and "=" not in one), "")
        found = shutil.which(interpreter) if interpreter else None
        if found is None:
            return
        path = Path(found)
    if not head.startswith(b"\x7fELF"):
        return
    if head[4] != 2:
        raise InputError(
            f"'{name}' is a 32-bit program ({path}): haptorb's libraries are 64-bit; build the program for x86-64"
        )
    machine = struct.unpack_from("<H", head, 18)[0]
    if _MACHINES.get(platform.machine(), machine) != machine:
        raise InputError(f"'{name}' is a program for another processor ({path}): build it for {platform.machine()}")
    if "musl" in _find_loader(head):
        raise InputError(
            f"'{name}' was linked with musl ({path}): haptorb's libraries need glibc; build the program on a system "
            "with glibc, or link it with libdrd.a there"
        )


def _find_loader(head: bytes) -> str:
    """The dynamic linker that an ELF file of 64 bits asks for; empty: a static program."""
    (table,) = struct.unpack_from("<Q", head, 32)
    size, count = struct.unpack_from("<HH", head, 54)
    for i in range(count):
        at = table + i * size
        if at + 40 > len(head):
            break
        kind, _, offset = struct.unpack_from("<IIQ", head, at)
        (length,) = struct.unpack_from("<Q", head, at + 32)
        if kind == _EXECUTABLE_LOADER and offset + length <= len(head):
            return head[offset : offset + length].rstrip(b"\0").decode(errors="replace")
    return ""
