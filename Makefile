# fluxbench: everything a newcomer needs is `make demo` and `make test`; `make help` lists the rest.
PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin

# Two cores are busy enough without threads that wait for each other by spinning.
export OPENBLAS_NUM_THREADS ?= 1
# Programs under test find the modules compiled that another one has imported before.
unexport PYTHONDONTWRITEBYTECODE

# Each worker has a part of the suite of its own: a recording that a folder of tests shares is made once. Two more than
# there are cores: links in real time wait much of their time.
PYTEST := $(BIN)/pytest -q -n 4 --dist worksteal
STAMP := $(VENV)/.installed

# What runs, the viewer, the report and the page included; tests and lint need more, and `make demo` does not wait for it.
# Modules are compiled as they are imported: to compile all of them takes as long as to unpack them, and another 0.2 GB.
RUNS := $(VENV)/.runs
INSTALL := $(BIN)/pip install --quiet --disable-pip-version-check --no-compile --constraint constraints.txt --editable

# Kernels that have changed are compiled once, and tests are read once: workers that begin together would all do it.
KERNELS = $(shell grep -rlE "njit|_numba" --include=*.py orchestrator plugins)
COMPILED := $(VENV)/.compiled
DIAGNOSIS := $(VENV)/.diagnosis-compiled

.PHONY: help demo test suite test-all test-socketcan test-firmware bench torture blind pictures motor-time docs lint lock release audit clean

# The first time, the other core compiles the diagnosis' kernels meanwhile.
demo: $(RUNS)  ## install what runs, commission a simulated motor, diagnose it
	@test -e $(DIAGNOSIS) || (nice $(BIN)/python -m tests.support.kernels --diagnosis && touch $(DIAGNOSIS)) >/dev/null 2>&1 &
	$(BIN)/fluxbench run demo

# Lint beside the tests: it has one core, and the workers wait now and then.
test: $(STAMP)  ## install what tests need, run lint and the fast tests
	$(MAKE) --no-print-directory -j 2 lint suite

help:  ## this list
	@sed -nE 's/^([a-z][a-z-]*):[^#]*## (.*)/\1\t\2/p' $(firstword $(MAKEFILE_LIST)) | sort | awk -F '\t' '{printf "%-16s %s\n", $$1, $$2}'

suite: $(COMPILED)  ## the fast tests alone
	$(PYTEST)

test-all: $(STAMP) lint  ## lint and all tests, slow ones included
	$(PYTEST) -m "slow or not slow"

# Real SocketCAN in a virtual machine: qemu-system-x86, busybox-static and a Debian kernel (docs/robustness.md).
test-socketcan: $(STAMP)  ## the CAN tests on a Linux kernel in a virtual machine
	$(BIN)/python -m tests.socketcan

# The reference firmware on the host and on QEMU's Cortex-M4: kits, runs, kills, fuzzing. What lacks its tool is skipped.
test-firmware: $(STAMP)  ## the reference firmware on the host and on an emulated Cortex-M4
	$(BIN)/pytest -q -m "slow or not slow" tests/plugins/wire/firmware

bench: $(STAMP)  ## benchmarks
	$(BIN)/python -m tests.benchmarks

# The attacks of tests/torture, from where the last call ended; the table in docs/robustness.md.
MINUTES ?= 300
torture: $(COMPILED)  ## attacks for MINUTES=300 minutes, table into docs/robustness.md
	$(BIN)/python -m tests.torture --minutes $(MINUTES) --write docs/robustness.md

# The diagnosis, examined with a plant that it does not know: some hours for the aims' full counts.
SEED ?= $(shell date +%s)
blind: $(STAMP)  ## examine the diagnosis with SEED=..., table into docs/blind-suite.md
	$(BIN)/python -m tests.blind --seed $(SEED) --jobs 2 --write docs/blind-suite.md

