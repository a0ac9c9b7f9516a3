"""Folder of compiled kernels and other pickles: never one that another account can write to."""

from __future__ import annotations

import errno
import os
import pickle
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from haptorb.cache_folder import explain_shared, private_folder
from haptorb.files import state_folder
from oracles.command import run_command

OTHER = 54_321  #: the id of another account

pytestmark = pytest.mark.skipif(not hasattr(os, "getuid"), reason="no accounts of this kind")

CALLED = """
import sys
from pathlib import Path
from haptorb.cache_folder import cache_folder, private_folder
if sys.argv[1] == "compile":
    from haptorb import compiled, rotations
    from haptorb.devices.quantity import si
    si("1 furlong", "m", "a length")  # pint's cache too
    print(compiled._folder(Path(rotations.__file__)))
else:
    print(private_folder("kernels", "one"))
print(cache_folder())
"""


def folders_of(home: Path, what: str = "look", **more: str) -> tuple[Path, Path, str]:
    """Folder of a file's kernels, of the whole cache, and what was said."""
    left_out = ("NUMBA_CACHE_DIR", "HAPTORB_CACHE_FOLDER")
    environment = {key: value for key, value in os.environ.items() if key not in left_out}
    environment |= {"XDG_CACHE_HOME": str(home), "TMPDIR": str(home.parent), **more}
    done = subprocess.run(
        [sys.executable, "-P", "-c", CALLED, what],
        env=environment, capture_output=True, text=True, check=True, timeout=100,
    )  # fmt: skip
    kernels, cache = done.stdout.splitlines()
    return Path(kernels), Path(cache), done.stderr


@pytest.mark.parametrize("mode", [0o700, 0o755])
def test_a_folder_of_ones_own_is_used(tmp_path: Path, mode: int) -> None:
    (tmp_path / "haptorb").mkdir(mode=mode)
    kernels, cache, said = folders_of(tmp_path)
    assert (cache, said) == (tmp_path / "haptorb", "")
    assert kernels.is_relative_to(cache)


def test_a_new_folder_is_for_this_account_only(tmp_path: Path) -> None:
    _, cache, _ = folders_of(tmp_path / "home", "compile")
    assert [cache.stat().st_mode & 0o777 for cache in (cache, cache / "kernels", cache / "units")] == [0o700] * 3


@pytest.mark.parametrize("fault", ["world", "group", "above", "other", "link", "below", "numba"])
def test_a_folder_that_others_could_have_filled_is_not_used(tmp_path: Path, fault: str) -> None:
    if fault in ("other", "group") and os.getuid() != 0:
        pytest.skip("only root can give a folder away")
    home = tmp_path / "home"
    folder = home / "haptorb"
    folder.mkdir(parents=True)
    more = {}
    if fault == "world":
        folder.chmod(0o777)
    elif fault == "group":
        os.chown(folder, os.getuid(), OTHER)
        folder.chmod(0o775)
    elif fault == "above":
        home.chmod(0o777)
    elif fault == "other":
        os.chown(folder, OTHER, OTHER)
    elif fault == "link":
        folder.rmdir()
        (tmp_path / "open").mkdir()
        (tmp_path / "open").chmod(0o777)
        folder.symlink_to(tmp_path / "open")
    elif fault == "below":
        (folder / "kernels").mkdir()
        (folder / "kernels").chmod(0o777)
    else:
        (tmp_path / "numba").mkdir()
        (tmp_path / "numba").chmod(0o777)
        more = {"NUMBA_CACHE_DIR": str(tmp_path / "numba")}
    kernels, cache, said = folders_of(home, "compile" if fault == "numba" else "look", **more)
    assert len(said.splitlines()) == 1
    assert "is not used: it" in said
    assert (cache == folder) == (fault == "numba")
    assert kernels.is_relative_to(cache)
    assert explain_shared(kernels) == ""


@pytest.mark.parametrize("fault", ["home is a file", "cache is a file", "no temporary folder", "home is empty"])
def test_without_a_folder_that_can_be_made_a_private_one_is_used_and_one_line_says_so(
    tmp_path: Path, fault: str
) -> None:
    (tmp_path / "file").touch()
    more = {"HOME": "" if "empty" in fault else str(tmp_path / "file")}
    more["XDG_CACHE_HOME"] = str(tmp_path / "file") if "cache" in fault else ""
    if "temporary" in fault:
        more["TMPDIR"] = str(tmp_path / "none")
    kernels, cache, said = folders_of(tmp_path / "home", **more)
    assert len(said.splitlines()) == 1
    assert cache.name == f"haptorb-{os.getuid()}"
    assert (cache.parent == tmp_path) == ("temporary" not in fault)
    assert cache.stat().st_mode & 0o777 == 0o700
    assert kernels.is_relative_to(cache)


