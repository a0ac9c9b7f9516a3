"""Mesh of the dome: closed, even, and oriented outwards."""

from __future__ import annotations

import numpy as np
import pytest

from haptorb.web.force_map import shell


@pytest.mark.parametrize("rings", [1, 2, 3, 7, 45])
def test_mesh_covers_the_hemisphere_once(rings):
    directions, triangles = shell(rings)
    assert np.linalg.norm(directions, axis=1) == pytest.approx(1.0)
    assert len(directions) == 1 + 3 * rings * (rings + 1)
    assert set(triangles.ravel()) == set(range(len(directions)))
    corners = directions[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.einsum("ij,ij->i", normals, corners.mean(1)) > 0).all(), "every triangle faces outwards"
    # Every inner edge belongs to two triangles, every edge of the rim to one.
    edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    _, uses = np.unique(edges, axis=0, return_counts=True)
    assert sorted(np.unique(uses)) == ([1, 2] if rings > 0 else [1])
    assert (uses == 1).sum() == 6 * rings


def test_fine_mesh_has_the_area_of_the_hemisphere():
    directions, triangles = shell(45)
    corners = directions[triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    assert area == pytest.approx(2 * np.pi, rel=2e-3)
