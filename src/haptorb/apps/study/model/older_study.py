"""A study file as older versions of haptorb understood it: a study continues as it began."""

from __future__ import annotations

from haptorb.apps.study.model.study_file import Study

__all__ = ["list_older"]


def list_older(study: Study) -> list[Study]:
    """As older versions ran the same file, newest first: with their order, then with 1 + 8 + 8 + 8 as published too.

    Empty where the file itself says what it means.
    """
    found, older = [], study
    # Both keys stand before the file's own text; the digest of a world's file may stand before them.
    for key in ("order_version", "published_layout"):
        lines, added = older.text.splitlines(keepends=True), f'{key} = "{getattr(older, key)}"\n'
        if not getattr(older, key) or added not in lines[:3]:
            continue
        lines.remove(added)
        update: dict[str, object] = {key: ""}
        if key == "order_version" and "order" not in study.trials.model_fields_set:
            update["trials"] = study.trials.model_copy(update={"order": "random"})
        older = older.with_text("".join(lines), update)
        found.append(older)
    return found
