"""A scene compiled by MuJoCo, from an XML file or from Python, and the messages when it cannot be compiled."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from haptorb.errors import InputError, UnknownName, quote
from haptorb.files.file_kind import FileKind, find_kind
from haptorb.worlds.scene.scene_check import check_scene_file
from haptorb.worlds.scene.scene_compiler import compile_scene

__all__ = ["SHIPPED", "SceneModel", "find_scene_file", "load_engine", "make_scene_model"]

_FOLDER = Path(__file__).parent / "shipped"
#: scenes that are part of this package
SHIPPED = ("peg", "outlet", "boxes", "drawer")
_LINE = re.compile(r"[Ll]ine(?: number)?\s*=?\s*(\d+)")


@cache
def load_engine() -> Any:
    """MuJoCo itself, set to write no files. Raises InputError that states what to install if it is missing."""
    try:
        import mujoco
    except ImportError as cause:
        raise InputError(f"scenes need MuJoCo: pip install 'haptorb[scenes]' ({cause})") from cause
    # Else it writes MUJOCO_LOG.TXT into the working directory, in the middle of a tick.
    mujoco.set_mju_user_warning(_ignore)
    return mujoco


def _ignore(text: str) -> None:
    """What a warning is about is found in the state."""


def find_scene_file(text: str, folder: Path | None = None) -> Path:
    """The file that `text` names: a supplied scene, or a path; relative to `folder`, else to the working directory.

    Raises UnknownName for anything else.

    >>> find_scene_file("peg").name
    'peg.xml'
    """
    if text in SHIPPED:
        return _FOLDER / f"{text}.xml"
    place = (folder or Path()) / text
    if not text.endswith(".xml") and (other := find_kind(place)) is not None:
        raise InputError(FileKind.SCENE.explain_found(place, other))
    if not text.endswith(".xml"):
        raise UnknownName("scene", text, (*SHIPPED, "FILE.xml"))
    return Path(os.path.abspath((folder or Path()) / Path(text).expanduser()))


@dataclass(frozen=True)
class SceneModel:
    """A compiled scene; it can be sent to another process.

    title   its file's name without the ending, or the model's own
    file    where it comes from; None: from Python
    model   MuJoCo's MjModel; only the iterations of its solver are changed here
    """

    title: str
    file: Path | None
    model: Any = field(repr=False, compare=False)
    pads: dict[Any, Any] = field(default_factory=dict, repr=False, compare=False)  #: of `SceneStepper`, made once each

    def __getstate__(self) -> dict[str, Any]:
        """Without the scratch pads, which the receiver creates again."""
        return {"title": self.title, "file": self.file, "model": self.model, "pads": {}}

    @property
    def held(self) -> str:
        """The default held body: the one that the file names, else "peg". Raises InputError if there is neither."""
        model = self.model
        for n in range(model.ntext):
            named, first = int(model.name_textadr[n]), int(model.text_adr[n])
            if model.names[named:].split(b"\0", 1)[0] == b"held":
                text = model.text_data[first : first + int(model.text_size[n])]
                return str(bytes(text).split(b"\0", 1)[0].decode())
        if "peg" not in self.bodies:
            known = f" ({', '.join(self.bodies)})" if self.bodies else ""
            raise InputError(
                f"scene '{self.title}' does not state which body the device holds: name one{known} with --body, or in "
                'the file with <custom><text name="held" data="BODY"/></custom>'
            )
        return "peg"

    @property
    def bodies(self) -> list[str]:
        """Names of the bodies that have one, the world excepted."""
        return [name for i in range(1, self.model.nbody) if (name := self.model.body(i).name)]

    def find_body(self, name: str) -> int:
        """Index [1] of the body `name`. Raises UnknownName with the most similar one of the scene, and InputError
        for one that cannot move."""
        model = self.model
        if name not in self.bodies:
            raise UnknownName(f"body of scene '{self.title}'", name, self.bodies)
        index = int(model.body(name).id)
        if not self.count_freedoms(index):
            raise InputError(
                f"body '{name}' of scene '{self.title}' cannot be moved: neither it nor a body that carries it has a "
                "joint; give it one, such as <freejoint/>, or name another body with --body"
            )
        return index

    def count_freedoms(self, body: int) -> int:
        """Number of degrees of freedom [1] of `body`, from its own joints and those of its parents."""
        model, count = self.model, 0
        while body > 0:
            count += int(model.body_dofnum[body])
            body = int(model.body_parentid[body])
        return count

    def check_period(self, period: float) -> int:
        """Number of steps of the scene [1] in a tick of `period` [s]. Raises InputError if it is not a whole number."""
        step = float(self.model.opt.timestep)
        count = round(period / step)
        if count < 1 or abs(count * step - period) > 1e-9:
            raise InputError(
                f"scene '{self.title}': its timestep of {1e3 * step:g} ms does not divide the tick of "
                f'{1e3 * period:g} ms; set <option timestep="{period / max(round(period / step), 1):.6g}"/>, or '
                "another --rate"
            )
        return count


def make_scene_model(source: object) -> SceneModel:
    """The compiled scene `source`: a supplied scene, the path of an XML file, or an MjModel.

    Raises UnknownName for an unknown name; InputError for a file that cannot be read or compiled, with the line if
    the engine states it, and for a scene without a movable body.
    """
    if isinstance(source, SceneModel):
        return source
    engine = load_engine()
    if isinstance(source, engine.MjModel):
        return _check(SceneModel(source.names.split(b"\0")[0].decode() or "model", None, source))
    if not isinstance(source, str | Path):
        raise InputError(f"a scene is a name, a path of an XML file, or an MjModel of MuJoCo; got {quote(source)}")
    path = find_scene_file(str(source))
    own = path.parent == _FOLDER
    if not own:
        check_scene_file(path)  # safety: scene-checked
    try:
        model = engine.MjModel.from_xml_path(str(path)) if own else compile_scene(engine, path)
    except Exception as cause:  # ValueError, FatalError, SceneFailure
        raise InputError(_explain(path, str(cause))) from cause
    return _check(SceneModel(path.stem, path, model))


def _explain(path: Path, text: str) -> str:
    """The engine's words in one line, with the line of the file first."""
    plain = " ".join(text.replace("XML Error:", "").replace("Error:", "").split())
    found = _LINE.search(plain)
    where = f"{path}, line {found.group(1)}" if found else str(path)
    return f"scene {where}: {plain}"


def _check(scene: SceneModel) -> SceneModel:
    model = scene.model
    if model.nv == 0:
        raise InputError(
            f"scene '{scene.title}' has nothing that can be moved: no body has a joint; give the body that is to be "
            "held one, such as <freejoint/>"
        )
    if model.nu or model.na:
        raise InputError(
            f"scene '{scene.title}' has actuators, which haptorb does not drive: remove <actuator>, or use springs of "
            "joints and <equality>"
        )
    if int(model.opt.integrator) == int(load_engine().mjtIntegrator.mjINT_RK4):
        raise InputError(
            f"scene '{scene.title}' has the integrator RK4, which computes all forces four times in a step, without "
            'the hand\'s force in between; set <option integrator="implicitfast"/>'
        )
    loose = np.flatnonzero((model.body_dofnum > 0) & (model.body_mass <= 0.0) & (model.body_subtreemass <= 0.0))
    if loose.size:
        raise InputError(f"scene '{scene.title}': body '{model.body(int(loose[0])).name}' moves but has no mass")
    return scene
