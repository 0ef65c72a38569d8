# Two commands: `make demo` shows what outrider does, `make test` checks that it does it.

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
SHELL := /bin/bash

BIN := .venv/bin
CORE := .venv/.stamp-core
FULL := .venv/.stamp-full

# First interpreter of 3.11 to 3.14 that really starts: a name on the path may be an empty shim.
WANT := import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 15))
NAMES := python3.13 python3.12 python3.14 python3.11 python3
PYTHON ?= $(shell for p in $(NAMES); do $$p -c '$(WANT)' 2>/dev/null && echo $$p && break; done)

# The newest other one, of another minor version than .venv's. None wanted: make test PYTHON2ND=
OTHER = import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 15) or sys.version_info[:2] == ($(MINOR)))
MINOR = $(shell $(BIN)/python -c 'import sys; print(*sys.version_info[:2], sep=", ")' 2>/dev/null)
PLACES = $(NAMES) $(shell ls -d $(HOME)/.pyenv/versions/*/bin/python3 2>/dev/null | sort -rV)
PYTHON2ND = $(shell for p in $(PLACES); do $$p -c '$(OTHER)' 2>/dev/null && echo $$p && break; done)

# The locked versions, into the environment that is named; never another Python than the one in it.
SYNC = UV_PYTHON_DOWNLOADS=never UV_NO_PROGRESS=1 $(BIN)/uv sync --quiet --frozen --inexact

CHECKS = pytest pytest-second lint types docs

.PHONY: help demo test lint types docs pytest pytest-second bench accuracy soak lock clean

help:  ## this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*##/\t/' | expand -t 16

demo: $(CORE)  ## set up and show a scooter at a crossing
	$(BIN)/outrider demo --force

test: $(FULL)  ## set up and run all checks, two at a time
	@$(MAKE) --no-print-directory -j2 $(if $(filter output-sync,$(.FEATURES)),--output-sync=target) $(CHECKS)

lint: $(FULL)  ## layout and lint
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .

types: $(FULL)  ## static types, strict
	$(BIN)/mypy

docs: $(FULL)  ## build the pages into site/, the pictures of the live page anew; a warning is an error
	NO_COLOR=1 $(BIN)/zensical build --clean --strict
	@if [ -n "$${OUTRIDER_CHROMIUM:-$$(command -v chromium)}" ]; then $(BIN)/python docs/figures/page.py site/figures; \
	  else echo 'no Chromium: the pictures of the page are those that were kept'; fi

pytest: $(FULL)  ## the tests alone
	$(BIN)/python -m pytest -rs

pytest-second: $(FULL)  ## the tests of the code, without recordings, on a second Python, where there is one
	@if [ -z "$(PYTHON2ND)" ]; then echo 'no second Python of 3.11 to 3.14 found: skipped'; else \
	  set -e; p=$(PYTHON2ND); env=.venv-$$($$p -c 'import sys; print("%d.%d" % sys.version_info[:2])'); \
	  [ -x $$env/bin/python ] || $$p -m venv $$env; \
	  UV_PROJECT_ENVIRONMENT=$$env $(SYNC) --extra test --python $$env/bin/python; \
	  $$env/bin/python --version; OUTRIDER_DATA= $$env/bin/python -m pytest -m "not once"; fi

bench: $(FULL)  ## speed, beside peers; keeps JSON under benchmarks/results/
	@mkdir -p benchmarks/results
	$(BIN)/python -m pytest benchmarks -o addopts=-q -W default --benchmark-only --benchmark-columns=median,iqr,rounds \
	  --benchmark-sort=name --benchmark-timer=time.process_time --benchmark-json=benchmarks/results/latest.json

accuracy: $(FULL)  ## tune and judge all observers and peers on real tracks below OUTRIDER_DATA; 25 min
	$(BIN)/python -m benchmarks.accuracy

soak: $(FULL)  ## a day of live scans with all faults, at full speed; 30 to 60 min; SOAK='--scans 20000' for less
	$(BIN)/python -m benchmarks.soak $(SOAK)

lock: $(FULL)  ## resolve the versions of uv.lock anew
	$(BIN)/uv lock --upgrade --default-index https://pypi.org/simple

clean:  ## remove what was built, the environments too
	rm -rf .venv .venv-3.* site dist .mypy_cache .ruff_cache .pytest_cache .hypothesis .cache

$(BIN)/uv:
	@[ -n "$(PYTHON)" ] || { echo 'no Python of 3.11 to 3.14 found; install one, or: make PYTHON=/path/to/python'; exit 1; }
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check 'uv>=0.5'

$(CORE): pyproject.toml uv.lock | $(BIN)/uv
	$(SYNC) --python $(BIN)/python
	@touch $@

$(FULL): pyproject.toml uv.lock | $(BIN)/uv
	$(SYNC) --all-extras --python $(BIN)/python
	@touch $@ $(CORE)