def test_a_relative_folder_in_the_environment_is_ignored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As the XDG Base Directory Specification says; it would be another folder for each working directory."""
    monkeypatch.chdir(tmp_path)
    _, cache, said = folders_of(tmp_path, XDG_CACHE_HOME="kept/here", HOME=str(tmp_path))
    assert (cache, said) == (tmp_path / ".cache" / "haptorb", "")
    assert not (tmp_path / "kept").exists()
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("XDG_STATE_HOME", "kept")
    assert state_folder() == tmp_path / ".local" / "state" / "haptorb"


@pytest.mark.parametrize("home", ["/dev/null", "nowhere"])
def test_a_home_that_is_no_folder_is_none(home: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    _, cache, said = folders_of(tmp_path, XDG_CACHE_HOME="", TMPDIR=str(tmp_path), HOME=home)
    assert cache == tmp_path / f"haptorb-{os.getuid()}"
    assert len(said.splitlines()) == 1
    for name in ("XDG_CACHE_HOME", "XDG_STATE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", home)
    (state_folder() / "trips").mkdir(parents=True, exist_ok=True)


@pytest.mark.parametrize("variable", ["XDG_CACHE_HOME", "TMPDIR"])
def test_without_a_home_matplotlib_is_silent_too(variable: str, tmp_path: Path) -> None:
    program = "from haptorb.cache_folder import cache_folder; cache_folder(); import matplotlib; "
    left_out = ("NUMBA_CACHE_DIR", "HAPTORB_CACHE_FOLDER", "MPLCONFIGDIR", "XDG_CACHE_HOME", "XDG_CONFIG_HOME")
    environment = {key: value for key, value in os.environ.items() if key not in left_out}
    environment |= {"HOME": "/dev/null", variable: str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-P", "-c", program + "print(matplotlib.get_cachedir(), matplotlib.get_configdir())"],
        env=environment, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert all(Path(one).is_relative_to(tmp_path) for one in done.stdout.split())
    assert len(done.stderr.splitlines()) == (variable == "TMPDIR"), done.stderr  # the cache folder's own line


def test_without_a_folder_for_temporary_files_a_command_needs_none_or_says_so(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As where the root is read-only and nothing is mounted: Python's own search for such a folder has failed."""

    def fail() -> str:
        raise FileNotFoundError(errno.ENOENT, "No usable temporary directory found in ['/tmp', '/var/tmp']")

    monkeypatch.setattr(tempfile, "gettempdir", fail)
    assert run_command(capsys, "inspect", "omni", "--json")[0] == 0
    code, _, err = run_command(capsys, "run", "omni", "--headless", "--duration", "0.1")
    assert (code, "set TMPDIR" in " ".join(err.split())) == (2, True)


def test_in_a_sticky_folder_only_the_owners_counts(tmp_path: Path) -> None:
    tmp_path.chmod(0o1777)
    (tmp_path / "mine").mkdir(mode=0o700)
    assert explain_shared(tmp_path / "mine") == ""
    assert "every account" in explain_shared(tmp_path)  # the name of a folder in it can be another's first


def test_a_poisoned_pickle_in_a_shared_folder_is_not_loaded(tmp_path: Path) -> None:
    """The same account runs twice; in between another one replaces all that the first run has kept."""
    home, canary = tmp_path / "home", tmp_path / "canary"
    first, cache, _ = folders_of(home, "compile")

    class Canary:
        def __reduce__(self) -> tuple[object, tuple[str]]:
            return os.mkdir, (str(canary),)

    kept = [path for path in cache.rglob("*") if path.is_file()]
    assert kept
    for path in kept:
        path.write_bytes(pickle.dumps(Canary()))
    cache.chmod(0o777)
    second, _, said = folders_of(home, "compile")
    assert not canary.exists()
    assert second != first
    assert said


def test_a_users_own_kernel_is_not_kept_beside_its_file(tmp_path: Path) -> None:
    """In a sticky folder such as /tmp, another account can make the folder `__pycache__` first."""
    (tmp_path / "mine.py").write_text(
        "from haptorb.compiled import kernel\n\n@kernel\ndef double(x):\n    return 2.0 * x\n\nprint(double(2.0))\n"
    )
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path / "home")}
    environment.pop("NUMBA_CACHE_DIR", None)
    done = subprocess.run(
        [sys.executable, str(tmp_path / "mine.py")], env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "4.0"
    assert not (tmp_path / "__pycache__").exists()
    assert list((tmp_path / "home" / "haptorb" / "kernels" / "other").rglob("*.nbi"))


def test_nothing_is_kept_where_a_folder_was_opened_to_others_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    place = private_folder("kernels", "one")
    place.chmod(0o777)
    with pytest.raises(PermissionError, match="every account"):
        private_folder("kernels", "one")


@pytest.mark.parametrize("mode", [0o777, 0o1777, 0o700])
def test_what_is_executed_lies_in_no_temporary_folder_that_others_may_rename(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mode: int
) -> None:
    """The servo's process executes its plan: with TMPDIR writable for all, another account could replace the folder."""
    from haptorb import cache_folder
    from haptorb.files import create_private_folder, sweep

    (tmp_path / "tmp").mkdir()
    (tmp_path / "tmp").chmod(mode)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "tmp"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv("HAPTORB_CACHE_FOLDER", raising=False)
    cache_folder._choose.cache_clear()
    try:
        folder, claim = create_private_folder("servo")
        safe = mode != 0o777
        assert folder.is_relative_to(tmp_path / ("tmp" if safe else "cache"))
        assert explain_shared(folder) == ""
        assert sweep() == 0
        claim.close()
        assert sweep() == 1
        assert not folder.exists()
        assert list((tmp_path / "tmp").iterdir()) == []
    finally:
        cache_folder._choose.cache_clear()


def test_where_everything_is_shared_nothing_is_started(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from haptorb import files
    from haptorb.errors import HaptorbError

    (tmp_path / "tmp").mkdir()
    (tmp_path / "tmp").chmod(0o777)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "tmp"))

    def refuse(*parts: str) -> Path:
        raise PermissionError

    monkeypatch.setattr(files, "private_folder", refuse)
    with pytest.raises(HaptorbError, match="set TMPDIR to a folder of yours"), files.private_temporary_folder("page"):
        pass
    assert list((tmp_path / "tmp").iterdir()) == []
