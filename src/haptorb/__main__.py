"""`python -m haptorb` is the command `haptorb`.

Python has put the current folder first on the import path by then; only `python -P -m haptorb` imports nothing from it.
"""

from __future__ import annotations

import sys

if not sys.flags.safe_path:
    del sys.path[0]

if __name__ == "__main__":
    try:
        from haptorb.cli import main

        code = main()
    except KeyboardInterrupt:
        code = 130
    sys.exit(code)
