# Two commands for everyone: `make demo` and `make test`. Both set up everything they need.

PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
DEMO   := runs/demo
READY  := $(VENV)/.ready

# Each process takes one module at a time, in the order of tests/conftest.py. More than three cost memory and
# imports, and gain nothing on two cores.
PARALLEL := --numprocesses=3 --dist=loadfile --no-loadscope-reorder

# The tests start hundreds of processes: each must find its modules compiled, whatever the shell's setting.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help demo test pytest proof check compile games agents coverage screenshots bench docs release clean

help:
	@echo "make demo   set up, then let an agent learn Infinite Mario, as three processes"
	@echo "make test   set up, then run every check: ruff and mypy, and beside them pytest"
	@echo "make proof  run the tests that prove more the longer they run, for minutes instead of seconds"
	@echo "make check  ruff and mypy, also on the programs of README and the pages"
	@echo "make coverage  which lines and branches the tests reach, in every process that they start"
	@echo "make screenshots  take the pictures of glue-view: docs/images/view-*.png; needs chromium, its driver and selenium"
	@echo "make docs   build the site of documents: build/site/index.html"
	@echo "make release  check version, changelog and tag, and build and prove the distributions: build/dist"
	@echo "make bench  measure, and write docs/performance.md"

$(READY): pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile --editable '.[dev]'
	@touch $(READY)

demo: $(READY)
	@rm -rf $(DEMO)
	$(BIN)/glue-experiment --env mario --agent hierarchical --episodes 100 --trials 3 --seed 1 --out $(DEMO)
	@$(BIN)/glue-plot $(DEMO)
	@echo 'The mean of three trials rises. The same as a picture, and the agent at play after 100 episodes:'
	@echo '    $(BIN)/glue-plot $(DEMO) --out curve.png'
	@echo '    $(BIN)/glue-watch --env mario --agent hierarchical --after 100'
	@echo 'A planner, which learns nothing but knows the rules: on ten levels that it has not seen, and at play with its plan:'
	@echo '    $(BIN)/glue-generalise --set test-1000:10 --agent planner --seed 1'
	@echo '    $(BIN)/glue-watch --env mario --agent planner --plan'

check: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/python -m tests.house.users_code build/users
	MYPYPATH=build/users:docs/examples/python $(BIN)/mypy build/users docs/examples/python

# Once; otherwise each test process would compile the simulator and the agents.
compile: games agents

games agents: $(READY)
	$(BIN)/python -m tests.compile $@

# The slowest part begins first; the checks run once a core is free.
test: $(READY)
	@began=$$(date +%s); $(MAKE) --jobs=2 pytest check && \
	echo "make test: passed in $$(($$(date +%s) - began)) s; stages left to .ci/run: $$(.ci/run --list)"

pytest: compile
	$(BIN)/python -m pytest $(PARALLEL)

# The full sizes take minutes each, several times as long on a slow machine.
proof: compile
	GLUE_PROOF=full $(BIN)/python -m pytest --stage=all -m proof --timeout=1200 $(PARALLEL)

# A few tests fail here, as coverage imports modules and writes files of its own; the report follows anyway.
coverage: compile
	$(BIN)/coverage erase
	-$(BIN)/coverage run -m pytest $(PARALLEL)
	$(BIN)/coverage combine --quiet
	$(BIN)/coverage report

screenshots: $(READY)
	$(BIN)/python -m tests.experiment_runner.view.browser.screenshots

docs: $(READY)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[docs]'
	$(BIN)/sphinx-build --fail-on-warning --keep-going --quiet docs build/site
	@echo 'build/site/index.html'

# A release without the upload: version, changelog and tag agree, and the wheel is tested outside the checkout.
release: $(READY)
	$(BIN)/python -m tests.package.release
	$(BIN)/python -m nox --non-interactive --session package
	@echo 'proved, in build/dist: push the tag, and publish it from the release page (.github/workflows/publish.yml)'

bench: $(READY)
	$(BIN)/python -m benchmarks

clean:
	rm -rf $(VENV) build *.egg-info
