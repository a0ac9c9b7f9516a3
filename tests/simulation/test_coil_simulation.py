"""What all simulated kinds of device share: time that passes in unequal pieces."""

from __future__ import annotations

import numpy as np
import pytest

from haptorb.devices.loader import load
from haptorb.simulation.registry import simulate

PIECES = (1e-4, 2e-4, 1e-4, 3e-4, 2e-4)  #: each one step of another length than the one before [s]


@pytest.mark.parametrize("name", ["omni", "pmsm", "tetrahedron", "arm"])
def test_windings_heat_the_same_in_unequal_pieces_of_time(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A loop that misses a tick lets two periods pass at once, and one in the next tick."""
    one, other = simulate(load(name)), simulate(load(name))
    state = one.state()
    goal = np.array(state.p), np.array([0.0, 0.0, 0.0, 1.0])
    duties = np.full(one.device.channels, 0.2)
    fills, fill = list[float](), one._fill_heat  # type: ignore[attr-defined]
    monkeypatch.setattr(one, "_fill_heat", lambda step: (fills.append(step), fill(step)))
    start = one.winding.copy()
    for _ in range(400):
        for piece in PIECES:
            one.advance(piece, duties, *goal)
    for _ in range(round(400 * sum(PIECES) / 1e-4)):
        other.advance(1e-4, duties, *goal)
    assert len(fills) == len(set(fills)) <= 3  # each length once
    rise = other.winding - start
    assert rise.max() > 1e-3
    assert one.winding - start == pytest.approx(rise, rel=0.02, abs=1e-6)
