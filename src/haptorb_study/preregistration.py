"""Registration of a study: study and analysis plan in one file with digests and time, written before data exist.

The database stores the plan's digest with every session, but cannot prove that the plan preceded the data. Deposit a
registration where another party dates it, such as a public registry.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from haptorb.errors import InputError
from haptorb.file_kind import FileKind
from haptorb.files import parse_toml, read_text
from haptorb.version import __version__
from haptorb_study.study_file import Study, study_of

__all__ = ["Registration", "read_registration", "write_registration"]


@dataclass(frozen=True)
class Registration:
    """A registered study."""

    name: str
    study: str  #: digest of the study
    plan: str  #: digest of its plan
    written: str  #: UTC, by this computer's clock


def write_registration(study: Study, path: Path) -> Registration:
    """Write `study`, which must have a plan, to the new file `path`."""
    if study.plan is None:
        raise InputError(f"study '{study.name}' has no plan to register: add [plan] with participants and tests")
    made = Registration(study.name, study.digest, study.plan.digest, datetime.now(UTC).isoformat(timespec="seconds"))
    text = study.text if study.text.endswith("\n") else f"{study.text}\n"
    # A literal string holds anything but three apostrophes; JSON escapes are valid in TOML.
    quoted = f"'''\n{text}'''" if "'''" not in text else json.dumps(text, ensure_ascii=False)
    lines = [
        "# A study before data exist: do not change it. `haptorb study analyse --registration` reads it.",
        "[registration]",
        f'name = "{made.name}"',
        f'study = "{made.study}"',
        f'plan = "{made.plan}"',
        f'written = "{made.written}"',
        f'haptorb = "{__version__}"',
        f"file = {quoted}",
    ]
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write("\n".join(lines) + "\n")
    except FileExistsError as cause:
        raise InputError(f"{path} exists: a registration is never replaced; choose another name") from cause
    except OSError as cause:
        raise InputError(f"{path}: the registration cannot be written ({cause.strerror})") from cause
    return made


def read_registration(path: Path) -> Registration:
    """The registration in the file `path`; InputError if it is invalid, or was changed after it was written."""
    try:
        found = parse_toml(read_text(path, "registration", InputError, kind=FileKind.REGISTRATION)).get("registration")
    except ValueError as cause:
        raise InputError(f"registration {path} is not TOML: {cause}") from cause
    keys = ("name", "study", "plan", "written", "file")
    if not isinstance(found, dict) or not all(isinstance(found.get(key), str) for key in keys):
        raise InputError(f"{path} is not a registration; `haptorb study check FILE --register NAME.toml` writes one")
    held = study_of(found["file"], f"in {path}", stored=True, devices=path.parent)
    if held.plan is None or (held.digest, held.plan.digest) != (found["study"], found["plan"]):
        raise InputError(f"registration {path} was CHANGED: the study in it is not that of its digests")
    return Registration(found["name"], found["study"], found["plan"], found["written"])
