"""The libraries that programs load to reach `--serve native`: where they are, and how the clone builds them."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
from pathlib import Path

from haptorb.errors import DriverError, InputError
from haptorb.files import replace_files

__all__ = ["NAMES", "find_libraries", "lay_out"]

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
    import fcntl  # not at the top: Windows has none

    if not (_SOURCES / "Makefile").exists() and (_SHIPPED / "libdrd.so.3").exists():
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


def lay_out(folder: Path, *, replace: bool = False) -> None:
    """Put the libraries into `folder`: lib, include, and lib/release/lin-MACHINE-gcc, where some programs look.

    Raises InputError if a file of one of their names is there already, unless it may be replaced; then nothing is
    written.
    """
    libraries, headers = find_libraries()
    links = {folder / "lib" / name: target for name, target in NAMES.items() if target}
    links[folder / "lib" / "release" / f"lin-{platform.machine()}-gcc"] = ".."
    files = {folder / "lib" / name: libraries / name for name, target in NAMES.items() if not target}
    files |= {folder / "include" / one.relative_to(headers): one for one in headers.rglob("*") if one.is_file()}
    there = [path for path in (*files, *links) if path.is_symlink() or path.exists()]
    if there and not replace:
        raise InputError(f"{there[0]} is there already; choose another folder, or replace it with --force")
    try:
        for path in (*files, *links):
            path.parent.mkdir(parents=True, exist_ok=True)
        with replace_files(list(files)) as parts:
            for part, source in zip(parts, files.values(), strict=True):
                shutil.copyfile(source, part)
        for path, target in links.items():
            path.unlink(missing_ok=True)
            path.symlink_to(target)
    except OSError as cause:
        raise InputError(f"{cause.filename or folder} cannot be written: {cause.strerror}") from cause
