"""Data dictionary of an export in the form of BIDS: every column with its unit and the meaning of its values."""

from __future__ import annotations

import re
from typing import Any

from haptorb_study.columns import COLUMNS
from haptorb_study.incidents import COLUMNS as EVENT_COLUMNS
from haptorb_study.study_file import Study

__all__ = ["FLAGS", "WORDS", "describe_columns", "describe_events", "describe_questions"]


FLAGS = ("simulated", "simulated_device", "pilot")  #: Boolean columns
#: text columns; the rest are numbers
WORDS = ("participant", "phase", "condition", "other", "safety", "recording", "answered", "study")
_UNIT_SUFFIX = re.compile(r"(.*) \[(.+)\]")
_FIXED: dict[str, dict[str, str]] = {
    "simulated": {"true": "a simulated participant", "false": "a person"},
    "simulated_device": {"true": "simulated device: nobody felt a force", "false": "a real device"},
    "pilot": {"true": "pilot data", "false": "not a pilot"},
    "phase": {"practice": "before the main trials; left out of every analysis", "main": "counts"},
    "interval": {"0": "a single interval", "1": "the first of two", "2": "the second of two"},
    "correct": {"1": "right", "0": "wrong"},
}


def describe_columns(study: Study) -> dict[str, dict[str, Any]]:
    """Column → Description, Units if it has one, Levels if its values have names."""
    found: dict[str, dict[str, Any]] = {}
    for name, about in COLUMNS.items():
        split = _UNIT_SUFFIX.fullmatch(about)
        entry: dict[str, Any] = {"Description": split[1] if split else about}
        unit = study.level_unit if name == "level" else split[2] if split else ""
        if unit:
            entry["Units"] = unit
        if levels := _list_levels(study, name):
            entry["Levels"] = levels
        if name in FLAGS:
            entry["Format"] = "boolean"
        elif name == "answered":
            entry["Format"] = "datetime"
        found[name] = entry
    found["study"]["Levels"] = {study.name: f"digest {study.digest}"}
    if study.levels is not None:
        found["level"]["Description"] += f"; parameter '{study.levels.parameter}' of the world"
    return found


def describe_events() -> dict[str, dict[str, Any]]:
    """Data dictionary of the table of events."""
    found: dict[str, dict[str, Any]] = {}
    for name, about in EVENT_COLUMNS.items():
        split = _UNIT_SUFFIX.fullmatch(about)
        found[name] = {"Description": split[1], "Units": split[2]} if split else {"Description": about}
    found["event"]["Levels"] = {
        "stop": "coils off by a person or the program: the reason says whose Stop it was",
        "resume": "coils on again, from zero",
        "repeat": "the trial began again",
        "safety": "the device switched off by itself",
        "leave": "ended; can be continued",
        "abort": "ended for good",
        "no consent": "the participant did not agree to take part",
        "failure": "the program or the device failed; can be continued",
    }
    return found


def describe_questions(study: Study) -> dict[str, dict[str, Any]]:
    """Data dictionary of the table of replies: one row per participant and question."""
    return {
        "participant": {"Description": COLUMNS["participant"]},
        "question": {"Description": "name of the question", "Levels": {q.name: q.text for q in study.questions}},
        "text": {"Description": "the question as it was asked"},
        "reply": {
            "Description": "the answer",
            "Levels": {q.name: " | ".join(q.choices) for q in study.questions if q.choices},
        },
    }


def _list_levels(study: Study, name: str) -> dict[str, str]:
    """Value → meaning; empty where values are numbers or free text."""
    if name in ("condition", "other"):
        values = {one.name: _spell_out(one.parameters) for one in study.conditions}
        return values if name == "condition" or study.procedure == "forced-choice" else {}
    places = {str(p.number): f"θ = {p.theta_deg:g} deg, φ = {p.phi_deg:g} deg" for p in study.points}
    if name == "set_point":
        return {"0": "none", **places}
    if name != "answer":
        return dict(_FIXED.get(name, {}))
    match study.procedure:
        case "identification":
            return places
        case "constant" | "staircase" | "bayesian":
            return {"1": "the first interval pushed harder", "2": "the second interval pushed harder"}
        case "forced-choice":
            return {"1": "the first interval is preferred", "2": "the second interval is preferred"}
        case "rating":
            low, high = study.rating.low, study.rating.high
            between = {str(n): f"{n} on the scale from {low} to {high}" for n in range(low + 1, high)}
            return {str(low): f"lowest of '{study.rating.question}'", **between, str(high): "greatest"}
    return {}


def _spell_out(parameters: dict[str, Any]) -> str:
    return ", ".join(f"{name} = {value}" for name, value in parameters.items()) or "parameters of the study file"
