# make run         set up .venv, run the experiments of the papers and your own into results/
# make draft       the same at low accuracy, into results/draft
# make resume      continue make run after a crash (ACCURACY=draft for a draft)
# make test        set up .venv and run the tests, except those marked "long"
# make test-all    set up .venv and run all tests
# make campaign    generated experiment files, kills and damaged files at random, and the scatter of
#                  seeds against standard errors (one to two hours)
# make calibration the last of these only: docs/calibration.csv, docs/images/calibration.png
# make compliance  check the datasets of make run against the CF conventions (ACCURACY=draft)
# make docs        set up .venv, build the documentation in docs/_build/html and run its examples
# make setup       set up .venv only; tests, lint and documentation add what they need
PYTHON ?= python3
CORES ?= 2
ACCURACY ?= standard
LOCKED = --quiet --universal --python-version 3.11 --generate-hashes --no-header --no-annotate
REPORT = results/$(if $(filter standard,$(ACCURACY)),,$(ACCURACY)/)report.html
VENV := .venv
BIN := $(VENV)/bin

# Tests of a file run in one process and share fixtures.  The physics tests compile the kernels that the
# workflow tests use, and short files run last, so that all cores are busy until the end.
PYTEST := OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n $(CORES) --dist loadfile \
	--no-loadscope-reorder
TESTS = $(addprefix tests/,physics workflow campaigns kernels statistics unit)
# Each job is a process; cached bytecode shortens its start.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: run setup test test-all campaign calibration compliance resume draft docs package \
	lint benchmarks lock clean

run: $(VENV)/ready
	$(BIN)/snakemake --cores $(CORES) --config accuracy=$(ACCURACY)
	@echo "Report: $(REPORT)"

setup: $(VENV)/ready

draft:
	$(MAKE) run ACCURACY=draft

resume: $(VENV)/ready
	$(BIN)/snakemake --unlock
	$(MAKE) run

test: $(VENV)/dev
	$(PYTEST) -m "not long" $(TESTS)

test-all: $(VENV)/dev
	$(PYTEST) $(TESTS)

campaign: $(VENV)/dev
	CALIBRATION=all KILLS=200 DAMAGES=30 CAMPAIGN=10000,300 SNOWPACKS=200 RETRIEVALS=1008 \
		$(BIN)/python -m pytest -s tests/campaigns

calibration: $(VENV)/dev
	$(BIN)/python tests/campaigns/calibration.py docs

# Builds wheel and sdist, installs them into clean environments, computes one spectrum.
package: $(VENV)/dev
	$(BIN)/python benchmarks/installation.py

compliance: $(VENV)/dev
	$(BIN)/python tests/compliance.py $(dir $(REPORT))data

lint: $(VENV)/dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/snakefmt --check Snakefile workflow
	$(BIN)/snakemake --lint
	$(BIN)/mypy
	$(BIN)/mypy --strict --no-warn-return-any tests/typing/calls.py

# Warnings are errors: broken links, invalid formulas, examples that fail.
docs: $(VENV)/dev
	$(BIN)/sphinx-build --fail-on-warning --keep-going --fresh-env --write-all --quiet -b html docs docs/_build/html

# Tables of benchmarks/ by program; others take longer or write the tables of docs/.
BENCHMARKS = $(addprefix accuracy.,stopping node_bias sands derivatives) grains.shapes \
	$(addprefix directions.,bins local_estimation reciprocity polarization_cost) \
	$(addprefix directions.,polarization_error weights) costs.planes costs.profile_errors \
	$(addprefix other_models.,exact_layers snowpacks albedo soot)

benchmarks: $(VENV)/dev
	$(BIN)/snakemake --cores $(CORES) benchmarks
	$(BIN)/python benchmarks/solvers.py results/benchmarks/solvers.csv docs/images/solvers.png
	for table in $(BENCHMARKS); do \
		$(BIN)/python benchmarks/$${table%.*}.py $${table#*.} || exit 1; \
	done
	$(BIN)/python benchmarks/costs.py view_table --table docs/how-to/directional_table.csv

# uv installs in seconds what takes pip a minute.  pip is the fallback if uv finds no packages, for
# example behind a mirror that only the settings of pip name.
PIP_INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check
define INSTALL
	$(BIN)/uv pip install --quiet --python $(BIN)/python --require-hashes -r $(1) || \
		$(PIP_INSTALL) --require-hashes -r $(1)
endef

$(VENV)/ready: pyproject.toml requirements.txt requirements-uv.txt
	$(PYTHON) -c "import sys; sys.exit(sys.version_info < (3, 11) and 'Python 3.11 or newer is needed')"
	$(PYTHON) -m venv $(VENV)
	$(PIP_INSTALL) --require-hashes -r requirements-uv.txt
	$(call INSTALL,requirements.txt)
	$(PIP_INSTALL) --no-deps --no-build-isolation --config-settings editable_mode=compat -e .
	touch $@

# What tests, lint, documentation and benchmarks need besides.
$(VENV)/dev: $(VENV)/ready requirements-dev.txt
	$(call INSTALL,requirements-dev.txt)
	touch $@

# Pins every dependency, with hashes.
lock: $(VENV)/dev
	printf 'setuptools>=77\n' | $(BIN)/uv pip compile $(LOCKED) --extra tests --extra docs --extra cluster \
		--output-file requirements-dev.txt pyproject.toml -
	printf 'setuptools>=77\n' | $(BIN)/uv pip compile $(LOCKED) --extra workflow \
		--constraint requirements-dev.txt --output-file requirements.txt pyproject.toml -
	printf 'uv\n' | $(BIN)/uv pip compile $(LOCKED) --output-file requirements-uv.txt -

clean:
	rm -rf $(VENV) .snakemake
