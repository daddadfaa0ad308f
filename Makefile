# make run     set up .venv, run every experiment of config/ and write the report
# make test    set up .venv and run the tests, but for comparisons that take minutes each
# make test-long  those
# make campaign  10 000 generated experiment files, 300 of them run, 200 kills, 30 damages of each
#                sort, seeds against stated errors of every instrument (an hour or two)
# make calibration  the last of these alone: docs/calibration.csv, docs/images/calibration.png
# make setup   set up .venv and nothing else
# make docs    set up .venv and build the documentation in docs/_build/html; its examples run
# make draft   what make run does, quickly and roughly, into results/draft
# make compliance  whether the datasets of make run follow the CF conventions (ACCURACY=draft: of make draft)
# make resume  go on with make run after a crash (ACCURACY=draft if it was a draft)
PYTHON ?= python3
CORES ?= 2
ACCURACY ?= standard
LOCKED = --quiet --universal --python-version 3.11 --generate-hashes --no-header --no-annotate
REPORT = results/$(if $(filter standard,$(ACCURACY)),,$(ACCURACY)/)report.html
# What the report shows, or is made by, and is newer than it.
MADE = $(addprefix $(dir $(REPORT)),data figures tables benchmarks)
NEWER = find Snakefile config $(MADE) -newer $(REPORT) -print -quit 2>/dev/null; \
	find workflow splits benchmarks -name '*.*' ! -name '*.pyc' -type f -newer $(REPORT) -print -quit
VENV := .venv
BIN := $(VENV)/bin

# Each file to whichever process is free, so that tests of a file share what they make.  Kernels that
# physics has compiled serve the workflow, and short files come last, so that no core stands idle.
PYTEST := OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n $(CORES) --dist loadfile \
	--no-loadscope-reorder
TESTS = $(addprefix tests/,physics workflow campaigns kernels statistics unit)
# Every job is a process: libraries are not to be translated to bytecode again each time.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: run setup test test-long campaign calibration compliance resume draft docs package \
	lint benchmarks lock clean

run: $(VENV)/ready
	$(BIN)/snakemake --cores $(CORES) --config accuracy=$(ACCURACY)
	@if [ ! -s $(REPORT) ] || [ -n "$$($(NEWER))" ]; then \
		$(BIN)/snakemake --report $(REPORT:.html=.aside.html) --config accuracy=$(ACCURACY) && \
		mv $(REPORT:.html=.aside.html) $(REPORT); \
	else echo "$(REPORT) is up to date"; fi

setup: $(VENV)/ready

draft:
	$(MAKE) run ACCURACY=draft

resume: $(VENV)/ready
	$(BIN)/snakemake --unlock
	$(MAKE) run

test: $(VENV)/ready
	$(PYTEST) -m "not long" $(TESTS)

test-long: $(VENV)/ready
	$(PYTEST) -m long $(TESTS)

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

# A warning is an error: links that lead nowhere, formulas that are not understood, examples that fail.
docs: $(VENV)/ready
	$(BIN)/sphinx-build --fail-on-warning --keep-going --fresh-env --write-all --quiet -b html docs docs/_build/html

benchmarks: $(VENV)/ready
	$(BIN)/snakemake --cores $(CORES) benchmarks
	$(BIN)/python benchmarks/interpolation.py
	$(BIN)/python benchmarks/deep_transmittance.py
	$(BIN)/python benchmarks/deep_packs.py
	$(BIN)/python benchmarks/stopping.py
	$(BIN)/python benchmarks/goniophotometer.py
	$(BIN)/python benchmarks/grain_shape.py
	$(BIN)/python benchmarks/reciprocity.py
	$(BIN)/python benchmarks/exact_layers.py
	$(BIN)/python benchmarks/local_estimation.py
	$(BIN)/python benchmarks/surface_crossings.py
	$(BIN)/python benchmarks/light_inside.py
	$(BIN)/python benchmarks/packs_against_tartes.py
	$(BIN)/python benchmarks/snow_peers.py

# uv does in seconds what takes pip a minute; pip steps in where uv finds no packages, such as behind
# a mirror that only pip's own settings name.
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
