"""State of a session for the pages: the participant's never reveals the prompt, the experimenter's has everything."""

from __future__ import annotations

from math import hypot
from typing import Any

import numpy as np

from haptorb_study.incidents import name_kind
from haptorb_study.pages.session_manager import SessionManager
from haptorb_study.prompts import Prompt
from haptorb_study.study_file import Study
from haptorb_study.trial_device import TrialDevice
from haptorb_study.trial_lists import numeric_prompt

__all__ = ["describe_study", "experimenter_view", "list_places", "participant_view", "pen_view"]


_MAX_CODES = 100  #: shown at most, the newest
_MAX_INCIDENTS = 200  #: shown at most, the newest
_MAX_BUTTONS = 21  #: of a rating scale; beyond, a number is typed


def describe_study(study: Study, simulated: bool) -> dict[str, Any]:
    """Constant part of the state: texts, places on the drawing, and masking noise.

    Set-points are drawn only where they are the possible answers.
    """
    return {
        "study": study.name,
        "procedure": study.procedure,
        "instructions": study.instructions,
        "consent": study.consent,
        "simulated": simulated,
        "places": list_places(study) if study.procedure == "identification" else [],
        "limit": study.load_device().workspace_half_angle * 180 / np.pi,
        "mask": study.mask.model_dump() if study.mask is not None else None,
    }


def list_places(study: Study) -> list[dict[str, float]]:
    """Number and angles [deg] of every set-point."""
    return [{"number": p.number, "theta": p.theta_deg, "phi": p.phi_deg} for p in study.points]


def participant_view(manager: SessionManager) -> dict[str, Any]:
    """State, task and progress; never the prompt, nor which interval holds the comparison.

    stopped      who stopped, "" if none did or the session was resumed since
    unconfirmed  whether the coils were switched off, and the device has not confirmed it
    """
    runner, session, trial_device = manager.runner, manager.session, manager.trial_device
    halt = manager.halt
    view: dict[str, Any] = {
        "state": "failed" if manager.dead else manager.now, "session": manager.number, "task": None,
        "question": None, "stopped": (halt.why or "by the program") if halt.active and session is not None else "",
        "unconfirmed": trial_device is not None and trial_device.unconfirmed,
    }  # fmt: skip
    if session is not None:
        view["resumed"] = session.resumed
    else:
        view["stored"] = manager.stored
    if runner is None or session is None:
        return view
    prompt, expected = runner.prompt, session.procedure.expected
    view |= {
        "trial": session.number,
        "done": session.number,
        "total": session.number + expected,
        "left": round(runner.rest_left),
        "off": runner.trial_device.switched_off,
        "steered": runner.trial_device.steered,
        "repeats": runner.repeats,
        "which": runner.which,
    }
    if prompt is not None:
        view["practice"] = prompt.phase == "practice"
        view["task"] = _task(manager.study, prompt)
    if (question := runner.question) is not None:
        view["question"] = {
            "name": question.name, "text": question.text, "choices": list(question.choices), "low": question.low,
            "high": question.high,
        }  # fmt: skip
    return view


def experimenter_view(manager: SessionManager, pages: int, draft: Any) -> dict[str, Any]:
    """Complete state: prompt, answers, trips and incidents."""
    view = participant_view(manager) | {
        "trouble": manager.trouble or ("the study program has failed and is closing" if manager.dead else ""),
        "pages": pages,
        "draft": draft,
        "log": manager.log[-200:],
        "code": "",
        "taken": list(manager.codes.taken[-_MAX_CODES:]),
        "free": manager.codes.free,
        "incidents": [
            {**one, "kind": name, "trial": one["trial"] + 1}
            for one in manager.history
            if (name := name_kind(one["kind"])) is not None
        ][-_MAX_INCIDENTS:],
    }
    runner, session = manager.runner, manager.session
    if session is not None:
        view["code"] = session.code
    if runner is not None:
        view["seconds"] = round(runner.seconds)
        view["trips"] = runner.trips
        if runner.prompt is not None:
            view["prompt"] = runner.prompt.row()
    return view


def pen_view(trial_device: TrialDevice) -> dict[str, Any] | None:
    """Tool seen from above [deg], and the force on it [N]: radial, and tangential along +x and +y."""
    position, force = trial_device.position, trial_device.force
    if position is None:
        return None
    x, y, z = position
    distance = hypot(x, y, z)
    round_ = hypot(x, y)
    theta = float(np.degrees(np.arctan2(round_, z)))
    view: dict[str, Any] = {
        "x": theta * x / round_ if round_ else 0.0, "y": theta * y / round_ if round_ else 0.0,
    "off": trial_device.switched_off,
    }  # fmt: skip
    if force is not None and distance > 0:
        way = np.array(position) / distance
        out = float(force @ way)
        # Tangential: polar and azimuthal component.
        outward = np.array([x, y, 0.0]) / round_ if round_ else np.array([1.0, 0.0, 0.0])
        about_ = np.array([-outward[1], outward[0], 0.0])
        down = np.cos(np.radians(theta)) * outward - np.sin(np.radians(theta)) * np.array([0.0, 0.0, 1.0])
        side = float(force @ down) * outward + float(force @ about_) * about_
        view |= {"out": out, "fx": float(side[0]), "fy": float(side[1])}
    return {key: round(value, 3) if isinstance(value, float) else value for key, value in view.items()}


def _task(study: Study, prompt: Prompt) -> dict[str, Any]:
    if prompt.interval:
        ask = "Which do you prefer?" if prompt.other else "Which one pushed harder?"
        return {"kind": "compare", "ask": ask, "numbers": [1, 2]}
    if prompt.high:
        few = prompt.high - prompt.low < _MAX_BUTTONS and not prompt.decimal
        return {
            "kind": "rate", "ask": numeric_prompt(study),
            "low": prompt.low, "high": prompt.high, "decimal": prompt.decimal,
            "numbers": list(range(prompt.low, prompt.high + 1)) if few else [],
        }  # fmt: skip
    if prompt.wants_number:
        return {"kind": "number", "ask": "Which place pushes?", "numbers": list(prompt.numbers)}
    return {"kind": "place", "ask": "Find the place that pushes, and stay there", "numbers": []}
