"""`haptorb check --scene`: the coupling that a loop and a hand allow, and how far inside the stable it is."""

from __future__ import annotations

from typing import TYPE_CHECKING

from haptorb.apps.terminal import make_console, print_facts, print_json, tell

if TYPE_CHECKING:
    from haptorb.apps.check import Setting
    from haptorb.devices.device import Device

__all__ = ["judge_scene"]


def judge_scene(
    device: Device, scene: str | None, body: str | None, world: str | None, settings: list[str], setting: Setting,
    json: bool,
) -> bool:  # fmt: skip
    """Print the coupling of `scene` on `device` under `setting`; whether the loop is stable with it against a wall.

    Raises UnknownName and InputError for a scene, body or value that cannot be.
    """
    from haptorb.apps.check.world import ENOUGH
    from haptorb.apps.cli.world_option import choose_scene_option
    from haptorb.control.stability.coupling_choice import couple_world, measure_margin
    from haptorb.display.quantity_text import format_number
    from haptorb.worlds.scene.scene import Scene

    found = choose_scene_option(scene, body, world, settings, device).load()
    loop = setting.loop(device)
    chosen = couple_world(found, device, loop, setting.hand)
    assert isinstance(chosen, Scene)
    coupled = chosen.for_device(device)
    margin = measure_margin(coupled, device, loop, setting.hand)
    verdict = "inside" if margin >= ENOUGH else ("close" if margin > 1.0 else "outside")
    numbers = {
        "device": device.name, "scene": coupled.model.title, "body": coupled.body, "verdict": verdict,
        "margin": margin, "chosen": not found.stiffness, "stiffness_n_per_m": coupled.stiffness,
        "damping_n_s_per_m": coupled.damping, "turn_stiffness_nm_per_rad": coupled.turn_stiffness,
        "turn_damping_nm_s_per_rad": coupled.turn_damping, "rate_hz": setting.rate, "latency_s": setting.latency,
        "grip": setting.grip,
    }  # fmt: skip
    if json:
        print_json(numbers)
        return margin > 1.0
    facts = [
        ("coupling", f"{coupled.stiffness:.4g} N/m, {coupled.damping:.3g} N·s/m"),
        ("chosen", "for this loop and hand" if not found.stiffness else "given"),
        ("against a wall", f"{verdict}: stable up to {format_number(margin)} times that"),
        ("loop", f"{setting.rate:g} Hz, forces {1e3 * loop.lateness:.2f} ms late, grip {setting.grip}"),
    ]
    if coupled.turn_stiffness:
        facts.insert(1, ("in turning", f"{coupled.turn_stiffness:.3g} N·m/rad, {coupled.turn_damping:.2g} N·m·s/rad"))
    tell(f"{device.name}, scene '{coupled.model.title}', body '{coupled.body}'")
    print_facts(make_console(), facts)
    return margin > 1.0
