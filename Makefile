# Two commands for everybody: `make demo` and `make test`. Both set up what they need.

PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
READY  := $(VENV)/.ready

.PHONY: help demo test check bench clean

help:
	@echo "make demo   set up, then run environment, agent and experiment as three processes"
	@echo "make test   set up, then run every check (ruff, mypy, pytest)"
	@echo "make check  ruff and mypy alone"
	@echo "make bench  measure, and write docs/performance.md"

$(READY): pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $(READY)

demo: $(READY)
	$(BIN)/glue-experiment --env mines --agent sarsa --episodes 2000 --seed 1

check: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

test: check
	$(BIN)/python -m pytest

bench: $(READY)
	$(BIN)/python -m benchmarks

clean:
	rm -rf $(VENV) build *.egg-info
