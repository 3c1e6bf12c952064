# The two commands of the README are `make demo` and `make test`; the rest are for developers.
#
# PYTHON=python3.11 names the interpreter, VENV=.venv the environment that is made.

PYTHON ?= python3.11
VENV ?= .venv
DEMO_VENV ?= .venv-demo
BIN := $(VENV)/bin
# uv itself lives in the environment, and --inexact keeps it there.
SYNC = VIRTUAL_ENV=$(abspath $(1)) $(1)/bin/uv sync --active --frozen --inexact --quiet
export MULTICAM_DATA ?= $(CURDIR)/data
# As the command itself sets it: threads of BLAS cost more than the small matrices here are worth.
export OPENBLAS_NUM_THREADS ?= 1

# Shared libraries that `import bpy` loads on a bare Debian or Ubuntu.
BPY_LIBRARIES := libxrender1 libxi6 libxkbcommon0 libxfixes3 libsm6 libgl1 libegl1

.PHONY: help demo test check lint types contracts e2e benchmark wheel system-libraries clean

help:
	@echo "make demo       the shipped network on the shipped recording (light install, a few minutes)"
	@echo "make test       everything installed, every test run"
	@echo "make check      lint, types, import contracts and tests, as the gate runs them"
	@echo "make e2e        CAD models -> renders -> training -> ONNX -> run -> evaluate, resumable"
	@echo "make benchmark  registration: published estimates (MULTICAM_BENCH), worse ones, ablation; simulations"
	@echo "make wheel      build the wheel and try it in an empty environment"

demo: $(DEMO_VENV)/.ready
	$(DEMO_VENV)/bin/multicam demo --output output/demo

test: $(VENV)/.ready
	$(BIN)/pytest

check: lint types contracts test

lint: $(VENV)/.ready
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.ready
	$(BIN)/pyright --pythonpath $(BIN)/python

contracts: $(VENV)/.ready
	$(BIN)/lint-imports

# The runtime alone: neither torch nor bpy.
$(DEMO_VENV)/.ready: pyproject.toml uv.lock | python-found
	$(PYTHON) -m venv --clear $(DEMO_VENV)
	$(DEMO_VENV)/bin/pip install --quiet uv
	$(call SYNC,$(DEMO_VENV)) --extra run
	touch $@

# Everything.
$(VENV)/.ready: pyproject.toml uv.lock | python-found system-libraries
	$(PYTHON) -m venv --clear $(VENV)
	$(VENV)/bin/pip install --quiet uv
	$(call SYNC,$(VENV)) --all-extras
	touch $@

.PHONY: python-found
python-found:
	@command -v $(PYTHON) >/dev/null || { \
	  echo "multicam-pose needs Python 3.11, and $(PYTHON) is not on the path; name it with PYTHON=/path/to/python3.11."; exit 1; }
	@$(PYTHON) -c 'import sys, venv, ensurepip; sys.exit(sys.version_info[:2] != (3, 11))' 2>/dev/null || { \
	  echo "$(PYTHON) is not Python 3.11 with venv; on Debian or Ubuntu: apt-get install python3.11 python3.11-venv"; exit 1; }

system-libraries:
	@missing=""; for package in $(BPY_LIBRARIES); do dpkg -s $$package >/dev/null 2>&1 || missing="$$missing $$package"; done; \
	if [ -n "$$missing" ]; then \
	  if [ "$$(id -u)" = 0 ]; then \
	    apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends $$missing >/dev/null; \
	  else echo "Blender needs system libraries; run: sudo apt-get install$$missing"; exit 1; fi; fi

e2e: $(VENV)/.ready
	$(BIN)/python scripts/e2e.py

benchmark: $(VENV)/.ready
	$(BIN)/python benchmarks/registration.py
	$(BIN)/python benchmarks/degraded.py
	$(BIN)/python benchmarks/ablation.py
	$(BIN)/python benchmarks/refused.py
	$(BIN)/python benchmarks/scale.py
	$(BIN)/python benchmarks/honesty.py
	$(BIN)/python benchmarks/walk.py

wheel: $(VENV)/.ready
	$(BIN)/python scripts/try_wheel.py

clean:
	rm -rf $(VENV) $(DEMO_VENV) dist build output .pytest_cache .ruff_cache
