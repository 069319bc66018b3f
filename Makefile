# `make demo` and `make test` need nothing but Python 3.11 or newer, git and make: each builds the
# environment that it needs in .venv, once, and runs.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Tests of one file share compiled programs, so files and not tests are spread over the processes,
# in the order of `tests/conftest.py`.
PYTEST_OPTIONS ?= --quiet --tb=short --numprocesses=auto --dist=loadfile --no-loadscope-reorder

RUN_READY := $(VENV)/.ready-to-run
TEST_READY := $(VENV)/.ready-to-test
DOCS_READY := $(VENV)/.ready-for-docs
BROWSER_READY := $(VENV)/.ready-for-browser
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt

.DEFAULT_GOAL := help
.PHONY: help demo metaworld check test test-browser test-faults test-long test-docs test-external test-metaworld peers fast unit lint style types imports bench docs clean

help: ## Show this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:[^#]*## /\t/' | expand -t 15

demo: $(RUN_READY) ## Train MAESN on the wheeled robot, adapt it to unseen tasks, draw figures and a page
	@echo "== MAESN learns to explore: 30 meta-iterations on dense reward"
	@if test -e runs/demo/config.json; then $(BIN)/maesn resume runs/demo; \
	  else $(BIN)/maesn train maesn --run runs/demo --iterations 30; fi
	@echo "== it adapts to 100 unseen goals on sparse reward: by policy gradient, then by latent search"
	@$(BIN)/maesn adapt runs/demo --episodes 60 --episodes-per-update 20
	@# a smaller prior than the usual one, in a third of the time
	@$(BIN)/maesn prior runs/demo --draws 100 --episodes 1 --adapted False --searches 0
	@$(BIN)/maesn adapt runs/demo --rule search --episodes 5
	@echo "== figures, tables and a page"
	@$(BIN)/maesn report runs/demo

# Meta-World needs a MuJoCo that the engine of our own robots is too new for.
METAWORLD := .venv-metaworld
metaworld: $(METAWORLD)/.ready ## Install Meta-World in an environment of its own, for `--family metaworld:reach`

$(METAWORLD)/.ready: constraints-metaworld.txt  # Gymnasium imports `packaging` and does not ask for it
	@echo "== installing Meta-World into $(METAWORLD)"
	@$(PYTHON) -m venv $(METAWORLD)
	@$(METAWORLD)/bin/python -m pip install --quiet --disable-pip-version-check \
	  --constraint constraints-metaworld.txt metaworld packaging
	@touch $@

check: $(TEST_READY) ## Check style, types, imports and the fast tests, in under a minute
	@$(MAKE) --no-print-directory --keep-going lint fast

test: $(TEST_READY) ## Run all checks, and all tests but the long ones
	@$(MAKE) --no-print-directory --keep-going unit lint

test-long: $(TEST_READY) ## Run the tests that take minutes: learning, benchmarks, shipped policies
	@$(BIN)/python -m pytest $(PYTEST_OPTIONS) -m "long or not long" tests/long
	@$(BIN)/python -m pytest $(PYTEST_OPTIONS) -m long tests

test-faults: $(TEST_READY) ## Attack the library for minutes: kills, damaged files, full disks, wrong calls
	@PYTHONPATH=tests $(BIN)/python -m faults $(FAULTS)

test-metaworld: $(METAWORLD)/.ready $(TEST_READY) ## Test the families of Meta-World, and its protocol
	@$(BIN)/python -m pytest --quiet --tb=short tests/simulators

# sb3-contrib needs PyTorch, and rliable an older pandas.
EXTERNAL := .venv-external
test-external: | $(EXTERNAL)/.ready ## Test against other libraries, in an environment of their own
	@$(EXTERNAL)/bin/python -m pytest --quiet --tb=short tests/external

$(EXTERNAL)/.ready: pyproject.toml constraints-external.txt
	@$(PYTHON) -m venv $(EXTERNAL)
	@$(EXTERNAL)/bin/python -m pip install --quiet --disable-pip-version-check \
	  --constraint constraints-external.txt --editable '.[gym]' beartype pytest \
	  rliable sb3-contrib torch wandb
	@touch $@

# BoTorch brings PyTorch: 6 GB.
PEERS := .venv-peers
peers: | $(PEERS)/.ready ## Compare latent search with what BoTorch offers, in an environment of their own
	@$(PEERS)/bin/python -m pytest --quiet --tb=short -W default tests/peers  # PyTorch warns at import
	@PYTHONPATH=examples $(PEERS)/bin/python benchmarks/search_peers.py --out build/peers

