"""Names of version 0.1 that still work: where its modules are now, and the remark that names the new name.

Whoever imports from an earlier module gets what is there now, and one `EarlierNameWarning` per name, a FutureWarning,
which Python shows by default. Nothing is imported before a name is used, and no file is searched: `EARLIER` decides.
"""

from __future__ import annotations

import sys
from functools import cache
from importlib import import_module
from importlib.machinery import ModuleSpec
from types import ModuleType
from warnings import warn_explicit

__all__ = ["EARLIER", "EarlierNameWarning", "find_module", "get_earlier", "install_finder", "warn_earlier"]

#: module, or module:name, of version 0.1 → where that is now; text with spaces instead says what to use.
#: The imports in the documents of version 0.1, and the modules of worlds, which its recordings name.
EARLIER = {
    "haptorb:felt_map": "haptorb:force_map",
    "haptorb.apps.feel": "haptorb_study.feel",
    "haptorb.apps.inspect.errors": "haptorb.cli.error_report",
    "haptorb.apps.inspect.errors:report_errors": "haptorb:inspect_errors",
    "haptorb.apps.study.analysis.load_analysis": "haptorb_study.analysis.analysis",
    "haptorb.apps.study.analysis.load_analysis:analysis_of": "haptorb_study:analysis_of",
    "haptorb.control.budget.error_model": "haptorb.analysis.error_budget",
    "haptorb.control.budget.error_model:ErrorSource": "haptorb:ErrorSource",
    "haptorb.control.stability.hand_grip": "haptorb.analysis.stability",
    "haptorb.control.stability.hand_grip:GRIPS": "haptorb:GRIPS",
    "haptorb.control.stability.hand_grip:HandGrip": "haptorb:HandGrip",
    "haptorb.control.stability.stability": "haptorb.analysis.stability",
    "haptorb.control.stability.stability:SampledLoop": "haptorb:SampledLoop",
    "haptorb.design.design_file": "haptorb_design.design_file",
    "haptorb.design.design_file:load_design": "haptorb_design:load_design",
    "haptorb.design.design_file:parse_design": "haptorb_design:parse_design",
    "haptorb.design.sampling": "haptorb_design.sampling",
    "haptorb.design.sampling:sample": "haptorb_design:sample_parameters",
    "haptorb.design.sampling:sweep": "haptorb_design:sweep",
    "haptorb.design.store": "haptorb_design.store",
    "haptorb.design.store:open_results": "haptorb_design:open_results",
    "haptorb.design.store:read_results": "haptorb_design:read_results",
    "haptorb.design.workers.open_workers": "haptorb_design.workers",
    "haptorb.design.workers.open_workers:open_workers": "haptorb_design:open_workers",
    "haptorb.devices.device": "haptorb.devices.base",
    "haptorb.devices.device:Device": "haptorb:Device",
    "haptorb.devices.electromagnet.core_dynamics": "haptorb.devices.core_parameters",
    "haptorb.devices.electromagnet.core_dynamics:fit_eddy_lag": "haptorb.devices:fit_eddy_lag",
    "haptorb.devices.electromagnet.shell_capability": "haptorb.devices.electromagnet_capability",
    "haptorb.devices.electromagnet.shell_capability:shell_capability": "haptorb.devices:shell_capability",
    "haptorb.devices.kind": "haptorb.devices.registry",
    "haptorb.devices.kind:DeviceKind": "haptorb.devices.DeviceKind has no functions; they are registered for the "
    'device\'s class with haptorb.kinds: see the how-to guide "Add a device"',
    "haptorb.devices.kind:register": "haptorb.devices:register_kind",
    "haptorb.devices.state": "haptorb.devices.base",
    "haptorb.devices.state:State": "haptorb:State",
    "haptorb.numerics.arrays": "haptorb.arrays",
    "haptorb.numerics.compiled": "haptorb.compiled",
    "haptorb.physics.interaction": "haptorb.magnetics.interaction",
    "haptorb.physics.interaction:wrench": "haptorb.magnetics:wrench",
    "haptorb.physics.sources.dipole": "haptorb.magnetics.dipole",
    "haptorb.physics.sources.dipole:Dipole": "haptorb.magnetics:Dipole",
    "haptorb.physics.sources.dipole:field": "haptorb.magnetics:dipole_field",
    "haptorb.physics.sources.dipole:field_gradient": "haptorb.magnetics:dipole_field_gradient",
    "haptorb.physics.sources.placement": "haptorb.magnetics.source",
    "haptorb.physics.sources.placement:PlacedSource": "haptorb.magnetics:PlacedSource",
    "haptorb.physics.sources.ring": "haptorb.magnetics.magnets",
    "haptorb.physics.sources.ring:RingMagnet": "haptorb.magnetics:RingMagnet",
    "haptorb.physics.sources.source": "haptorb.magnetics.source",
    "haptorb.physics.sources.source:Source": "haptorb.magnetics:Source",
    "haptorb.runtime.drivers.driver": "haptorb.runtime.drivers.base",
    "haptorb.runtime.drivers.driver:Driver": "haptorb:Driver",
    "haptorb.runtime.replay.replay": "haptorb.replay.replay",
    "haptorb.runtime.replay.replay:Replay": "haptorb:Replay",
    "haptorb.runtime.trackers.feed": "haptorb.runtime.trackers.base",
    "haptorb.runtime.trackers.feed:Feed": "haptorb:Feed",
    "haptorb.runtime.trackers.feed:RawPose": "haptorb:RawPose",
    "haptorb.sensing.estimator": "haptorb.estimation.types",
    "haptorb.sensing.estimator:Estimator": "haptorb:Estimator",
    "haptorb.sensing.estimator:EstimatorChoice": "haptorb.kinds:EstimatorChoice",
    "haptorb.sensing.estimator:EstimatorSettings": "haptorb.kinds:EstimatorSettings",
    "haptorb.sensing.estimator:TrackedPose": "haptorb:TrackedPose",
    "haptorb.sensing.sample": "haptorb.estimation.types",
    "haptorb.sensing.sample:Estimate": "haptorb:Estimate",
    "haptorb.sensing.sample:Pose": "haptorb:Pose",
    "haptorb.sensing.sample:Sample": "haptorb:Sample",
    "haptorb.simulation.simulation": "haptorb.simulation.base",
    "haptorb.simulation.simulation:Simulation": "haptorb:Simulation",
    "haptorb.worlds.basic.detents": "haptorb.worlds.basic",
    "haptorb.worlds.basic.fluid": "haptorb.worlds.fluid",
    "haptorb.worlds.basic.guidance": "haptorb.worlds.guidance",
    "haptorb.worlds.basic.magnet": "haptorb.worlds.basic",
    "haptorb.worlds.basic.nothing": "haptorb.worlds.basic",
    "haptorb.worlds.basic.stick_slip": "haptorb.worlds.friction",
    "haptorb.worlds.basic.texture": "haptorb.worlds.basic",
    "haptorb.worlds.basic.vibration": "haptorb.worlds.basic",
    "haptorb.worlds.basic.wall": "haptorb.worlds.basic",
    "haptorb.worlds.bound_world": "haptorb.worlds.dynamic",
    "haptorb.worlds.contact_world": "haptorb.worlds.base",
    "haptorb.worlds.dynamic.ball": "haptorb.worlds.ball",
    "haptorb.worlds.dynamic.button": "haptorb.worlds.button",
    "haptorb.worlds.dynamic.friction": "haptorb.worlds.friction",
    "haptorb.worlds.dynamic.remote": "haptorb.worlds.client_force",
    "haptorb.worlds.dynamic.remote_sum": "haptorb.worlds.client_force",
    "haptorb.worlds.dynamic.stirred_fluid": "haptorb.worlds.fluid",
    "haptorb.worlds.dynamic:Remote": "haptorb.worlds.client_force:Remote",
    "haptorb.worlds.dynamic_world": "haptorb.worlds.dynamic",
    "haptorb.worlds.maps.changing": "haptorb.worlds.moving",
    "haptorb.worlds.maps.compass": "haptorb.worlds.dome",
    "haptorb.worlds.maps.dome": "haptorb.worlds.dome",
    "haptorb.worlds.maps.domes": "haptorb.worlds.dome",
    "haptorb.worlds.maps.terrain": "haptorb.worlds.terrain",
    "haptorb.worlds.memory": "haptorb.worlds.dynamic",
    "haptorb.worlds.own.failure": "haptorb.worlds.user_world",
    "haptorb.worlds.own.file_with_remote": "haptorb.worlds.user_world",
    "haptorb.worlds.own.function_world": "haptorb.worlds.user_world",
    "haptorb.worlds.own.started_code": "haptorb.worlds.user_world",
    "haptorb.worlds.own.world_file": "haptorb.worlds.user_world",
    "haptorb.worlds.own.world_note": "haptorb.worlds.user_world",
    "haptorb.worlds.parameter": "haptorb.worlds.base",
    "haptorb.worlds.parameter:parameter": "haptorb.worlds:parameter",
    "haptorb.worlds.path_guidance.box_solver": "haptorb.worlds.path_guidance",
    "haptorb.worlds.path_guidance.contouring": "haptorb.worlds.path_guidance",
    "haptorb.worlds.path_guidance.controller_state": "haptorb.worlds.path_guidance",
    "haptorb.worlds.path_guidance.guidance_path": "haptorb.worlds.path",
    "haptorb.worlds.path_guidance.path_checks": "haptorb.worlds.path",
    "haptorb.worlds.path_guidance.path_drawing": "haptorb.worlds.path",
    "haptorb.worlds.path_guidance.path_file": "haptorb.worlds.path",
    "haptorb.worlds.path_guidance.path_guidance": "haptorb.worlds.path_guidance",
    "haptorb.worlds.path_guidance.path_search": "haptorb.worlds.path_guidance",
    "haptorb.worlds.path_guidance.path_shapes": "haptorb.worlds.path",
    "haptorb.worlds.scene.background_step": "haptorb.worlds.scene_physics",
    "haptorb.worlds.scene.coupling": "haptorb.worlds.scene_physics",
    "haptorb.worlds.scene.pace": "haptorb.worlds.scene_physics",
    "haptorb.worlds.scene.scene": "haptorb.worlds.scene",
    "haptorb.worlds.scene.scene_check": "haptorb.worlds.scene_check",
    "haptorb.worlds.scene.scene_compiler": "haptorb.worlds.scene_compiler",
    "haptorb.worlds.scene.scene_file": "haptorb.worlds.scene",
    "haptorb.worlds.scene.scene_model": "haptorb.worlds.scene_physics",
    "haptorb.worlds.scene.scene_shapes": "haptorb.worlds.scene",
    "haptorb.worlds.scene.scene_work": "haptorb.worlds.scene",
    "haptorb.worlds.scene.stepping": "haptorb.worlds.scene_physics",
    "haptorb.worlds.shape": "haptorb.worlds.base",
    "haptorb.worlds.snap_fit.hook_contact": "haptorb.worlds.snap_fit",
    "haptorb.worlds.snap_fit.outlet": "haptorb.worlds.snap_fit",
    "haptorb.worlds.snap_fit.published_outlet": "haptorb.worlds.snap_fit",
    "haptorb.worlds.snap_fit.root_load": "haptorb.worlds.snap_fit",
    "haptorb.worlds.snap_fit.sliding": "haptorb.worlds.snap_fit",
    "haptorb.worlds.snap_fit.snap_fit": "haptorb.worlds.snap_fit",
    "haptorb.worlds.world": "haptorb.worlds.base",
    "haptorb.worlds.wrench_part": "haptorb.worlds.base",
}

