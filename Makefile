# Two commands:  make run   (feel a dome)     make test   (everything that CI runs)
# They need Python 3.11 or newer, make and the package registries; all else is fetched into .venv.

# Installers leave byte code to Python; where Python may not write it either, every start of a process compiles
# all of its packages again: 11 s instead of 1.
unexport PYTHONDONTWRITEBYTECODE

VENV := .venv
BIN := $(VENV)/bin

# What the installed package is built from: a change in any of these means installing again.
CONSOLE := $(shell find web -name node_modules -prune -o -type f -print 2>/dev/null)
BUILT_FROM := pyproject.toml $(wildcard hatch_build.py) $(CONSOLE)

.PHONY: help run test nightly bench docs notebooks dist firmware screenshots format packages clean
.DELETE_ON_ERROR:
.DEFAULT_GOAL := help

help:
	@echo 'make run          set up and start the simulated Omni; options in ARGS, such as ARGS="--world wall"'
	@echo 'make test         set up and run every check: style, types, imports, tests, documentation'
	@echo 'make nightly      the same, with the long reproductions, every safety promise and half an hour of soak'
	@echo 'make bench        all benchmarks, against peers and limits; ARGS="--store docs/benchmarks.json" stores them'
	@echo 'make docs         the documentation, into docs/_build/html'
	@echo 'make notebooks    the examples as Jupyter notebooks, into notebooks/'
	@echo 'make dist         wheel and source archive, into dist/'
	@echo 'make firmware     cross-compile the firmware and its emulator'
	@echo 'make screenshots  retake the screenshots of the console'
	@echo 'make format       format the Python files with ruff'
	@echo 'make clean        remove all generated files'

run: $(VENV)/.run
	@exec $(BIN)/haptorb run $(ARGS)

# Style, types, import contracts and documentation are tests too (tests/checks). Kernels and tests are compiled first.
# Then what runs beside a clock (the `realtime` marker) comes in threes, and what needs a browser as well, in twos; beside
# both, in what time they leave, a process for each processor and one more run all that only computes. One summary for all.
test: $(VENV)/.test packages
	@$(BIN)/python scripts/run_tests.py --markers "not slow" --durations=10 $(ARGS)

nightly: $(VENV)/.test
	@sh scripts/debian-packages nightly
	@HAPTORB_LONG_TESTS=1 $(BIN)/python scripts/run_tests.py $(ARGS)
	@$(BIN)/python scripts/prove_promises.py --intact
	@$(BIN)/python tests/fuzz/hostile_files.py --mutants 0 --commands 10000
	@$(BIN)/python benchmarks/safety/stiff_walls.py --long
	@$(BIN)/python benchmarks/safety/study_kill.py --kills 200
	@$(BIN)/python benchmarks/safety/memory_limit.py
	@$(BIN)/python benchmarks/study/study_merge.py
	@$(BIN)/python benchmarks/safety/soak.py

bench: $(VENV)/.test
	@$(BIN)/haptorb bench $(ARGS)

docs: $(VENV)/.test
	@$(BIN)/python -m sphinx -W --keep-going -b html docs docs/_build/html $(ARGS)
	@echo "open docs/_build/html/index.html"

notebooks: $(VENV)/.test
	@$(BIN)/python scripts/write_notebooks.py $(ARGS)

dist: $(VENV)/.test
	@rm -rf dist
	@$(BIN)/python -m build --wheel --sdist $(ARGS)

firmware: packages
	@$(MAKE) --no-print-directory -C firmware

screenshots: $(VENV)/.test packages
	@$(BIN)/python scripts/screenshots.py $(ARGS)

format: $(VENV)/.test
	@$(BIN)/ruff check --fix --quiet .
	@$(BIN)/ruff format --quiet .

packages:
	@sh scripts/debian-packages

$(BIN)/python:
	@sh scripts/virtual-environment $(VENV)

$(VENV)/.run: $(BUILT_FROM) | $(BIN)/python
	@echo "Installing haptorb into $(VENV) (the first time it takes longest) ..."
	@sh scripts/install-package $(VENV) "[study,design]"
	@touch $@

$(VENV)/.test: $(BUILT_FROM) | $(BIN)/python
	@echo "Installing haptorb and its tests' packages into $(VENV) (the first time: a few minutes) ..."
	@sh scripts/install-package $(VENV) "[test,bench,docs,hardware,study,design,trackers]"
	@touch $(VENV)/.run $@

clean:
	rm -rf $(VENV) build dist notebooks docs/_build docs/gallery docs/reference/generated test-results
	rm -rf .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache .packages-missing
	rm -rf web/node_modules src/haptorb/web/console_static src/haptorb_design/static src/haptorb_study/static src/haptorb/web/view_static
	if [ -d firmware ]; then $(MAKE) --no-print-directory -C firmware clean; fi
	if [ -d native ]; then $(MAKE) --no-print-directory -C native clean; fi
