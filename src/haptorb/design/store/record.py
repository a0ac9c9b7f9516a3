"""A Design as results keep it: with its base device, so that they can be read without any other file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import partial
from typing import Any

from haptorb.design.base_values import compute_base_values
from haptorb.design.candidate import DesignCandidate
from haptorb.design.design import Bound, Design, DesignGoal
from haptorb.design.parameter import DesignParameter, ParameterPlace
from haptorb.design.quantity import DesignQuantity
from haptorb.devices.device_text import DeviceText
from haptorb.devices.loader import DeviceTables
from haptorb.errors import InputError

__all__ = ["read_record", "write_record"]


def write_record(design: Design) -> str:
    """JSON of everything but the file's text and its digest, with the base device's own numbers, which are computed."""
    tables = design.base_tables
    return json.dumps({
        "title": design.title,
        "base": design.base,
        "options": dict(design.options),
        "tables": {"name": tables.name, "values": tables.values, "text": tables.text},
        "device": tables.file.as_note() if tables.file else {},
        "parameters": [
            {"name": one.name, "unit": one.unit, "low": one.low, "high": one.high, "step": one.step,
             "choices": [list(choice) for choice in one.choices],
             "places": [[place.key, place.factor, place.offset] for place in one.places]}
            for one in design.parameters
        ],
        "goals": [{"name": goal.name, "sense": goal.sense, **_write_quantity(goal.quantity)} for goal in design.goals],
        "bounds": [{"name": one.name, "low": one.low, "high": one.high, **_write_quantity(one.quantity)}
                   for one in design.bounds],
        "base_values": compute_base_values(design),
    }, default=str)  # fmt: skip


def read_record(name: str, text: str, digest: str, record: str) -> Design:
    """The Design that `write_record` wrote. A user's own function is not there: computing it raises InputError."""
    raw: Mapping[str, Any] = json.loads(record)
    file = DeviceText.from_note(raw.get("device", {}))
    return Design(
        name=name,
        title=raw["title"],
        base=raw["base"],
        parameters=tuple(_read_parameter(one) for one in raw["parameters"]),
        goals=tuple(DesignGoal(_read_quantity(one), one["sense"], one["name"]) for one in raw["goals"]),
        bounds=tuple(Bound(one["name"], _read_quantity(one), one["low"], one["high"]) for one in raw["bounds"]),
        options=raw["options"],
        text=text,
        digest=digest,
        tables=DeviceTables(**raw["tables"], file=file),
        base_values=raw.get("base_values"),
    )


def _write_quantity(quantity: DesignQuantity) -> dict[str, Any]:
    return {"quantity": quantity.name, "unit": quantity.unit, "wanted": quantity.sense, "text": quantity.text,
            "kinds": list(quantity.kinds)}  # fmt: skip


def _read_quantity(raw: Mapping[str, Any]) -> DesignQuantity:
    name = raw["quantity"]
    return DesignQuantity(name, raw["unit"], raw["wanted"], raw["text"], tuple(raw["kinds"]), partial(_compute, name))


def _compute(name: str, candidate: DesignCandidate) -> float:
    """haptorb's own quantity of that name, now; what a user's function computed is known by its results only."""
    from haptorb.design.objectives import quantity

    try:
        return quantity(name).compute(candidate)
    except InputError as cause:
        raise InputError(f"'{name}' cannot be computed from a results file: {cause}") from cause


def _read_parameter(raw: Mapping[str, Any]) -> DesignParameter:
    places = tuple(ParameterPlace(*place) for place in raw["places"])
    choices = tuple((label, value) for label, value in raw["choices"])
    return DesignParameter(raw["name"], places, raw["unit"], raw["low"], raw["high"], raw["step"], choices)