#: packages whose lines are never the place of a remark: their users cannot change them; and Python's own importing
_SKIPPED = ("haptorb", "haptorb_design", "haptorb_study", "importlib", "_frozen_importlib")


class EarlierNameWarning(FutureWarning):
    """A name of version 0.1 was used; the next version does not understand it."""


def warn_earlier(text: str) -> None:
    """Emit the remark `text` at the innermost line outside haptorb, the one that its reader can change."""
    frame = sys._getframe(1)
    while frame.f_back is not None and str(frame.f_globals.get("__name__")).partition(".")[0] in _SKIPPED:
        frame = frame.f_back
    names = frame.f_globals
    warn_explicit(
        text, EarlierNameWarning, frame.f_code.co_filename, frame.f_lineno, module=str(names.get("__name__")),
        registry=names.setdefault("__warningregistry__", {}),
    )  # fmt: skip


def find_module(module: str, name: str) -> str:
    """Return the module in which `name` of the earlier `module` is now; `module` itself if it is no earlier one.

    >>> find_module("haptorb.worlds.maps.dome", "Dome"), find_module("haptorb.worlds.dome", "Dome")
    ('haptorb.worlds.dome', 'haptorb.worlds.dome')
    """
    return EARLIER.get(f"{module}:{name}", EARLIER.get(module, module)).partition(":")[0]


