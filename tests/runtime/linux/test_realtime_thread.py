"""No garbage collection of all loaded objects in a program that communicates with the firmware."""

import gc
import os
import sys

import pytest

from haptorb.runtime import linux
from haptorb.runtime.linux import prepare_thread


def test_what_exists_is_not_looked_through_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(linux, "raise_priority", lambda: os.getpid() > 0)
    usual = sys.getswitchinterval()
    try:
        assert prepare_thread()
        left = len(gc.get_objects())
        assert gc.get_freeze_count() > 10 * left
        assert gc.isenabled()
        assert sys.getswitchinterval() < 1e-3  # a thread that draws a bar gives way at once
    finally:
        gc.unfreeze()
        sys.setswitchinterval(usual)
