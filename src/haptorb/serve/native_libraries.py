"""The libraries that programs load to reach `--serve native`: where they are, and how the clone builds them."""

from __future__ import annotations

import fcntl
import os
import platform
import shutil
import subprocess
from pathlib import Path

from haptorb.errors import DriverError

__all__ = ["NAMES", "find_libraries"]

_SHIPPED = Path(__file__).parent / "libraries"  # in the wheel for Linux on x86-64
_SOURCES = Path(__file__).resolve().parents[3] / "native"  # in the clone

#: file → what it is a link to; empty: a file of its own
NAMES = {
    "libdrd.so.3": "",
    "libdrd.so": "libdrd.so.3",
    "libdhd.so.3": "libdrd.so.3",
    "libdhd.so": "libdrd.so.3",
    "libdrd.a": "",
    "libdhd.a": "libdrd.a",
    "libHD.so.3.4": "",
    "libHD.so": "libHD.so.3.4",
}


def find_libraries() -> tuple[Path, Path]:
    """(folder of the libraries, folder of their headers): of the wheel, or built in the clone with its compiler.

    Raises DriverError if the installed package has none and they cannot be built.
    """
    if (_SHIPPED / "libdrd.so.3").exists():
        return _SHIPPED, _SHIPPED / "include"
    if not (_SOURCES / "Makefile").exists():
        raise DriverError(
            f"this haptorb was installed without its native libraries ({platform.system()}, {platform.machine()}): "
            "they are in the wheel for Linux on x86-64; elsewhere build them in a clone: make -C native"
        )
    missing = [tool for tool in ("make", os.environ.get("CC", "cc"), "objcopy") if shutil.which(tool) is None]
    if missing:
        raise DriverError(
            f"the native libraries cannot be built: {', '.join(missing)} is not installed (Debian: apt-get install "
            "make gcc)"
        )
    with (_SOURCES / "Makefile").open() as makefile:
        fcntl.flock(makefile, fcntl.LOCK_EX)  # one build at a time
        done = subprocess.run(["make", "-C", str(_SOURCES)], capture_output=True, text=True, check=False)
    if done.returncode:
        raise DriverError(f"the native libraries cannot be built: make -C {_SOURCES}\n{done.stderr.strip()[-1500:]}")
    return _SOURCES / "build", _SOURCES / "include"
