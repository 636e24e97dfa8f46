# Every target works on any machine with make and Python >= 3.11.
PYTHON ?= $(shell for p in python3 python3.14 python3.13 python3.12 python3.11 python; do \
	"$$p" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo "$$p" && break; done)
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

# One process per core below; threads inside each would only compete.
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
# Empty: the first process keeps the bytecode that the hundreds after it would otherwise make anew.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: setup demo types site test test-slow test-all benchmark docs clean

setup: $(STAMP)

$(STAMP): pyproject.toml hatch_build.py
	@test -n "$(PYTHON)" || { echo "Python >= 3.11 was not found; set PYTHON=/path/to/python"; exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	# uv installs in a tenth of the time; pip does where its own settings (an index, a proxy) are needed.
	# Neither writes bytecode: the first import does, of what is used alone.
	$(BIN)/python -m pip install --quiet --retries 1 uv \
		&& $(BIN)/uv pip install --quiet --python $(BIN)/python -e ".[dev]" \
		|| $(BIN)/python -m pip install --quiet --no-compile -e ".[dev]"
	touch $(STAMP)

RUNS := problems/remus_diving_plane/data

demo: setup
	$(BIN)/oed-sysid improve remus_diving_plane $(RUNS)/train_*.csv --validate $(RUNS)/test_*.csv --known-noise --html out/demo/report.html

# Hundreds of kernels are compiled once and run briefly: light optimisation, the same arithmetic.
# `make test-slow` and the tests on three systems use the flags of a user's machine.
test: export OED_SYSID_CFLAGS ?= -Og
# The site of the tests shows notebooks as they are; `make test-slow` executes them.
test: export OED_SYSID_SITE ?= text
test: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	# Neither of the two uses a second core.
	$(MAKE) --no-print-directory -j 2 types site
	$(BIN)/pytest -n 2 --dist worksteal -m "not slow" tests oed_sysid --doctest-modules --doctest-ignore-import-errors

types: setup
	$(BIN)/mypy

site: setup
	$(BIN)/sphinx-build -q -W --keep-going -j auto -b html docs out/site

test-slow: setup
	$(BIN)/pytest -n 2 --dist worksteal -m slow tests

# Everything, with the oldest and with the newest libraries that pyproject.toml admits.
test-all: setup test test-slow
	mkdir -p out
	$(BIN)/uv pip compile --quiet --no-deps --no-header --no-annotate --resolution lowest-direct \
		pyproject.toml > out/lowest.txt
	: > out/newest.txt
	set -e; for kind in lowest newest; do \
		$(BIN)/python -m venv --clear out/$$kind; \
		out/$$kind/bin/python -m pip install --quiet --upgrade -c out/$$kind.txt -e ".[dev]"; \
		out/$$kind/bin/pytest -n 2 --dist worksteal -m "not slow" tests; \
	done

benchmark: setup
	$(BIN)/python -m benchmarks

docs: site

clean:
	rm -rf build dist out .pytest_cache .mypy_cache .ruff_cache
	find . -name __pycache__ -type d -not -path "./$(VENV)/*" -prune -exec rm -rf {} +
