# `make demo` and `make test` set up all they need and run; a second call starts at once.
SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
OUT := out
# Python compiles what it imports when it first does; all of torch and Open3D ahead would be a third of the set-up.
unexport PYTHONDONTWRITEBYTECODE
INSTALL := $(BIN)/pip install --quiet --disable-pip-version-check --no-compile -c constraints.txt
# The pip that comes with Python 3.11 takes most of a minute to choose among all wheels there are; today's a third of it.
UPGRADE := $(BIN)/pip install --quiet --disable-pip-version-check --upgrade pip || true

HAS_CUDA := $(PYTHON) -c 'import torch, sys; sys.exit(torch.version.cuda is None)' 2>/dev/null

.PHONY: demo test lint bench clean

demo: $(READY)
	$(BIN)/twin_node demo --out $(OUT)/demo

# Tests side by side, three even on two cores: many wait for something. The others keep a core busy each, with one
# thread, where two would wait for each other; what takes more says so. Who has done its share takes from another's.
test: lint
	OMP_NUM_THREADS=1 $(BIN)/pytest -n 3 --dist worksteal

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: $(READY)
	$(BIN)/twin_node bench raster

# Open3D needs libusb, libGL and libEGL, and Debian ships venv apart from Python: installed when we may, else named.
$(READY): pyproject.toml setup.py constraints.txt constraints-cpu.txt
	@missing=; for lib in libusb-1.0.so.0:libusb-1.0-0 libGL.so.1:libgl1 libEGL.so.1:libegl1; do \
	  ldconfig -p | grep -q "$${lib%%:*}" || missing="$$missing $${lib##*:}"; done; \
	$(PYTHON) -c 'import ensurepip' 2>/dev/null || missing="$$missing python3-venv"; \
	if [ -n "$$missing" ]; then \
	  if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	    apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq $$missing; \
	  else echo "note: install these system packages for full function:$$missing" >&2; fi; fi
	@if $(HAS_CUDA); then echo "using the torch of $(PYTHON), which has CUDA"; fi
	$(PYTHON) -m venv $$($(HAS_CUDA) && echo --system-site-packages) $(VENV)
	$(UPGRADE)
	$(HAS_CUDA) || $(INSTALL) -r constraints-cpu.txt
	PYTHONWARNINGS='ignore:Editable installation' $(INSTALL) -e '.[dev]'
	touch $(READY)

clean:
	rm -rf $(VENV) $(OUT) build *.egg-info