# Needs Chromium, and mesa-vulkan-drivers for the viewer.
pictures: $(STAMP)  ## draw the pictures of the documentation anew
	rm -rf runs/pictures runs/pictures.sealed
	$(BIN)/fluxbench run demo --out runs/pictures
	$(BIN)/python -m tests.pictures runs/pictures

# The map's error over motor time (docs/adaptive.md): twenty minutes, from where the last call ended.
motor-time: $(STAMP)  ## map error over motor time, for docs/adaptive.md
	$(BIN)/python -m tests.motor_time runs/motor-time

# The documentation as a site in site/, strictly: a page that the navigation lacks or a link into nothing fails.
docs: $(VENV)/.docs  ## build the documentation as a site in site/
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build

$(VENV)/.docs: $(STAMP)
	@echo "Installing what builds the documentation."
	$(INSTALL) ".[docs]"
	touch $@

$(COMPILED): $(STAMP) $(KERNELS)
	$(BIN)/python -m tests.support.kernels
	-$(BIN)/pytest --collect-only -qq > /dev/null
	touch $@

lint: $(STAMP)  ## ruff, import-linter and mypy
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	$(BIN)/mypy

# Written anew only on purpose: the versions that the tests are known to pass with.
lock: $(STAMP)  ## write constraints.txt anew from the environment
	$(BIN)/pip freeze --exclude-editable --exclude fluxbench > constraints.txt

# Wheel and sdist, the same bytes from the same sources, the notes of the version, and what an installation consists of
# (CycloneDX). The version is that of a tag such as v1.2.3 at the commit, else the newest in CHANGELOG.md.
release: $(STAMP)  ## wheel, sdist, notes, requirements and SBOM in dist/
	rm -rf dist
	$(BIN)/python -m hatchling build -d dist
	$(PYTHON) packaging/release_notes.py > dist/notes.md
	$(PYTHON) -m venv dist/.installed
	dist/.installed/bin/pip install --quiet --disable-pip-version-check --constraint constraints.txt dist/*.whl
	dist/.installed/bin/pip freeze --exclude fluxbench > dist/requirements.txt
	$(PYTHON) -m venv dist/.tools
	dist/.tools/bin/pip install --quiet --disable-pip-version-check "cyclonedx-bom>=7"
	dist/.tools/bin/cyclonedx-py environment --output-reproducible --pyproject pyproject.toml --of JSON \
		-o dist/sbom.json dist/.installed/bin/python
	rm -rf dist/.installed dist/.tools

# What is known to be unsafe of the versions that are pinned. Advisories are PyPI's: where they cannot be reached, this fails.
audit:  ## known vulnerabilities of the pinned versions
	$(PYTHON) -m venv dist/.audit
	dist/.audit/bin/pip install --quiet --disable-pip-version-check "pip-audit>=2.9"
	dist/.audit/bin/pip-audit --requirement constraints.txt --no-deps --disable-pip --strict
	rm -rf dist/.audit

clean:  ## remove the environment, runs, builds and caches
	rm -rf $(VENV) dist runs site .mypy_cache .ruff_cache .hypothesis .import_linter_cache

$(RUNS): pyproject.toml constraints.txt
	@echo "Installing fluxbench into $(VENV): 55 packages, 1.3 GB on disk, 0.5 of them the viewer (docs/installing.md)."
	@echo "pip says nothing meanwhile; the first time it downloads about 0.4 GB, a minute or more."
	@$(PYTHON) -m venv $(VENV)
	@$(INSTALL) ".[viewer,report,serve]"
	@touch $@

$(STAMP): pyproject.toml constraints.txt
	@echo "Installing fluxbench into $(VENV) with what tests and lint need: 135 packages, 1.5 GB on disk (docs/installing.md)."
	@echo "pip says nothing meanwhile; the first time it downloads about 0.4 GB, a minute or more."
	@$(PYTHON) -m venv $(VENV)
	@$(INSTALL) ".[dev]"
	@touch $@ $(RUNS)
