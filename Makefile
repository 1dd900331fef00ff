# Everything from a clone with Python >= 3.11, gcc and make: `make study`, `make test`. All installs go to .venv.

PYTHON ?= python3
VENV   ?= .venv
CORES  ?= $(shell nproc 2>/dev/null || echo 1)
STUDY  ?= configs/bnes_study.yaml
OUT    ?= results/$(basename $(notdir $(STUDY)))
LIMIT  ?= 64

export PATH := $(abspath $(VENV))/bin:$(PATH)
SHELL := /bin/bash

.PHONY: study study-full test test-alone test-cluster lint docs papers clean help
.DEFAULT_GOAL := help

help:
	@echo "make study       the study's first $(LIMIT) designs over all cores: front, figures, trust ($(OUT))"
	@echo "make study-full  all designs of the study; resumes what is there"
	@echo "make test        the tests      make lint   ruff and mypy      make clean   removes what make made"
	@echo "make docs        the documentation site (docs/_build/html)      make papers   docs/papers.md, the claims report"

# ------------------------------------------------------------------------------------------ installing

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "Python 3.11 or later is needed; $(PYTHON) is $$($(PYTHON) --version 2>&1). Try: make PYTHON=python3.11"; exit 2; }
	@echo "making $(VENV)"
	@$(PYTHON) -m venv $(VENV)

# The launcher file says how runs are started: mpi when two ranks find each other, serial otherwise.
$(VENV)/launcher: pyproject.toml | $(VENV)/bin/python
	@echo "installing (log: $(VENV)/install.log)"
	@if pip install -q -e '.[mpi]' > $(VENV)/install.log 2>&1; then :; \
	elif pip install -q -e . >> $(VENV)/install.log 2>&1; then echo "the mpi extra cannot be installed here"; \
	else tail -5 $(VENV)/install.log; exit 2; fi
	@if [ "$$(timeout 120 mpirun -n 2 python -m mpi4py -c \
	  'from mpi4py.MPI import COMM_WORLD as all; all.rank or print(all.size)' 2>> $(VENV)/install.log)" = 2 ]; \
	then echo mpi > $@; else echo serial > $@; fi

$(VENV)/dev-installed: $(VENV)/launcher
	@echo "installing the development tools (log: $(VENV)/install.log)"
	@pip install -q -e '.[dev]' >> $(VENV)/install.log 2>&1 || { tail -5 $(VENV)/install.log; exit 2; }
	@touch $@

# ------------------------------------------------------------------------------------------ the study

# Exit code 1 is a finished run with failed points: the front of the others is still wanted.
define run
@if [ "$$(cat $(VENV)/launcher)" = mpi ]; then start="mpirun -n $(CORES) python -m mpi4py"; \
else start=python; echo "MPI cannot be had here (see $(VENV)/install.log): running on one core"; fi; \
export OMP_NUM_THREADS=1; set -x; $$start -m sweep run $(STUDY) --out $(OUT) $(1) || [ $$? -eq 1 ]
@python -m sweep pareto $(OUT)
@python -m sweep plot $(OUT) all
@python -m sweep status $(OUT)
endef

study: $(VENV)/launcher
	$(call run,--limit $(LIMIT))

study-full: $(VENV)/launcher
	$(call run,)

# ------------------------------------------------------------------------------------------ documents

docs: $(VENV)/dev-installed
	python -m sphinx -W --keep-going -q -b html docs docs/_build/html
	@echo "docs/_build/html/index.html"

papers: $(VENV)/dev-installed
	python docs/papers.py

# ------------------------------------------------------------------------------------------ checks

# Tests of MPI and SLURM mostly wait for other processes: they run beside the others.
test: $(VENV)/dev-installed
	@$(MAKE) --no-print-directory --keep-going -j2 test-alone test-cluster

test-alone: $(VENV)/dev-installed
	python -m pytest -q --ignore=tests/mpi --ignore=tests/slurm

test-cluster: $(VENV)/dev-installed
	python -m pytest -q -p no:cacheprovider tests/mpi tests/slurm

lint: $(VENV)/dev-installed
	ruff check .
	mypy

clean:
	rm -rf $(VENV) results build dist docs/_build docs/cli.md *.egg-info .pytest_cache .ruff_cache .mypy_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
