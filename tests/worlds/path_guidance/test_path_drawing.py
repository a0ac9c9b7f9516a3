"""The tube that the console draws encloses the path, and a long path makes no large picture."""

import numpy as np
import pytest

from haptorb.worlds import make_path
from haptorb.worlds.path import SHAPES, draw_path, make_shape

UP = make_path([(0, 0, 0.05), (0, 0, 0.06)])  # straight away from the centre


@pytest.mark.parametrize("path", [*(make_shape(name, 55.0) for name in SHAPES), UP], ids=[*SHAPES, "up"])
def test_the_tube_follows_the_path_from_beginning_to_end(path):
    shape = draw_path(path)
    points, corners = np.reshape(shape.points, (-1, 3)), np.reshape(shape.corners, (-1, 3))
    assert len(points) < 2000
    assert sorted(set(corners.ravel().tolist())) == list(range(len(points)))
    centres = points.reshape(-1, 4, 3).mean(axis=1)
    assert max(np.linalg.norm(path.places - centre, axis=1).min() for centre in centres) < 0.1e-3
    assert np.linalg.norm(points.reshape(-1, 4, 3) - centres[:, None], axis=2) == pytest.approx(0.35e-3, abs=0.02e-3)
    assert centres[[0, -1]] == pytest.approx(path.places[[0, -1]], abs=2e-5)