def get_earlier(module: str, name: str) -> object:
    """Return what `name` of the earlier `module` is now, with a remark that names the new name.

    Raises ImportError, which says what to use, if there is no such thing any more; AttributeError for other names.
    """
    before = f"{module}.{name}"
    home = EARLIER.get(module)
    now = EARLIER.get(f"{module}:{name}") or EARLIER.get(before) or (home and f"{home}:{name}")
    if now is None or name.startswith("__"):
        raise AttributeError(f"module '{module}' has no attribute '{name}'")
    if " " in now:
        raise ImportError(f"{before} does not exist any more: {now}", name=module)
    home, _, own = now.partition(":")
    found: object = import_module(home)
    if own:
        found = getattr(found, own)
    warn_earlier(f"{before} is now {home}.{own}: from {home} import {own}" if own else f"{before} is now {home}")
    return found


# --------------------------------------------------------------------------------------------------
# The earlier modules: empty until a name is used, and found by nothing but the table.


#: Earlier modules whose place is taken: their package is a file now, or has a public name like the module's, which
#: importing the module would replace. They stand in `sys.modules` from the start.
_WITHOUT_PLACE = (
    "haptorb.devices.electromagnet.core_dynamics", "haptorb.devices.electromagnet.shell_capability",
    "haptorb.worlds.parameter",
)  # fmt: skip


