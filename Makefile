# make run         set up .venv, run the experiments of the papers and own ones into results/
# make draft       the same at low accuracy, into results/draft
# make resume      continue make run after a crash (ACCURACY=draft for a draft)
# make test        set up .venv and run the tests, except those marked "long"
# make test-all    set up .venv and run all tests
# make campaign    generated experiment files, kills and damaged files at random, and the scatter of
#                  seeds against standard errors (one to two hours)
# make calibration the last of these only: docs/calibration.csv, docs/images/calibration.png
# make compliance  check the datasets of make run against the CF conventions (ACCURACY=draft)
# make docs        set up .venv, build the documentation in docs/_build/html and run its examples
# make setup       set up .venv only
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

test: $(VENV)/ready
	$(PYTEST) -m "not long" $(TESTS)

test-all: $(VENV)/ready
	$(PYTEST) $(TESTS)

campaign: $(VENV)/ready
	CALIBRATION=all KILLS=200 DAMAGES=30 CAMPAIGN=10000,300 $(BIN)/python -m pytest -s tests/campaigns

calibration: $(VENV)/ready
	$(BIN)/python tests/campaigns/calibration.py docs

# Builds wheel and sdist, installs them into clean environments, computes one spectrum.
package: $(VENV)/ready
	$(BIN)/python benchmarks/installation.py

compliance: $(VENV)/ready
	$(BIN)/python tests/compliance.py $(dir $(REPORT))data

lint: $(VENV)/ready
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/snakefmt --check Snakefile workflow
	$(BIN)/snakemake --lint
	$(BIN)/mypy

# Warnings are errors: broken links, invalid formulas, examples that fail.
docs: $(VENV)/ready
	$(BIN)/sphinx-build --fail-on-warning --keep-going --fresh-env --write-all --quiet -b html docs docs/_build/html

benchmarks: $(VENV)/ready
	$(BIN)/snakemake --cores $(CORES) benchmarks
	$(BIN)/python benchmarks/interpolation.py
	$(BIN)/python benchmarks/deep_transmittance.py
	$(BIN)/python benchmarks/truncation_depth.py
	$(BIN)/python benchmarks/stopping.py
	$(BIN)/python benchmarks/goniophotometer.py
	$(BIN)/python benchmarks/grain_shape.py
	$(BIN)/python benchmarks/reciprocity.py
	$(BIN)/python benchmarks/exact_layers.py
	$(BIN)/python benchmarks/local_estimation.py
	$(BIN)/python benchmarks/surface_crossings.py
	$(BIN)/python benchmarks/irradiance_profile_cost.py
	$(BIN)/python benchmarks/snowpacks_against_tartes.py
	$(BIN)/python benchmarks/snow_albedo_models.py

# uv installs in seconds what takes pip a minute.  pip is the fallback if uv finds no packages, for
# example behind a mirror that only the settings of pip name.
$(VENV)/ready: pyproject.toml requirements.txt requirements-uv.txt
	$(PYTHON) -c "import sys; sys.exit(sys.version_info < (3, 11) and 'Python 3.11 or newer is needed')"
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-uv.txt
	$(BIN)/uv pip install --quiet --python $(BIN)/python --require-hashes -r requirements.txt || \
		$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.txt
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation \
		--config-settings editable_mode=compat -e .
	touch $@

# Pins every dependency, with hashes.
lock: $(VENV)/ready
	printf 'setuptools>=77\n' | $(BIN)/uv pip compile $(LOCKED) --extra tests --extra docs --extra cluster \
		--output-file requirements.txt pyproject.toml -
	printf 'uv\n' | $(BIN)/uv pip compile $(LOCKED) --output-file requirements-uv.txt -

clean:
	rm -rf $(VENV) .snakemake
