"""The one way in which every command prints: prose, facts, tables and JSON, whatever the terminal can show.

Text is never read as markup. What is printed fits the width of the terminal, and is spelled in ASCII where the output
cannot carry more. Colour is for terminals only, and not where NO_COLOR is set.
"""

from __future__ import annotations

from haptorb.apps.terminal.console import make_console, print_file, print_json, print_text, say, tell
from haptorb.apps.terminal.facts import print_facts
from haptorb.apps.terminal.progress_bar import make_progress, show_status
from haptorb.apps.terminal.text_table import Column, TextTable, print_table
from haptorb.apps.terminal.wait_message import announce_wait

__all__ = [
    "Column",
    "TextTable",
    "announce_wait",
    "make_console",
    "make_progress",
    "print_facts",
    "print_file",
    "print_json",
    "print_table",
    "print_text",
    "say",
    "show_status",
    "tell",
]
