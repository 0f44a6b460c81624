# Two commands for everybody: `make demo` and `make test`. Both set up what they need.

PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
DEMO   := runs/demo
READY  := $(VENV)/.ready
FOUND  := $(VENV)/.found

# Twice as many as two cores, as they often wait; each begins with its share of the tests, and takes over from others.
PARALLEL := --numprocesses=4 --dist=worksteal

# The tests start hundreds of processes: each finds its modules compiled, whatever the shell says.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help demo test pytest proof check compile games agents coverage picture screenshots vectors bench clean

help:
	@echo "make demo   set up, then let an agent learn Infinite Mario, as three processes"
	@echo "make test   set up, then run every check: ruff and mypy, and beside them pytest"
	@echo "make proof  run the tests that prove more the longer they run, for minutes instead of seconds"
	@echo "make check  ruff and mypy alone"
	@echo "make coverage  which lines and branches the tests reach, in every process that they start"
	@echo "make picture  draw the folders and who imports whom: docs/images/architecture.svg"
	@echo "make screenshots  take the pictures of glue-view: docs/images/view-*.png; needs chromium, its driver and selenium"
	@echo "make vectors  write glue/testing/vectors.json from the examples of docs/protocol.md"
	@echo "make bench  measure, and write docs/performance.md"

$(READY): pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile --editable '.[dev]'
	@touch $(READY)

demo: $(READY)
	@rm -rf $(DEMO)
	$(BIN)/glue-experiment --env mario --agent hierarchical --episodes 300 --seed 1 --out $(DEMO)
	$(BIN)/glue-plot $(DEMO)
	$(BIN)/glue-plot $(DEMO) --out $(DEMO)/curve.png
	@echo 'Watch the agent play, after 300 episodes of learning:'
	@echo '    $(BIN)/glue-watch --env mario --agent hierarchical --after 300'

check: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# Once; else each process of the tests would compile the simulator, the agents and the modules that the tests import.
compile: games agents $(FOUND)

games agents: $(READY)
	$(BIN)/python -m tests.compile $@

$(FOUND): $(READY)
	$(BIN)/python -m pytest --collect-only --quiet > /dev/null
	@touch $(FOUND)

# What takes longest begins first, and the checks where a core is free.
test: $(READY)
	$(MAKE) --jobs=2 pytest check

pytest: compile
	$(BIN)/python -m pytest $(PARALLEL)

proof: compile
	GLUE_PROOF=full $(BIN)/python -m pytest -m proof $(PARALLEL)

# A few tests fail here, as coverage imports modules and writes files of its own: the report follows all the same.
coverage: compile
	$(BIN)/coverage erase
	-$(BIN)/coverage run -m pytest $(PARALLEL)
	$(BIN)/coverage combine --quiet
	$(BIN)/coverage report

picture: $(READY)
	$(BIN)/python -m tests.house.picture

screenshots: $(READY)
	$(BIN)/python -m tests.experiment_runner.view.screenshots

vectors: $(READY)
	$(BIN)/python -m tests.glue.testing.vectors

bench: $(READY)
	$(BIN)/python -m benchmarks

clean:
	rm -rf $(VENV) build *.egg-info