$(PEERS)/.ready: pyproject.toml constraints.txt constraints-peers.txt
	@$(PYTHON) -m venv $(PEERS)
	@$(PEERS)/bin/python -m pip install --quiet --disable-pip-version-check \
	  --constraint constraints.txt --constraint constraints-peers.txt \
	  --editable . beartype botorch cmaes pytest
	@touch $@

lint: $(TEST_READY) ## Check style, types and which package imports which
	@$(MAKE) --no-print-directory --keep-going style types imports

# What needs the fewest compiled programs, from each layer that has such tests.
FAST := $(addprefix tests/, context test_public_surface.py \
  $(addprefix numerics/test_, categorical.py conjugate_gradient.py gaussian.py minibatch_descent.py returns.py) \
  $(addprefix runtime/test_, explorer.py mathematics.py safeguards.py storage.py) \
  $(addprefix physics/test_, models.py native.py native_failures.py) \
  $(addprefix envs/test_, catalogue.py goals.py robots.py) \
  experience/test_episodes.py worlds/test_hosted.py inner/test_advantage.py learners/test_masking.py \
  $(addprefix runs/test_, checkpoint.py checkpoint_store.py compilation.py config.py serialization.py) \
  $(addprefix reporting/test_, adaptation_table.py published.py runs.py sources.py statistics.py tables.py))
fast: $(TEST_READY)
	@echo "== fast tests"
	@$(BIN)/python -m pytest $(PYTEST_OPTIONS) $(FAST)

unit: $(TEST_READY)
	@echo "== tests"
	@$(BIN)/python -m pytest $(PYTEST_OPTIONS)

style: $(TEST_READY)
	@echo "== style"
	@$(BIN)/ruff check --quiet .
	@$(BIN)/ruff format --quiet --check .

types: $(TEST_READY)
	@echo "== types"
	@$(BIN)/mypy --no-error-summary

imports: $(TEST_READY)
	@echo "== imports"
	@$(BIN)/lint-imports --no-logo

bench: $(RUN_READY) ## Time a whole meta-iteration against the bare simulator
	@$(BIN)/python benchmarks/meta_iteration.py --family wheeled

docs: $(DOCS_READY) ## Build the documentation's site in build/site
	@$(BIN)/python -m sphinx --quiet --fail-on-warning --keep-going -c docs . build/site
	@echo "open build/site/index.html"

test-browser: $(BROWSER_READY) ## Use the report page in Chromium, which must be installed
	@PICTURES=$(PICTURES) $(BIN)/python -m pytest --quiet --tb=short tests/browser

test-docs: $(TEST_READY) ## Run every example and every command of the documentation, in minutes
	@$(BIN)/python -m pytest --quiet -m "long or not long" tests/test_docs.py tests/long/test_documented_commands.py

clean: ## Remove the environment and every cache (runs/ stays)
	rm -rf $(VENV) $(EXTERNAL) $(METAWORLD) $(PEERS) build dist .import_linter_cache .mypy_cache .pytest_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "maesn needs Python 3.11 or newer; \`$(PYTHON)\` is $$($(PYTHON) --version 2>&1 | head -n 1)." \
	       "Name another one: make PYTHON=python3.11 $(MAKECMDGOALS)" >&2; exit 1; }
	@$(PYTHON) -m venv $(VENV) || { rm -rf $(VENV); \
	  echo "$(PYTHON) cannot make virtual environments; on Debian and Ubuntu, install python3-venv." >&2; exit 1; }

$(RUN_READY): pyproject.toml constraints.txt | $(BIN)/python
	@echo "== installing maesn into $(VENV)"
	@$(INSTALL) --editable .
	@touch $@

$(DOCS_READY): pyproject.toml constraints.txt | $(BIN)/python
	@echo "== installing maesn and Sphinx into $(VENV)"
	@$(INSTALL) --editable '.[docs]'
	@touch $(RUN_READY) $@

$(BROWSER_READY): $(TEST_READY)
	@$(INSTALL) playwright
	@touch $@

$(TEST_READY): pyproject.toml constraints.txt | $(BIN)/python
	@echo "== installing maesn and its development tools into $(VENV)"
	@$(INSTALL) --editable '.[dev]'
	@touch $(RUN_READY) $@
