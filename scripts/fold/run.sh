#!/bin/sh
# run.sh ROOT [STAGE ...]: fold, sort imports, format; run in a clean working tree with its .venv
set -e
here=$(cd "$(dirname "$0")" && pwd); root=$1; shift
cd "$root"
[ $# -gt 0 ] || .venv/bin/python "$here/fold.py" . "$here/mapping.txt" page > /dev/null
.venv/bin/python "$here/fold.py" . "$here/mapping.txt" apply "$@"
[ $# -gt 0 ] || mv /tmp/where-modules-went.md docs/decisions/0050-where-modules-went.md
git add -A
.venv/bin/ruff check -q --select I,F401,F811,RUF022 --fix src tests benchmarks scripts docs examples || true
.venv/bin/ruff format -q .
.venv/bin/python "$here/unskip.py"
.venv/bin/ruff format -q .
.venv/bin/ruff check .
