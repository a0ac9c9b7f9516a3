"""Shapes of a scene for the console: fixed, or moved by rows of the memory."""

from __future__ import annotations

from typing import Any

import numpy as np

from haptorb.worlds.scene.scene_model import SceneModel, load_engine
from haptorb.worlds.shape import Shape

__all__ = ["describe_scene"]

_MOST = 20_000  #: corners of all meshes; more is no picture but a load for the page
_PLANE = (0.1, 0.1, 5e-4)  #: half lengths of the plate that stands for an endless plane [m]


def describe_scene(scene: SceneModel, body: int, drawn: tuple[int, ...]) -> tuple[Shape, ...]:
    """Every visible shape of `scene`; `drawn` are those whose poses are in the memory, in the order of its rows.

    A shape of `body`, or of its children, is held. Shapes that MuJoCo does not draw by default (groups 3 to 5) are
    left out, and so are meshes beyond 20 000 vertices in total.
    """
    engine, model = load_engine(), scene.model
    data = engine.MjData(model)
    if model.nkey:
        engine.mj_resetDataKeyframe(model, data, 0)
    engine.mj_kinematics(model, data)
    rows = {shape: row for row, shape in enumerate(drawn)}
    found, corners = [], 0
    for n in range(model.ngeom):
        kind, size, points, triangles = _describe(engine, model, n)
        corners += len(points) // 3
        if not kind or int(model.geom_group[n]) > 2 or corners > _MOST:
            continue
        name = model.geom(n).name or f"shape {n}"
        turn = np.zeros(4)
        engine.mju_mat2Quat(turn, data.geom_xmat[n])
        at = (*data.geom_xpos[n].tolist(), *turn[1:].tolist(), float(turn[0]))
        if n in rows:
            role = "held" if _is_carried(model, int(model.geom_bodyid[n]), body) else "moves"
            found.append(Shape(name, kind, size, "place", "attitude", rows[n], at, role, points, triangles))
        else:
            found.append(Shape(name, kind, size, "", "", 0, at, "fixed", points, triangles))
    return tuple(found)


def _is_carried(model: Any, body: int, carrier: int) -> bool:
    while body > 0:
        if body == carrier:
            return True
        body = int(model.body_parentid[body])
    return False


def _describe(engine: Any, model: Any, n: int) -> tuple[str, tuple[float, ...], tuple[float, ...], tuple[int, ...]]:
    """Kind, measures, points and corners of shape `n`; an empty kind for what has no picture here."""
    kinds, size = engine.mjtGeom, [max(float(x), 1e-6) for x in model.geom_size[n]]
    kind = int(model.geom_type[n])
    if kind == kinds.mjGEOM_MESH:
        mesh = int(model.geom_dataid[n])
        first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        start, faces = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
        points = model.mesh_vert[first : first + count].ravel().astype(float).round(7)
        corners = model.mesh_face[start : start + faces].ravel()
        return "mesh", (), tuple(points.tolist()), tuple(corners.tolist())
    if kind == kinds.mjGEOM_PLANE:
        half = [size[i] if size[i] > 1e-6 else _PLANE[i] for i in range(2)]
        return "box", (half[0], half[1], _PLANE[2]), (), ()
    known = {
        int(kinds.mjGEOM_SPHERE): ("sphere", 1), int(kinds.mjGEOM_CAPSULE): ("capsule", 2),
        int(kinds.mjGEOM_CYLINDER): ("cylinder", 2), int(kinds.mjGEOM_BOX): ("box", 3),
        int(kinds.mjGEOM_ELLIPSOID): ("ellipsoid", 3),
    }  # fmt: skip
    if kind not in known:
        return "", (), (), ()
    name, count = known[kind]
    return name, tuple(size[:count]), (), ()
