# make study: the main job; make test: the tests; make evidence: every shipped study. All make .venv
# first where there is none.
# A study that was stopped goes on; a finished one is run afresh. What it writes lies in build/, and is
# held against the results that ship, as times are of a machine.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
export OPENBLAS_NUM_THREADS ?= 1

.PHONY: study evidence test slow check docs clean

study: export PYTHONDONTWRITEBYTECODE :=
study: $(VENV)/.installed
	$(BIN)/sparsefit study run studies/table2.toml --results build/results \
		$(if $(wildcard build/results/table2/cases.sqlite),,--fresh)
	-$(BIN)/sparsefit study compare results/table2 build/results/table2

# Every shipped study by the code that is here. A case that this code has computed is not computed
# again, so that it goes on where it was stopped.
evidence: $(VENV)/.tests
	for study in $(filter-out studies/smoke.toml,$(wildcard studies/*.toml)); do \
		$(BIN)/sparsefit study run $$study --stale || exit; done
	$(BIN)/sparsefit select studies/select.toml --output results/select/estimator.json --force

# Bytecode is kept, whatever the environment says: every process of the tests would compile the
# package anew, and pytest rewrite all tests in each of its workers. These are one more than there
# are processors, as tests of limits and kills wait rather than compute.
test: export PYTHONDONTWRITEBYTECODE :=
test: $(VENV)/.tests
	$(BIN)/python -m compileall -q sparsefit
	$(BIN)/python -m pytest --dist worksteal \
		--numprocesses $$($(BIN)/python -c 'import os; print(os.cpu_count() + 1)')

# What takes long, and what needs dask.
slow: $(VENV)/.slow
	$(BIN)/python -m pytest -m slow --numprocesses auto
	$(BIN)/python -m pytest -k dask

check: $(VENV)/.dev
	$(BIN)/ruff check sparsefit tests docs
	$(BIN)/ruff format --check sparsefit tests docs
	$(BIN)/mypy

# The documentation, in build/docs; a warning is an error.
docs: $(VENV)/.docs
	$(BIN)/python -m sphinx -W --keep-going -n -q -E -b html docs build/docs
	@echo "open build/docs/index.html"

# Compiled kernels of older sources would be tested otherwise.
COMPILED := $(wildcard sparsefit/*/*.pyx)

$(VENV)/.installed: pyproject.toml setup.py $(COMPILED)
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --editable .
	@touch $@

# What an extra asks for, without the package: its loops are compiled once.
EXTRAS = $(BIN)/python -c 'import sys, tomllib; \
	extras = tomllib.load(open("pyproject.toml", "rb"))["project"]["optional-dependencies"]; \
	print(*(need for name in sys.argv[1:] for need in extras[name] if "sparsefit[" not in need), sep="\n")'

$(VENV)/.tests: $(VENV)/.installed
	$(EXTRAS) peers logs completion test > $@
	$(BIN)/python -m pip install --quiet --requirement $@ || (rm $@; exit 1)

$(VENV)/.slow: $(VENV)/.tests
	$(EXTRAS) dask > $@
	$(BIN)/python -m pip install --quiet --requirement $@ || (rm $@; exit 1)

$(VENV)/.dev: $(VENV)/.tests
	$(EXTRAS) dev > $@
	$(BIN)/python -m pip install --quiet --requirement $@ || (rm $@; exit 1)

$(VENV)/.docs: $(VENV)/.installed
	$(EXTRAS) docs peers > $@
	$(BIN)/python -m pip install --quiet --requirement $@ || (rm $@; exit 1)

clean:
	rm -rf $(VENV)
