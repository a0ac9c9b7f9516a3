"""Study file templates, commented with meaning, unit and range of each key from the schema."""

from __future__ import annotations

import re
from pathlib import Path
from textwrap import wrap

from haptorb import worlds
from haptorb.devices.schema import KeyText, list_keys
from haptorb.errors import InputError, RecordingError, UnknownName, quote
from haptorb.files import replace_file
from haptorb.worlds.base import parameters
from haptorb_study.study_file import Study, study_of

__all__ = ["TEMPLATES", "make_study_text", "read_template", "write_study"]

TEMPLATES = ("zarate2020", "identification", "staircase", "magnitude", "comparison")
_COMMENT_WIDTH = 100  #: of a comment line
_KEY = re.compile(r"([a-z_]+) = ")
_TABLE = re.compile(r"\[\[?([a-z_]+)\]\]?")


def read_template(like: str) -> str:
    """Text of the template `like`, without comments on its keys; UnknownName for an unknown one."""
    if like not in TEMPLATES:
        raise UnknownName("template of a study", like, TEMPLATES)
    return (Path(__file__).parent / "templates" / f"{like}.toml").read_text(encoding="utf-8")


def make_study_text(name: str, like: str = "identification") -> str:
    """Study file with the name `name`: a template with comments on its keys. InputError for an invalid name."""
    keys = {key.path: key for key in list_keys(Study)}
    template = read_template(like).splitlines()
    lines, table, known = [line.replace("#:", "#", 1) for line in template if line.startswith("#:")], "", set()
    for line in ["", f'name = "{name}"', *(line for line in template if not line.startswith("#:"))]:
        path = ""
        if found := _TABLE.fullmatch(line):
            path, table = found[1], f"{found[1]}."
        elif found := _KEY.match(line):
            path = table + found[1]
        if path and path not in known:
            known.add(path)
            text = keys[path].meaning if line.startswith("[") else ""
            lines += [f"# {part}" for part in wrap(text or _describe(path, keys), _COMMENT_WIDTH - 2)]
            if "{ " in line or line.endswith(" = ["):  # keys of an inline table
                inner = [one for one in keys if one.startswith(f"{path}.")]
                lines += [f"#   {one.removeprefix(path)[1:]}: {_describe(one, keys)}" for one in inner]
        lines.append(line)
    text = "\n".join([*lines, "", "# All keys: docs/reference/study-file.md", ""])
    if study_of(text, f"{name}.toml").name != name:
        raise InputError(f"name must be at most 41 letters, digits, hyphens and underscores; got {quote(name)}")
    return text


def write_study(name: str, like: str = "identification", *, overwrite: bool = False) -> Path:
    """Write NAME.toml into the current folder; `name` may end in .toml.

    RecordingError, and nothing written, if it exists.
    """
    path = Path(name if name.lower().endswith(".toml") else f"{name}.toml")
    name = str(path)[: -len(".toml")]
    text = make_study_text(name, like)
    if path.exists() and not overwrite:
        refused = f"{path} exists; choose another name, or replace it"
        raise RecordingError(f"{refused} with overwrite=True", command=f"{refused} with --force")
    try:
        with replace_file(path) as part:
            part.write_text(text, encoding="utf-8")
    except OSError as cause:
        raise RecordingError(f"cannot write {path}: {cause.strerror or cause}") from cause
    return path


def _describe(path: str, keys: dict[str, KeyText]) -> str:
    """One-line description of a key: meaning, unit, values, default."""
    if path.startswith("parameters."):
        about = parameters(worlds.find_world("dome"))[path.removeprefix("parameters.")]
        return f"{about.about} [{about.unit}]; {about.low:g} to {about.high:g}; default {about.default}"
    key = keys[path]
    unit = "" if key.unit in ("none", "1") else f" [{key.unit}]"
    span = "" if key.range in ("text", "any", "the keys below") else key.range
    default = "" if len(key.default) > _COMMENT_WIDTH // 2 or key.default.startswith("none") else key.default
    parts = (f"{key.meaning}{unit}", span, default if default in ("", "required") else f"default {default}")
    return "; ".join(part for part in parts if part)
