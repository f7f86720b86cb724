# Targets: setup check test lint bench simulate fuzz load results results-loops drill demo schemas vocabulary. All but `setup` run it first.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMPS := .setup
JOBS ?= 2

CORE_SOURCES := $(shell find core -path core/build -prune -o -type f -print)
PYTHON_DIRS := covinz services agents/covinz_agents benchmarks scripts tests vocabulary schemas

# One thread for linear algebra in every process: the machine's cores belong to the workers.
export OMP_NUM_THREADS := 1
export OPENBLAS_NUM_THREADS := 1

.PHONY: setup check test lint simulate fuzz load bench results results-loops drill demo schemas vocabulary core-tests core-sanitize core-neon clean

setup: $(STAMPS)/apt $(STAMPS)/venv $(STAMPS)/core $(STAMPS)/packages

$(STAMPS)/apt: apt-packages.txt
	@mkdir -p $(STAMPS)
	@missing=""; for p in $$(cat apt-packages.txt); do \
	  dpkg-query -W -f '$${Status}' $$p 2>/dev/null | grep -q 'ok installed' || missing="$$missing $$p"; \
	done; \
	if [ -n "$$missing" ]; then \
	  if [ "$$(id -u)" = 0 ]; then run=""; \
	  elif command -v sudo >/dev/null && sudo -n true 2>/dev/null; then run="sudo"; \
	  else echo "These packages are missing and need root to install:$$missing" >&2; \
	    echo "Ask an administrator for: apt-get install$$missing" >&2; exit 1; fi; \
	  $$run apt-get update -qq && \
	  DEBIAN_FRONTEND=noninteractive $$run apt-get install -y -qq --no-install-recommends $$missing; \
	fi
	@touch $@

$(STAMPS)/venv: requirements.txt | $(STAMPS)/apt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "covinz needs Python 3.11 or newer; set PYTHON=/path/to/python3.11" >&2; exit 1; }
	$(BIN)/python -m pip --version >/dev/null 2>&1 || $(PYTHON) -m venv --clear $(VENV)
	$(BIN)/python -m pip install --quiet -r requirements.txt
	@touch $@

$(STAMPS)/core: $(CORE_SOURCES) | $(STAMPS)/venv
	CMAKE_BUILD_PARALLEL_LEVEL=$(JOBS) $(BIN)/python -m pip install --quiet --no-build-isolation --no-deps ./core
	@touch $@

$(STAMPS)/packages: pyproject.toml agents/pyproject.toml | $(STAMPS)/venv
	$(BIN)/python -m pip install --quiet --no-build-isolation --no-deps -e . -e agents
	@touch $@

# The fast suite; compose itself reads docker-compose.yml in it.
check: setup
	$(BIN)/python -m pytest -q -m "not slow" tests/unit tests/contract tests/fuzz

# Everything: lint, the core's tests with and without sanitizers, and all Python tests.
test: lint core-tests core-sanitize
	$(BIN)/python -m pytest tests

lint: setup
	$(BIN)/ruff check $(PYTHON_DIRS)
	$(BIN)/ruff format --check $(PYTHON_DIRS)
	$(BIN)/mypy $(PYTHON_DIRS)
	$(BIN)/lint-imports
	find core -path core/build -prune -o \( -name '*.cc' -o -name '*.h' \) -print | xargs clang-format --dry-run -Werror

core-tests: setup
	cmake -S core -B core/build/tests -GNinja -DCOVINZ_BUILD_TESTS=ON -DCOVINZ_BUILD_PYTHON=OFF >/dev/null
	cmake --build core/build/tests -j $(JOBS)
	ctest --test-dir core/build/tests --output-on-failure -j $(JOBS)

# The matching kernels of 64-bit ARM, emulated (needs g++-aarch64-linux-gnu and qemu-user).
core-neon:
	scripts/neon_tests.sh

core-sanitize: setup
	cmake -S core -B core/build/sanitize -GNinja -DCOVINZ_BUILD_TESTS=ON -DCOVINZ_BUILD_PYTHON=OFF -DCOVINZ_SANITIZE=ON >/dev/null
	cmake --build core/build/sanitize -j $(JOBS)
	ctest --test-dir core/build/sanitize --output-on-failure -j $(JOBS)

# The deterministic simulation of faults: docs/testing.md. One seed in full: make simulate SEED=17
SEEDS ?= 1000
FIRST ?= 0

simulate: setup
	$(BIN)/python -m tests.simulation $(if $(SEED),--seed $(SEED),--seeds $(SEEDS) --first $(FIRST))

# Spoilt messages of every type: docs/testing.md. Other seeds find other things.
DECODES ?= 1000000

fuzz: setup
	$(BIN)/python -m benchmarks.fuzz_decoding --decodes $(DECODES) --seed $(or $(SEED),0) --corpus tests/fuzz/corpus

# What fifty robots and more workers make of two cores; takes the whole machine for a quarter of an hour.
load: setup
	$(BIN)/python -m benchmarks.load --json benchmarks/results/load.json >/dev/null
	$(BIN)/python -m benchmarks.results_page

BENCHMARKS := scenarios demo map_floor matching place_recognition map_from_scratch pose_graph cauchy_scale

# Ceres, which pose_graph and map_from_scratch compare with, comes with the core's tests.
bench: setup
	cmake -S core -B core/build/tests -GNinja -DCOVINZ_BUILD_TESTS=ON -DCOVINZ_BUILD_PYTHON=OFF >/dev/null
	cmake --build core/build/tests -j $(JOBS) --target ceres_pose_graph
	@mkdir -p benchmarks/results
	@set -e; for name in $(BENCHMARKS); do \
	  echo "benchmarks/$$name.py"; \
	  $(BIN)/python -m benchmarks.$$name --out benchmarks/results/$$name.json >/dev/null; \
	done
	$(BIN)/python -m benchmarks.readme
	$(BIN)/python -m benchmarks.results_page

# The larger scenarios and their page: half an hour where no image is in the cache.
results: setup
	$(BIN)/python -m benchmarks.large_scenarios --out benchmarks/results/large_scenarios.json --pictures docs/pictures >/dev/null
	$(BIN)/python -m benchmarks.results_page

# The loop solver: its benchmarks, their page and the README's table. Some six minutes.
LOOP_BENCHMARKS := loop_synthetic loop_accuracy runtime_traffic

results-loops: setup
	@mkdir -p benchmarks/results
	@set -e; for name in $(LOOP_BENCHMARKS); do \
	  echo "benchmarks/$$name.py"; \
	  $(BIN)/python -m benchmarks.$$name --json benchmarks/results/$$name.json >/dev/null; \
	done
	$(BIN)/python -m benchmarks.readme
	$(BIN)/python -m benchmarks.results_page

# Every fault that a fleet meets: docs/testing.md. Half an hour; links and full disks need root.
drill: setup
	@mkdir -p benchmarks/results
	-$(BIN)/python -m benchmarks.fault_drill --json benchmarks/results/fault_drill.json >/dev/null
	$(BIN)/python -m benchmarks.results_page

demo: setup
	$(BIN)/covinz run scenarios/hall.yaml --workers 2

schemas: setup
	$(BIN)/python schemas/generate.py

vocabulary: setup
	$(BIN)/python -m vocabulary.train

clean:
	rm -rf $(VENV) $(STAMPS) core/build build runs
