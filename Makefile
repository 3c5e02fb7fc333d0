# Verbs, each of which does all its own set-up in .venv from the lock file:
#   make e2e SCENARIO=sso_antisun   the whole chain, ends with runs/<scenario>/report.html
#   make test        fast tests         make test-full   all tests, three quarters of an hour on two cores
#   make test-slow   the slow ones alone: whole scenarios, commands of the documents, notebooks
#   make lint        style, types, import rules, schema, licences
#   make bench       the benchmark report         make fuzz   a million inputs against every parser
#   make bench-check the quick benchmark against the committed baseline; fails where a figure became worse
#   make docs        the documentation site, build/site/index.html; opens from the folder, without a server or network
#   make clean       remove the environment and everything that can be made again

PYTHON ?= $(shell for p in python3.11 python3.12 python3.13 python3; do $$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$p && break; done)
SCENARIO ?= sso_antisun
VENV := .venv
BIN := $(VENV)/bin
PACKAGES := $(VENV)/.packages
KERNELS := $(VENV)/.kernels
TOOLS := $(VENV)/.tools
FUZZ_RUNS ?= 1000000
# A process a core, four at most: each needs up to 2 GB. An idle one takes tests from a busy one.
ON_EVERY_CORE := -n auto --maxprocesses 4 --dist loadfile --no-loadscope-reorder

# One thread per process: worker processes parallelise, and sums keep their order.
export OMP_NUM_THREADS := 1
export OPENBLAS_NUM_THREADS := 1
export NUMBA_NUM_THREADS := 1
export PYTHONHASHSEED ?= 0
# Where it is set, each process compiles three thousand modules anew: 3 to 4 CPU-s of a run of `smoke`.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: kernels e2e test test-full test-slow lint bench bench-check fuzz docs clean

kernels: $(KERNELS)

e2e: $(KERNELS)
	$(BIN)/sboc run $(SCENARIO) --force

test: $(TOOLS) $(KERNELS)
	$(BIN)/python -m pytest -q -ra $(ON_EVERY_CORE)

test-full: $(TOOLS) $(KERNELS)
	$(BIN)/python -m pytest -q -ra $(ON_EVERY_CORE) -m "slow or not slow"

test-slow: $(TOOLS) $(KERNELS)
	$(BIN)/python -m pytest -q -ra $(ON_EVERY_CORE) -m slow

lint: $(TOOLS)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-logo
	$(BIN)/python -m sboc_e2e.licences --check LICENSES.md

bench: $(TOOLS) $(KERNELS)
	$(BIN)/sboc bench

bench-check: $(TOOLS) $(KERNELS)
	$(BIN)/sboc bench --quick --check

fuzz: $(TOOLS) $(KERNELS)
	for target in packets codecs fits scenario; do $(BIN)/python -m tests.fuzz $$target -runs=$(FUZZ_RUNS) -rss_limit_mb=2048 || exit 1; done

docs: $(VENV)-docs/.ready
	$(VENV)-docs/bin/python docs/site/build.py
	@echo build/site/index.html

clean:
	rm -rf $(VENV) $(VENV)-docs build runs bench/out dist .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache .benchmarks
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# The environment follows the lock files and the project's metadata. Packages are not compiled to bytecode (a third of pip's time):
# Python does so for the modules that it imports. A run needs half of the packages; those of tests and of other developers' work are
# installed where a verb needs them. `make -j2` compiles the numerical kernels, once, while it installs these.
$(PACKAGES): requirements-run.lock pyproject.toml
	@test -n "$(PYTHON)" || { echo "Python 3.11 or newer is needed: make PYTHON=/path/to/python3"; exit 2; }
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@echo "Installing packages into $(VENV): one to three minutes without a word."
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile --require-hashes -r requirements-run.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps -e .
	touch $@

$(KERNELS): $(PACKAGES)
	$(BIN)/python -m sboc_e2e.warm_up
	touch $@

$(TOOLS): $(PACKAGES) requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile --require-hashes -r requirements.lock
	touch $@

# The site's tools read the sources and do not import them: they need nothing of the environment above.
$(VENV)-docs/.ready: docs/site/requirements.lock
	@test -n "$(PYTHON)" || { echo "Python 3.11 or newer is needed: make PYTHON=/path/to/python3"; exit 2; }
	test -x $(VENV)-docs/bin/python || $(PYTHON) -m venv $(VENV)-docs
	$(VENV)-docs/bin/python -m pip install --quiet --disable-pip-version-check --require-hashes -r docs/site/requirements.lock
	touch $@
