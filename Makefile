# Everything runs in .venv, which is made once and only again when a requirement changes.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready

.DEFAULT_GOAL := help
.PHONY: help demo kernels test slow lint format types bench verify-all paper paper-quick mutations mutants fuzz pictures browser wheel clean

help:  ## list the targets
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:[^#]*## /: /'

$(READY): pyproject.toml requirements.txt requirements-dev.txt
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 14) and "takeapart needs Python 3.11 to 3.13; try: make PYTHON=python3.11")'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements-dev.txt
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	@touch $(READY)

demo: $(READY)  ## plan the disassembly of a shipped assembly; writes out/demo
	$(BIN)/takeapart demo --out out/demo

kernels: $(READY)  ## compile the geometry kernels, unless that was done
	$(BIN)/python -m takeapart.cli.compile

test: kernels  ## the quick tests
	$(BIN)/python -m pytest -n 2 --dist worksteal -m 'not slow'

slow: kernels browser  ## the slow tests
	$(BIN)/python -m pytest -n 2 --dist worksteal -m slow

lint: $(READY)  ## style and formatting
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

format: $(READY)  ## put the sources into the project's format
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

types: $(READY)  ## type check of sources and tests
	$(BIN)/mypy

bench: $(READY)  ## the figures of docs/benchmarks.md
	$(BIN)/python benchmarks/speed.py --write docs/benchmarks.md

verify-all: $(READY)  ## plan and verify every shipped assembly by every search; tables of docs/verification.md
	$(BIN)/python -m takeapart.experiments.verify_all --document docs/verification.md

paper: $(READY)  ## the paper's experiments in full, two hours; docs/results.md and results/paper
	$(BIN)/takeapart reproduce paper --out out/paper --document docs/results.md $(PAPER_OPTIONS)
	mkdir -p results/paper
	cp out/paper/*.csv out/paper/*.png results/paper

paper-quick: $(READY)  ## the same in small, within minutes; writes out/paper-quick
	$(BIN)/takeapart reproduce paper --quick --out out/paper-quick

mutations: $(READY)  ## corrupt plans and see them refused; table of docs/reliability.md
	$(BIN)/python tests/mutation_table.py --document docs/reliability.md

mutants: kernels  ## small wrong changes of the sources that were not tried yet, and whether the tests notice; table of docs/reliability.md
	$(BIN)/python tests/code_mutants.py --document docs/reliability.md

fuzz: $(READY)  ## 100,000 broken files for the readers, and more where atheris is installed; table of docs/reliability.md
	$(BIN)/python tests/fuzz_readers.py --inputs 100000 --document docs/reliability.md
	$(BIN)/python tests/fuzz_atheris.py

pictures: $(READY)  ## the pictures of the README
	$(BIN)/python -m takeapart.experiments.pictures --folder docs/pictures

browser:  ## install Chromium for the tests of pages, where it is missing and this user may; they are skipped without
	@command -v chromium chromium-browser google-chrome >/dev/null 2>&1 \
	|| { command -v apt-get >/dev/null && [ "$$(id -u)" = 0 ] && apt-get update -qq && apt-get install -y -qq chromium; } \
	|| echo "no Chromium: the tests of pages will be skipped (Debian: apt install chromium)"

wheel: $(READY)  ## dist/*.whl
	$(BIN)/python -m build --no-isolation --outdir dist .

clean:  ## remove what the other targets made
	rm -rf $(VENV) dist build out .mypy_cache .ruff_cache .pytest_cache .hypothesis
	find src tests -name __pycache__ -type d -prune -exec rm -rf {} +
