"""Messages of programs are parsed, or rejected with a reason."""

from __future__ import annotations

from contextlib import suppress

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from haptorb.errors import InputError
from haptorb.serve.osc import (
    AskParameters,
    ChangeWorld,
    CommandForce,
    SetParameter,
    Subscribe,
    Unsubscribe,
    parse_request,
)
from oracles.repetitions import repetitions


@pytest.mark.parametrize(
    ("address", "values", "expected"),
    [
        ("/haptorb/force", [1, -2.5, 0], CommandForce((1.0, -2.5, 0.0))),
        ("/haptorb/parameter/height", [0.002], SetParameter("height", 0.002)),
        ("/haptorb/parameter/direction", [0, 0, 1], SetParameter("direction", (0.0, 0.0, 1.0))),
        ("/haptorb/world", ["dome"], ChangeWorld("dome")),
        ("/haptorb/parameters", [], AskParameters()),
        ("/haptorb/subscribe", [], Subscribe(0, 100.0)),
        ("/haptorb/subscribe", [9001, 250], Subscribe(9001, 250.0)),
        ("/haptorb/subscribe", [9001.0], Subscribe(9001, 100.0)),
        ("/haptorb/unsubscribe", [9001], Unsubscribe(9001)),
    ],
)
def test_what_is_documented_is_understood(address: str, values: list[object], expected: object) -> None:
    assert parse_request(address, values) == expected


@pytest.mark.parametrize(
    ("address", "values"),
    [
        ("/haptorb/force", [float("nan"), 0, 0]),
        ("/haptorb/force", [0, float("inf"), 0]),
        ("/haptorb/force", [0, 0]),
        ("/haptorb/force", [0, 0, True]),
        ("/haptorb/force", ["1", "2", "3"]),
        ("/haptorb/force", [1, 2, 3, 4]),
        ("/haptorb/parameter/height", []),
        ("/haptorb/parameter/height", [1, 2, 3, 4]),
        ("/haptorb/parameter/height", ["high"]),
        ("/haptorb/parameter/height", [None]),
        ("/haptorb/parameter/", [1.0]),
        ("/haptorb/parameter/a/b", [1.0]),
        ("/haptorb/parameter/" + "a" * 900, [1.0]),
        ("/haptorb/world", [7]),
        ("/haptorb/world", ["a" * 900]),
        ("/haptorb/subscribe", [70000]),
        ("/haptorb/subscribe", [9001.5]),
        ("/haptorb/subscribe", [9001, 0]),
        ("/haptorb/subscribe", [9001, 1e9]),
        ("/haptorb/subscribe", [9001, 100, 1]),
        ("/haptorb/position", [1, 2, 3]),
        ("/*", [1]),
    ],
)
def test_what_is_not_is_refused_in_one_short_line(address: str, values: list[object]) -> None:
    with pytest.raises(InputError) as refusal:
        parse_request(address, values)
    assert len(str(refusal.value)) < 700
    assert "\n" not in str(refusal.value)


def test_an_unknown_address_is_answered_with_the_nearest() -> None:
    with pytest.raises(InputError, match="/haptorb/subscribe"):
        parse_request("/haptorb/subscribed", [])


@settings(max_examples=repetitions(33, 100), deadline=None)
@given(
    st.sampled_from(
        ["/haptorb/force", "/haptorb/wrench", "/haptorb/parameter/x", "/haptorb/subscribe", "/haptorb/world"]
    ),
    st.lists(st.one_of(st.integers(-(2**63), 2**63 - 1), st.floats(), st.text(), st.none(), st.booleans()), max_size=7),
)
def test_no_value_does_anything_else(address: str, values: list[object]) -> None:
    with suppress(InputError):
        parse_request(address, values)
