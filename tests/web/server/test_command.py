"""Messages of a page become commands or error messages; a Stop is detected in any message."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from haptorb.errors import InputError
from haptorb.web.server import command, is_request

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(st.characters(), max_size=20),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8) | st.just("do"), inner, max_size=4),
    max_leaves=20,
)


def test_a_command_is_what_was_said():
    said = {"do": "world", "name": "dome", "values": {"moment": 1.5, "summit": [0, 0.6, 0.8]}, "grüße": "\U0001f600"}
    assert command(json.dumps(said)) == said


@pytest.mark.parametrize(
    "text",
    [
        "",
        "no json",
        "[]",
        "3",
        "{}",
        '{"do": []}',
        '{"do": {}}',
        '{"do": null}',
        '{"do": "' + "x" * 100 + '"}',
        '{"do": "world", "values": {"moment": ' + "9" * 400 + "}}",
        '{"do": "world", "values": {"moment": -' + "9" * 5000 + "}}",
        '{"do": "world", "values": {"moment": 1e400}}',
        '{"do": "world", "values": {"moment": -1e400}}',
        '{"do": "world", "values": {"moment": NaN}}',
        '{"do": "world", "values": {"moment": Infinity}}',
        '{"do": "world", "values": ' + "[" * 30 + "]" * 30 + "}",
        '{"do": ' + "[" * 900 + "]" * 900 + "}",
        "[" * 30000,
        '{"do": "reply", "reply": "\\ud800"}',
        '{"do": "reply", "\\udfff": 1}',
        '{"do": "x", "y": "' + "z" * 70000 + '"}',
    ],
)
def test_what_is_none_is_refused_in_a_sentence(text):
    with pytest.raises(InputError) as refused:
        command(text)
    assert len(str(refused.value)) < 300
    json.dumps(str(refused.value)).encode()


@given(JSON | st.dictionaries(st.just("do"), JSON, min_size=1))
def test_any_json_is_a_command_or_refused(value):
    text = json.dumps(value)
    try:
        found = command(text)
    except InputError:
        return
    assert isinstance(found["do"], str)
    json.dumps(found, allow_nan=False, ensure_ascii=False).encode()


@pytest.mark.parametrize(
    "text",
    [
        '{"do": "stop"}',
        '{"do":"stop","by":[' + "9" * 400 + "]}",
        '{ "x": NaN, "do" : "stop" }',
        '{"do": "stop"',
        '{"do": "stop", "why": "\\ud800"}',
        '{"do": "engage", "do": "stop"}',
        r'{"do": "\u0073top"}',
        r'{"\u0064\u006f":"\u0073\u0074\u006F\u0070", "why": ',
        b'{"do": "stop", "why": "\xff"}',
        '{"do": "stop", "deep": ' + "[" * 30000,
    ],
)
def test_a_stop_is_a_stop_whatever_else_is_wrong(text):
    assert is_request(text, "stop")


@pytest.mark.parametrize("text", ["", "stop", '{"do": "engage"}', json.dumps({"do": "reply", "reply": '"do": "stop"'})])
def test_other_words_are_none(text):
    assert not is_request(text, "stop")