def _let_find(module: ModuleType) -> ModuleType:
    """Let `module` find its names when they are used, each once."""

    def get(name: str) -> object:
        found = get_earlier(module.__name__, name)
        setattr(module, name, found)
        return found

    module.__dict__["__getattr__"] = get
    return module


@cache
def _list_modules() -> dict[str, bool]:
    """List the earlier modules and their packages: name → whether it is a package."""
    modules = {key.partition(":")[0] for key in EARLIER}
    packages = {one[:place] for one in modules for place, sign in enumerate(one) if sign == "."}
    return {one: one in packages for one in modules | packages}


class _Finder:
    """Finder and loader of the modules in `EARLIER`; it is asked for what nobody else finds."""

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        """Return the spec of an earlier module; its path is empty, so that no file below it is ever searched."""
        if not name.startswith("haptorb.") or name not in _list_modules():
            return None
        return ModuleSpec(name, _Finder, is_package=_list_modules()[name])  # type: ignore[arg-type]

    @staticmethod
    def create_module(spec: ModuleSpec) -> None:
        """Let Python create it."""

    @staticmethod
    def exec_module(module: ModuleType) -> None:
        """Let it find its names."""
        _let_find(module)


def install_finder() -> None:
    """Let `import` find the earlier modules; as the last finder it costs nothing where another one finds."""
    if _Finder not in sys.meta_path:
        sys.meta_path.append(_Finder)
        sys.modules.update({name: _let_find(ModuleType(name)) for name in _WITHOUT_PLACE})
