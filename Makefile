# make demo   calibrates the paper's UR3 from its real measurements, into demo/
# make test   runs the tests
# make verify   runs all tests, the slow studies too
# make lint   ruff and mypy
# make coverage   runs the tests and says which lines and branches none of them reaches
# make docs   builds the site of docs/, into site/
# make wheel   builds the wheel into dist/, installs it elsewhere, and uses it there as a user would
# make oldest   runs the tests with the oldest versions that pyproject.toml allows
# Each makes its own .venv; all they need is Python 3.10 or newer and make.

# The first Python that is new enough, if none is named.
PYTHON ?= $(or $(shell for p in python3 python3.13 python3.12 python3.11 python3.10; do \
  $$p -c 'import sys; sys.exit(sys.version_info < (3, 10))' 2>/dev/null && echo $$p && break; done),python3)
VENV := .venv
BIN := $(VENV)/bin
#: calib itself; and with it what tests, linters and the docs' site need.
CALIB := $(VENV)/.calib
TOOLS := $(VENV)/.tools
#: uv installs several times faster than pip; where it cannot (an index that only pip is told of), pip does. Like pip it
#: compiles what it installs: where Python may not write, each start would do that again.
PIP := $(BIN)/python -m pip install --disable-pip-version-check
INSTALL = { $(BIN)/uv pip install --compile-bytecode --python $(BIN)/python $(1) || $(PIP) $(1); }

.PHONY: demo test verify coverage lint docs wheel oldest clean

demo: $(CALIB)
	$(BIN)/calib demo --out demo --force

test: $(TOOLS)
	@# One thread a worker: the matrices are small, and workers that each start a thread a core stand in each other's way.
	@# Each worker has tests that follow each other, which share what a module or the session makes for them. Compiled
	@# tests are kept, whatever the shell says: that takes each worker a minute.
	OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest -n auto --dist worksteal

verify: $(TOOLS)
	HYPOTHESIS_SEED=random OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --dist worksteal -m "slow or not slow"

# Tests start programs in folders of their own, and COVERAGE_FILE says where all of them count.
coverage: export COVERAGE_FILE := $(CURDIR)/.coverage
coverage: $(TOOLS)
	$(BIN)/coverage erase
	OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 $(BIN)/coverage run -m pytest -n auto -m "slow or not slow"
	$(BIN)/coverage combine --quiet
	$(BIN)/coverage report --skip-covered --show-missing

lint: $(TOOLS)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

docs: $(TOOLS)
	@# A name that leads nowhere, and a page that loads anything from another place, are errors.
	$(BIN)/sphinx-build --quiet -W --keep-going --nitpicky docs site
	@! grep -rnoE '<(script|link|img|iframe)[^>]*(src|href)="(https?:)?//[^"]*"' site --include='*.html'

wheel: $(CALIB)
	rm -rf dist
	$(PIP) --quiet build
	$(BIN)/python -m build --outdir dist .
	$(BIN)/python scripts/try_wheel.py dist/*.whl

# What an old package says about another one is not an error.
oldest: $(CALIB)
	$(PYTHON) -m venv .venv-oldest
	$(BIN)/uv pip install --python .venv-oldest/bin/python --resolution lowest-direct --editable '.[all]' --group test
	OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 .venv-oldest/bin/python -m pytest -n auto -W default::DeprecationWarning

clean:
	rm -rf $(VENV) .venv-oldest demo dist .coverage .coverage.* site

$(CALIB): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10))' 2>/dev/null || { \
	  echo "calib needs Python 3.10 or newer; '$(PYTHON)' is $$($(PYTHON) --version 2>/dev/null || echo missing)." >&2; \
	  echo "Install one (Debian, Ubuntu: sudo apt install python3 python3-venv) or name it: make PYTHON=python3.12 $(MAKECMDGOALS)" >&2; \
	  exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || { \
	  echo "Python's venv module is missing. Install it (Debian, Ubuntu: sudo apt install python3-venv) and run make again." >&2; \
	  exit 1; }
	@echo "Setting up $(VENV) (once; a minute or so) ..."
	@rm -rf $(VENV)
	@$(PYTHON) -m venv $(VENV)
	@$(PIP) --quiet uv || true
	@$(call INSTALL,--editable '.[report]')
	@# An editable package is not compiled with the others. A file that changes later is compiled again.
	@$(BIN)/python -m compileall -q calib
	@touch $(CALIB)

$(TOOLS): $(CALIB)
	@echo "Adding the tools of tests, linters and docs:"
	@$(PIP) --quiet --upgrade "pip>=25.1"
	@$(call INSTALL,--group test --group lint --group docs)
	@touch $(TOOLS)
