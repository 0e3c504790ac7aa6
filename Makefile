# Everything runs in .venv, which the first target that needs it creates and fills from the
# lock files; later calls install nothing until a lock or pyproject.toml changes.
#
#   PYTHON=/path/to/python3.12   the interpreter for .venv (default: first that fits)
#   ARGS='...'                   more arguments for test, test-all, bench, gpu and repro

STAMP := .venv/installed
DOCS_STAMP := .venv/installed-docs
VENV := .venv/bin/python
PIP := $(VENV) -m pip --disable-pip-version-check
# Python compiles a module when it is first imported; compiling all of them takes half a minute.
INSTALL := $(PIP) install --no-compile
# Two processes with one thread each; tests of a file share fixtures and run in the same one. If one
# crashes, the run ends: otherwise, pytest-xdist would start another one and wait for ever.
PYTEST := OMP_NUM_THREADS=1 $(VENV) -m pytest -n 2 --dist loadfile --max-worker-restart 0

# DVC starts the stages with the first `python` in PATH; with this, it is that of .venv.
export PATH := $(CURDIR)/.venv/bin:$(PATH)

.DEFAULT_GOAL := help
.PHONY: help repro test test-all lint docs bench gpu doctor venv lock clean

help: ## show this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "%-10s%s\n", $$1, $$2 }' Makefile

repro: $(STAMP) ## environment, then every stage of the pipeline that is out of date
	@.venv/bin/dvc repro $(ARGS)
	@echo
	@echo "Results: results/report.html (all in one page), results/tables, results/figures,"
	@echo "results/<scene>/renders (images)."
	@echo "On the command line: dvc metrics show; dvc plots show   (after: . .venv/bin/activate)"

test: $(STAMP) ## the tests, without those marked slow or long
	@$(PYTEST) -m "not slow and not long" $(ARGS)

test-all: $(STAMP) ## all tests
	@$(PYTEST) $(ARGS)

lint: $(STAMP) ## ruff (rules and format) and mypy: what pre-commit runs too
	$(VENV) -m ruff check .
	$(VENV) -m ruff format --check .
	$(VENV) -m mypy

docs: $(DOCS_STAMP) ## the pages of docs/ and the API as HTML: build/docs/index.html
	@rm -rf docs/api
	@$(VENV) -m sphinx -q -W --keep-going docs build/docs

bench: $(STAMP) ## the speed figures, as ratios measured side by side in one process
	@$(VENV) -m benchmarks $(ARGS)

# With VENV=python3, nothing is installed: for an offline machine that has the packages.
gpu: $(if $(filter file,$(origin VENV)),$(STAMP)) ## tests, speed and one scene on a GPU, 8 minutes
	@$(VENV) -m benchmarks.gpu $(ARGS)

doctor: $(STAMP) ## what works on this machine, what is missing, how to repair it
	@.venv/bin/gpf doctor

venv: $(STAMP) ## only the environment

$(STAMP): requirements.lock requirements-nodeps.lock pyproject.toml
	@$(PIP) --version >/dev/null 2>&1 || sh tools/make_venv.sh
	$(INSTALL) -r requirements.lock
	@$(INSTALL) --no-deps --no-build-isolation --use-pep517 -r requirements-nodeps.lock \
	  || echo "Warning: the packages of requirements-nodeps.lock could not be installed; LPIPS," \
	     "FLIP and 3D Gaussian splatting will be missing in the tables. \`make doctor\` names the" \
	     "commands that add them." >&2
	$(INSTALL) --no-deps --no-build-isolation -e .
	@touch $(STAMP)

$(DOCS_STAMP): requirements-docs.lock $(STAMP)
	$(INSTALL) -c requirements.lock -r requirements-docs.lock
	@touch $(DOCS_STAMP)

lock: ## resolve requirements.in again into requirements.lock (CONTRIBUTING.md)
	@sh tools/make_lock.sh

clean: ## remove .venv, caches and build leftovers; results and DVC's cache stay
	rm -rf .venv build docs/api *.egg-info .pytest_cache .mypy_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
