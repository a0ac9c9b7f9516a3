"""Read a study file (TOML), with what haptorb adds to it and the world's code; refused before anyone sits down."""

from __future__ import annotations

from hashlib import sha256
from pathlib import Path

from pydantic import ValidationError

from haptorb.apps.own_code import start_world_file
from haptorb.apps.study.model.study_checks import check_study
from haptorb.apps.study.model.study_file import Study
from haptorb.apps.terminal import announce_wait
from haptorb.devices.schema.mistakes import explain_mistakes
from haptorb.errors import InputError
from haptorb.files.file_kind import FileKind
from haptorb.files.text_file import parse_toml, read_bytes, read_text
from haptorb.worlds.own.failure import try_world
from haptorb.worlds.own.world_file import WorldFile, is_world_file, parse_world_file

__all__ = ["read_study", "study_of"]

#: what "published" means today; a stored study without the key ran with 1 + 8 + 8 + 8
_PUBLISHED = "1-4-8-12"
#: how trials are ordered today; a stored study without the key keeps the earlier order, at random by default
_ORDER = "2"
_MISTAKES = 20  #: reported at once
_CODE = 1 << 20  #: bytes of a world's file


def read_study(path: str | Path) -> Study:
    """The study in the file `path`, with its world if that is in a file of its own, whose code is run.

    Raises InputError saying what is wrong, where, and what was expected.
    """
    return study_of(
        read_text(path, "study file", InputError, kind=FileKind.STUDY), str(path), Path(path).expanduser().parent
    )


def study_of(text: str, where: str = "study", folder: Path | None = None, *, stored: bool = False) -> Study:
    """The study that `text` (TOML) describes; `where` names it in messages.

    folder   of the study file, where a world's file is looked for; None: no file is read and no code is run, as for
             what a database holds
    stored   it is what a database holds: nothing is added to it, so it means what it meant when it was run
    """
    try:
        raw = parse_toml(text)
    except ValueError as cause:
        raise InputError(f"study file {where} is not TOML: {cause}") from cause
    if not stored and "order_version" not in raw:
        raw["order_version"], text = _ORDER, f'order_version = "{_ORDER}"\n{text}'
    try:
        study = Study.model_validate(raw).with_text(text, {})
        if not stored and study.set_points.layout == "published" and not study.published_layout:
            study = _add_key(study, "published_layout", _PUBLISHED)
        if is_world_file(study.world):
            if folder is None:
                return study
            study = _load_world(study, parse_world_file(study.world, folder))
        check_study(study)
    except ValidationError as cause:
        mistakes = explain_mistakes(cause.errors(), Study, _MISTAKES)
        lines = f" {mistakes[0]}" if len(mistakes) == 1 else "\n  ".join(["", *mistakes])
        raise InputError(f"study file {where}:{lines}") from cause
    except InputError as cause:
        raise InputError(f"study file {where}: {cause}") from cause
    return study


def _load_world(study: Study, file: WorldFile) -> Study:
    """`study` with the world in `file` and the digest of its code: sessions with other code are another study's."""
    with announce_wait(f"World file {file.path} has not returned from loading and its first call"):
        world = try_world(start_world_file(file), study.load_device())
    digest = sha256(read_bytes(file.path, _CODE, "world file", InputError)).hexdigest()
    if study.world_digest not in ("", digest):
        raise InputError(f"world_digest is not that of {file.path}: the file has changed; leave out the key")
    found = study if study.world_digest else _add_key(study, "world_digest", digest)
    return found.with_world(world)


def _add_key(study: Study, key: str, value: str) -> Study:
    """`study` with a key of its own that its file does not have; it stands before the file's text in a database."""
    return study.with_text(f'{key} = "{value}"\n{study.text}', {key: value})
