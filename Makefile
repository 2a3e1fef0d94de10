# Everything one does with this project; `make` alone lists it.

PYTHON    ?= python3
VENV      ?= .venv
BENCH     ?= .venv-bench
PORT      ?= 8000
DESIGNS   ?= 1000
FIRST     ?= $(DESIGNS)
SENSITIVE ?= 200
SEED      ?= 1
LEVEL     ?= standard
CASES     ?= 1,2,3,4
MESHES    ?= 3
SEEDS     ?= 20
SLOPED    ?= 600
PATHS     ?= 100
WORKERS   ?= $(shell nproc 2>/dev/null || echo 2)

BIN       := $(VENV)/bin
PIP       := $(BIN)/python -m pip install --quiet --constraint constraints.txt
INSTALLED := $(VENV)/.installed
TESTABLE  := $(VENV)/.testable
REFERENCE := runs/reference

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help run test lint format docs verification figures refinement recovery mesh-error \
    reference corrected bench-fem foreign kill-test system pins clean

help: ## this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "make %-12s %s\n", $$1, $$2}' Makefile

run: $(INSTALLED) ## install what is missing, then serve on http://127.0.0.1:8000
	$(BIN)/pba serve --port $(PORT)

test: $(TESTABLE) system ## ruff, mypy and all tests in one pytest run
	$(BIN)/python -m pytest

lint: $(TESTABLE) ## ruff and mypy alone
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(TESTABLE) ## let ruff rewrite the sources in the project's format
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

docs: $(TESTABLE) ## measure again every number that the documents quote
	$(BIN)/python docs/measure.py

verification: $(TESTABLE) ## run every benchmark, break the solver on purpose, write it down
	$(BIN)/python -m docs.verify $(if $(ONLY),--only $(ONLY))

figures: $(TESTABLE) ## draw the pictures of the README again
	$(BIN)/python -m examples.readme_figures

refinement: $(INSTALLED) ## settle the published device on refined meshes (hours)
	OMP_NUM_THREADS=1 $(BIN)/python -m docs.refine one
	OMP_NUM_THREADS=1 $(BIN)/python -m docs.refine limits
	OMP_NUM_THREADS=1 $(BIN)/python -m docs.refine $(CASES) $(MESHES)

mesh-error: $(INSTALLED) ## calibrate the mesh error on PATHS random designs (many hours; resumes)
	OMP_NUM_THREADS=1 MKL_NUM_THREADS=1 $(BIN)/python -m docs.mesh_error $(PATHS) $(WORKERS)

recovery: $(TESTABLE) ## plant effects by the thousand, rank them, write it down (hours)
	OMP_NUM_THREADS=1 $(BIN)/python -m docs.recover $(SEEDS) $(WORKERS) "$(ONLY)"

# Built aside and copied when complete: an interrupted run, which goes on where it
# stopped, never leaves half a model in the package.  FIRST=200 solves the first part of
# the hypercube alone; EXTEND=surrogate/reference/dataset.h5 goes on from what is there.
reference: $(INSTALLED) ## generate the reference dataset and train its model
	mkdir -p $(REFERENCE)
	$(BIN)/pba generate --designs $(DESIGNS) --seed $(SEED) --level $(LEVEL) \
	    --first $(FIRST) --sensitivities $(SENSITIVE) --workers $(WORKERS) \
	    $(if $(EXTEND),--extend $(EXTEND)) --out $(REFERENCE)/dataset.h5 --resume
	$(BIN)/pba train $(REFERENCE)/dataset.h5 --out $(REFERENCE)/model
	$(BIN)/python -m surrogate.slopes $(REFERENCE)/dataset.h5 $(REFERENCE)/slopes.h5 \
	    $(SLOPED) $(WORKERS)
	mkdir -p surrogate/reference
	cp $(REFERENCE)/dataset.h5 $(REFERENCE)/slopes.h5 $(REFERENCE)/model/* \
	    surrogate/reference/

corrected: $(INSTALLED) ## learn surrogates with effects in them, write down how near they come (an hour)
	OMP_NUM_THREADS=1 $(BIN)/python -m docs.corrected $(or $(MINUTES),10) $(ONLY)

# FElupe in an environment of its own: pba does not need it.
bench-fem: $(INSTALLED) $(BENCH)/.installed ## time FElupe and CalculiX against our solver (an hour)
	@sh benchmarks/system.sh
	$(BIN)/python -m benchmarks.bench_fem --felupe-python $(BENCH)/bin/python

foreign: $(TESTABLE) $(BENCH)/.installed ## hide effects in FElupe's answers, rank them, write it down (an hour)
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.foreign --felupe-python $(BENCH)/bin/python \
	    $(if $(ONLY),--only $(ONLY))

kill-test: $(TESTABLE) ## kill -9 a generation twenty times, resume it, compare the files
	$(BIN)/python -m examples.kill_generate --kills 20

system: ## programs the tests drive, from the system's packages
	@sh tests/system.sh

pins: $(TESTABLE) ## write constraints.txt from what the environment holds
	grep '^#' constraints.txt > constraints.new
	$(BIN)/python -m pip list --format=freeze --exclude pba --exclude pip \
	    | sed 's/+.*//' >> constraints.new
	mv constraints.new constraints.txt

clean: ## remove the environments and every cache
	rm -rf $(VENV) $(BENCH) build *.egg-info .mypy_cache .pytest_cache .ruff_cache

# Stamps make the second call instant.  A new top-level package changes what an
# editable install has to find, hence the __init__ files.
$(INSTALLED): pyproject.toml constraints.txt $(wildcard */__init__.py) | $(BIN)/python
	@echo "installing into $(VENV) (a minute or a few, once)"
	@$(PIP) --editable .
	@touch $@

$(TESTABLE): $(INSTALLED)
	@$(PIP) --editable '.[test]'
	@touch $@

$(BENCH)/.installed: benchmarks/requirements.txt | $(BIN)/python
	@echo "installing FElupe into $(BENCH)"
	@$(BIN)/python -m venv $(BENCH)
	@$(BENCH)/bin/python -m pip install --quiet --requirement benchmarks/requirements.txt
	@touch $@

$(BIN)/python:
	@for python in $(PYTHON) python3.13 python3.12 python3.11; do \
	    if $$python -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	        2>/dev/null; then exec $$python -m venv $(VENV); fi; \
	done; \
	echo "Python 3.11 or newer is needed; name one: make PYTHON=/path/to/python3" >&2; \
	exit 1
