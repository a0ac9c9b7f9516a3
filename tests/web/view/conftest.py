"""Recordings written without a servo, and a viewer of one, served on a free port."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from haptorb.web.view import Viewer
from oracles.made_recording import make_recording


@pytest.fixture(scope="session")
def made(tmp_path_factory):
    """(path, rows) of a recording of three seconds."""
    path = tmp_path_factory.mktemp("view") / "made.mcap"
    return path, make_recording(path)


@pytest.fixture(scope="module")
def viewer(made):
    """A viewer of it that answers; its force map is one newton of push everywhere."""

    def push(name, values, model, points):
        return np.ones(len(points)), np.zeros(len(points), dtype=bool)

    with Viewer([made[0]], 0, force_map=push) as viewer:
        ready = threading.Event()
        serving = threading.Thread(target=lambda: viewer.serve(ready=ready.set))
        serving.start()
        assert ready.wait(20)
        yield viewer
        viewer.close()
        serving.join(10)
