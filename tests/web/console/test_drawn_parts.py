"""The page's picture of a scene: its bodies, by its own code and without a browser."""

from __future__ import annotations

import json
import shutil
import subprocess
from importlib.resources import files

import numpy as np
import pytest

import haptorb
from haptorb.devices.loader import parse
from haptorb.web.session import describe_scene

OMNI = (files("haptorb.devices") / "catalogue" / "omni.toml").read_text(encoding="utf-8")
TURNED = """
based_on = "pmsm"
name = "turned"
title = "PMSM with its coils and sensors turned by 2°"
[electromagnets]
rings = [
  { latitude = "-26 deg", count = 8, first = "24.5 deg", step = "45 deg" },
  { latitude = "26 deg", count = 8, first = "24.5 deg", step = "45 deg" },
  { latitude = "0 deg", count = 8, first = "2 deg", step = "45 deg" },
]
"""
#: the page's own modules, and a document that has no more than they look at while they build a picture
ENTRY = """
globalThis.matchMedia = () => ({ matches: false, addEventListener() {} });
globalThis.getComputedStyle = () => ({ getPropertyValue: () => "#808080" });
const nothing = new Proxy({}, { get: () => () => {}, set: () => true });
globalThis.document = { documentElement: null, createElement: () => ({ getContext: () => nothing }) };
const { Body } = await import("./scene/body");
const { Rotor } = await import("./scene/rotor");
const scene = JSON.parse(process.argv[2]);
const corners = (mesh, matrix) => {
  const at = mesh.geometry.getAttribute("position");
  const corner = (k) => mesh.position.clone().fromBufferAttribute(at, k).applyMatrix4(matrix).toArray();
  return Array.from({ length: at.count }, (_, k) => corner(k));
};
const coils = [];
if (scene.kind === "dome") {
  const body = new Body(scene, () => {});
  body.group.updateMatrixWorld(true);
  for (const material of body.coils)
    for (const mesh of body.group.children) if (mesh.material === material) coils.push(corners(mesh, mesh.matrixWorld));
} else {
  const { coils: each } = new Rotor(scene, 1, () => {});
  for (let k = 0; k < each.count; k++) {
    const matrix = each.matrixWorld.clone();
    each.getMatrixAt(k, matrix);
    coils.push(corners(each, matrix));
  }
}
console.log(JSON.stringify(coils));
"""


@pytest.fixture(scope="module")
def drawn(tmp_path_factory, root):
    """A function from a device to the corners of its drawn coils, one (n, 3) [mm] for each."""
    web, tool = root / "web", shutil.which("node")
    if tool is None or not (web / "node_modules").exists():
        pytest.skip("no node on this machine, or the pages were built elsewhere")
    bundle = tmp_path_factory.mktemp("page") / "drawn.mjs"
    options = {
        "stdin": {"contents": ENTRY, "resolveDir": str(web / "src"), "loader": "ts"},
        "bundle": True, "format": "esm", "platform": "node", "outfile": str(bundle),
    }  # fmt: skip
    make = f"import {{ build }} from 'esbuild'; await build({json.dumps(options)})"
    subprocess.run([tool, "--input-type=module", "-e", make], cwd=web, check=True, timeout=120)

    def draw(device):
        scene = json.dumps(describe_scene(device))
        run = subprocess.run([tool, str(bundle), scene], check=True, timeout=120, capture_output=True)
        return [np.array(corners) for corners in json.loads(run.stdout)]

    return draw


def measure(corners, axis, centre):
    """Inner radius, outer radius and half length [mm] of a body's corners about `axis` through `centre`."""
    height = (corners - centre) @ axis
    distance = np.linalg.norm(corners - centre - height[:, None] * axis, axis=1)
    return distance.min(), distance.max(), np.abs(height).max()


def test_coils_of_omni_have_the_sizes_of_its_file(drawn):
    text = OMNI.replace("[22.3, 24.3, 26.3]", "[22.3, 24.3, 28.0]").replace("[18.0, 18.0, 18.0]", "[18.0, 15.0, 18.0]")
    device = parse(text, "mine.toml")
    bodies = drawn(device)
    assert len(bodies) == 3
    for k, corners in enumerate(bodies):
        moment = device.moment_per_current[:, k]
        sizes = measure(corners, moment / np.linalg.norm(moment), np.zeros(3))
        windings = device.windings
        wanted = windings.inner_radius[k], windings.outer_radius[k], windings.length[k] / 2
        assert sizes == pytest.approx(1e3 * np.array(wanted), abs=1e-4)


@pytest.mark.parametrize("device", [haptorb.load("pmsm"), parse(TURNED, "turned.toml")], ids=["pmsm", "turned"])
def test_coils_of_a_motor_are_at_the_places_of_its_file(drawn, device):
    bodies = drawn(device)
    assert len(bodies) == len(device.electromagnets)
    coil = device.electromagnet
    wanted = 1e3 * np.array([coil.inner_radius, coil.outer_radius, coil.length / 2])
    for corners, axis, place in zip(
        bodies, device.electromagnets.directions, 1e3 * device.electromagnets.positions, strict=True
    ):
        assert measure(corners, axis, place) == pytest.approx(wanted, abs=1e-4)
