"""The help of commands, as it was written: no bracket is markup, nothing is cut, at any width."""

from __future__ import annotations

import inspect
import sys
from collections import Counter
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from haptorb.apps.terminal.console import find_width, wrap
from haptorb.apps.terminal.facts import format_facts
from haptorb.apps.terminal.spelling import fit_encoding
from haptorb.errors import quote

__all__ = ["CommandLine"]

_DEVICES = ("device", "devices", "names")  #: arguments that can be a device; `names` are those of `bench`
_WIDEST = 100  #: longer lines are hard to read


class CommandLine(typer.Typer):
    """Commands whose help and errors are text, never markup."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(
            cls=HelpGroup, no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False,
            rich_markup_mode=None, **settings,
        )  # fmt: skip

    def command(self, name: str | None = None, **settings: Any) -> Any:
        """As typer's."""
        return super().command(name, **{"cls": HelpCommand, **settings})


class HelpCommand(TyperCommand):
    """A command whose help is laid out here. Its device is an argument; `--device` works as before."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """As click's, with the value of `--device` moved to where a device stands; an option that takes one value and
        is given twice is an error: the first value would be lost."""
        if any(parameter.name in _DEVICES for parameter in self.params):
            args = _move_device(args)
        _check_repeated(self, ctx, args)
        words = list(args)
        try:
            return super().parse_args(ctx, args)
        except typer.BadParameter as mistake:
            mistake.message = _explain_number(mistake, words)
            raise

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write usage, text, arguments and options."""
        formatter.write(_compose_help(self, ctx))


class HelpGroup(TyperGroup):
    """A group of commands whose help is laid out here."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write usage, text, options and the commands with the first paragraph of each."""
        commands = []
        for name in self.list_commands(ctx):
            command = self.get_command(ctx, name)
            if command is not None and not command.hidden:
                commands.append((name, inspect.cleandoc(command.help or "").split("\n\n")[0].replace("\n", " ")))
        formatter.write(_compose_help(self, ctx, commands))


def _move_device(args: list[str]) -> list[str]:
    """`args` with what follows `--device`, or stands behind `--device=`, as the last argument.

    >>> _move_device(["--device", "pmsm", "--json"]), _move_device(["a.toml", "--device=pmsm"])
    (['--json', 'pmsm'], ['a.toml', 'pmsm'])
    """
    before = args[: args.index("--")] if "--" in args else args
    for place, word in enumerate(before):
        if word == "--device" and place + 1 < len(before):
            return [*args[:place], *args[place + 2 :], args[place + 1]]
        if word.startswith("--device="):
            return [*args[:place], *args[place + 1 :], word.removeprefix("--device=")]
    return args


def _check_repeated(command: Any, ctx: Any, args: list[str]) -> None:
    """Raise a usage error for an option of `command` that takes one value and has several in `args`."""
    for option, count in Counter(command.make_parser(ctx).parse_args(list(args))[2]).items():
        if count > 1 and option.param_type_name == "option" and not (option.multiple or option.is_flag):
            ctx.fail(f"{option.opts[0]} takes one value; it is given {count} times")


def _explain_number(mistake: Any, words: list[str]) -> str:
    """The message of `mistake`; where it is about a number, what was expected and what of `words` stood there."""
    if not mistake.message.startswith("Input should be a valid"):
        return str(mistake.message)
    expected = "a whole number" if "integer" in mistake.message else "a number"
    values = [
        word.removeprefix(f"{option}=") if word.startswith(f"{option}=") else following
        for option in mistake.param.opts
        for word, following in zip(words, [*words[1:], ""], strict=True)
        if word == option or word.startswith(f"{option}=")
    ]
    return f"must be {expected}" + (f"; got {quote(values[-1])}" if values else "")


def _compose_help(command: Any, ctx: Any, commands: list[tuple[str, str]] | None = None) -> str:
    width = min(find_width(), _WIDEST)
    usage = " ".join(["Usage:", ctx.command_path, *command.collect_usage_pieces(ctx)])
    text = inspect.cleandoc(command.help or "")
    paragraphs = [" ".join(paragraph.split("\n")) for paragraph in text.split("\n\n") if paragraph]
    lines = [wrap(usage, width, "    "), *(f"\n{wrap(paragraph, width)}" for paragraph in paragraphs)]
    records: dict[str, list[tuple[str, str]]] = {"Arguments": [], "Options": []}
    for parameter in command.get_params(ctx):
        record = parameter.get_help_record(ctx)
        if record is not None:
            records["Arguments" if parameter.param_type_name == "argument" else "Options"].append(record)
    records["Commands"] = commands or []
    for title, pairs in records.items():
        if pairs:
            lines += [f"\n{title}:", *format_facts(pairs, width, "  ")]
    return "\n".join(fit_encoding(line, sys.stdout.encoding or "utf-8") for line in lines) + "\n"
