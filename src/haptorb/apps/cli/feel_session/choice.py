"""Which designs a session is about: those of a file, or worlds of the user's own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from haptorb.errors import InputError

if TYPE_CHECKING:
    from haptorb.apps.feel import Candidates

__all__ = ["DesignChoice"]


@dataclass(frozen=True)
class DesignChoice:
    """A design file, or `worlds` (FILE.py:NAME) with `settings` (NAME=VALUE) for all of them; one of both."""

    file: str = ""
    worlds: tuple[str, ...] = ()
    settings: tuple[str, ...] = ()

    @classmethod
    def of(cls, file: Path | None, worlds: Sequence[str], settings: Sequence[str]) -> DesignChoice:
        """From what a user gave. Raises InputError for neither, for both, and for worlds of the catalogue."""
        from haptorb.worlds.own.world_file import is_world_file

        if (file is None) == (not worlds):
            raise InputError("give a design file (haptorb feel designs.toml) or your own worlds (--world FILE.py:NAME)")
        if settings and not worlds:
            raise InputError("--set is for --world; in a design file, write the values into it")
        for world in worlds:
            if not is_world_file(world):
                raise InputError(
                    f"--world must be FILE.py:NAME here; got '{world}'. Describe snap-fits in a design file"
                )
        return cls(str(file or ""), tuple(worlds), tuple(settings))

    @property
    def folder(self) -> Path:
        """The default folder of ratings and traces: beside the file."""
        from haptorb.worlds.own.world_file import parse_world_file

        file = Path(self.file) if self.file else parse_world_file(self.worlds[0]).path
        return file.with_name(f"{file.stem}-session")

    def load(self) -> Candidates:
        """The designs. Raises InputError as `load_designs` and the world's file do."""
        from haptorb.apps.cli.world_option import parse_settings
        from haptorb.apps.feel import Candidates, load_designs
        from haptorb.apps.feel.candidates import own_candidate
        from haptorb.apps.own_code import start_world_file
        from haptorb.control.clutch.gains import Gains
        from haptorb.worlds.own.world_file import parse_world_file
        from haptorb.worlds.parameter import parameters

        if self.file:
            return load_designs(self.file)
        designs = []
        for text in self.worlds:
            file = parse_world_file(text)
            world = start_world_file(file)
            values = parse_settings(list(self.settings), parameters(type(world)))
            designs.append(own_candidate(file, world.name, dict(values)))
        names = [design.name for design in designs]
        if len(set(names)) < len(names):
            raise InputError(f"--world: two worlds have the same name ({', '.join(names)}); rename one of the classes")
        return Candidates(", ".join(names), "timoshenko", Gains(), tuple(designs))
