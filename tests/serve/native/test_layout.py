"""Layout of the shared file: Python's table against the compiler's."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from haptorb.serve.native import COMMAND, FACTS, FILE_BYTES, SLOT_SIZE, SLOTS, STATE, VERSION

ROOT = Path(__file__).resolve().parents[3]


def test_both_sides_have_the_same_table(tmp_path: Path) -> None:
    if shutil.which("cc") is None:
        pytest.skip("cc is not installed (Debian: apt-get install gcc)")
    wanted = {
        f"{page} {name}": f"{at} {count if kind == 's' else 8 * count}"
        for page, table in (("facts", FACTS), ("state", STATE), ("command", COMMAND))
        for name, (at, count, kind) in table.items()
    }
    lines = "".join(
        f'printf("{one} %zu %zu\\n", offsetof(struct {page}, {name}), sizeof ((struct {page} *)0)->{name});\n'
        for one in wanted
        for page, name in [one.split()]
    )
    sizes = "".join(
        f'printf("{page} end %zu 0\\n", sizeof(struct {page}));\n' for page in ("facts", "state", "command")
    )
    source = tmp_path / "layout.c"
    source.write_text(
        '#include "layout.h"\n#include <stddef.h>\n#include <stdio.h>\nint main(void)\n{\n'
        'printf("%d %d %zu %zu\\n", LAYOUT_VERSION, LAYOUT_SIZE, sizeof(struct states), '
        "offsetof(struct states, slots));\n"
        f"{lines}{sizes}return 0;\n}}\n"
    )
    program = tmp_path / "layout"
    subprocess.run(["cc", "-Werror", f"-I{ROOT / 'native/link'}", "-o", program, source], check=True)
    said = subprocess.run([program], capture_output=True, text=True, check=True).stdout.splitlines()
    assert said[0] == f"{VERSION} {FILE_BYTES} 4096 {4096 - SLOTS * SLOT_SIZE}"
    found = {f"{page} {name}": rest for page, name, rest in (line.split(" ", 2) for line in said[1:])}
    for page, table in (("facts", FACTS), ("state", STATE), ("command", COMMAND)):
        at, count, kind = list(table.values())[-1]
        end = at + (count if kind == "s" else 8 * count)
        assert found.pop(f"{page} end") == f"{end} 0", "a member is missing in Python's table"
    assert found == wanted
