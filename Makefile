# `make run` runs the main job, `make test` lint, types and the quick tests, `make test-all` also those
# slow tests that a change asks for, `make nightly` all tests. tests/shelves.py alone knows what a change
# asks for. Each sets everything up: `run` without extras, tests with all of them.
VENV ?= .venv
BIN := $(VENV)/bin
CANDIDATES := $(PYTHON) python3 python3.13 python3.12 python3.11
FITS := import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))
PYTEST := OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist worksteal
QUICK := -m "not slow and not browser and not nightly"
# Some hundred quick tests that end in numbers.
NUMERIC := tests/golden/test_golden.py tests/ekf_reference/filters tests/graphslam/test_search.py \
	tests/graphslam/test_smoother.py tests/comparisons/test_check_page.py \
	-k "not golden or loop or waypoint or check or solve"

.PHONY: run test test-all same test-flavours test-pythons test-newest test-lowest lowest lint style types settings docs pictures results results-speed peers bench nightly release-check clean

# slamcheck exits with 0, 1 or 3 for its verdict; only 2 and crashes are failures of the job.
run: $(VENV)/installed
	@$(BIN)/slamcheck run; code=$$?; [ $$code -eq 0 ] || [ $$code -eq 1 ] || [ $$code -eq 3 ]

test: lint
	$(PYTEST) $(QUICK)

# What a change asks for: the tests on no shelf, and the shelves that cover what has changed
# (tests/shelves.py). Types are checked beside the tests, which end where these are wrong.
test-all: style
	@$(BIN)/mypy & types=$$!; \
	$(PYTEST) -m "not nightly" --durations=30 & tests=$$!; \
	wait $$types || { kill $$tests; wait $$tests; exit 1; }; wait $$tests

# Golden runs by the code of a commit and by the tree's, on this machine: every file is compared to
# the bit, times apart. ONLY="loop-own check": these cases. Five minutes.
same: $(VENV)/installed-dev
	$(BIN)/python -m tests.golden.same $(BASE) $(ONLY)

# What an old processor rounds otherwise, the last bits of sums, sines and arctangents: OpenBLAS' oldest
# code, and numpy without all vector features but the oldest of those that it may do without.
FEATURES := import numpy; f = numpy.show_config('dicts')['SIMD Extensions']['found']; print(*f[1:] or f)
OLD = OPENBLAS_CORETYPE=Prescott NPY_DISABLE_CPU_FEATURES="$$($(BIN)/python -c "$(FEATURES)")"

# Tests that end in numbers, as on an old processor.
test-flavours: $(VENV)/installed-dev
	$(OLD) $(PYTEST) $(QUICK) $(NUMERIC)

# The quick tests on each Python that the project is for: those on PATH, none may be missing.
test-pythons:
	@for v in 3.11 3.12 3.13; do \
		command -v python$$v > /dev/null || { echo "no python$$v on PATH" >&2; exit 2; }; \
		$(MAKE) build/venv-$$v/installed-dev VENV=build/venv-$$v PYTHON=python$$v && \
		$(MAKE) test VENV=build/venv-$$v || exit 1; \
	done

# The quick tests with the newest numpy and scipy that can be had.
test-newest:
	$(MAKE) build/venv-newest/installed-dev VENV=build/venv-newest
	build/venv-newest/bin/python -m pip install --quiet --upgrade numpy scipy
	$(MAKE) test VENV=build/venv-newest

# The quick tests with the lowest versions that pyproject.toml admits, on the oldest Python and the
# newest; what these warn of is no error.
test-lowest:
	@for v in 3.11 3.13; do \
		$(MAKE) lowest VENV=build/venv-lowest-$$v PYTHON=python$$v || exit 1; \
	done

lowest: $(VENV)/installed-dev
	$(BIN)/python -m pip install --quiet uv
	$(BIN)/uv pip compile --quiet --resolution lowest-direct --extra dev pyproject.toml \
		--python $(BIN)/python --output-file $(VENV)/lowest.txt
	$(BIN)/uv pip install --quiet --python $(BIN)/python -r $(VENV)/lowest.txt
	$(PYTEST) -o filterwarnings= $(QUICK)

lint: style types

style: $(VENV)/installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/installed-dev
	$(BIN)/mypy

# The documents' constants beside those that runs use.
settings: $(VENV)/installed
	$(BIN)/python -m tools.settings_page > docs/settings.md
	$(BIN)/python -m tools.verdicts_page
	$(BIN)/python -m tools.formats_page
	$(BIN)/python -m tools.options_table > table.py~ && mv table.py~ comparisons/options/table.py
	$(BIN)/python -m tools.options_types > typed.py~ && mv typed.py~ slamcheck/_options.py

# The pages, in build/docs; a dead link is an error.
docs: $(VENV)/installed-dev
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build

# The tutorials' outputs and pictures, by running their commands; needs Chromium.
pictures: $(VENV)/installed-dev
	$(BIN)/python docs/pictures.py

# Records what docs/results.md lacks or shows as stale; DATA is the folder of the public logs. Hours.
DATA ?= ../shared/data
results: $(VENV)/installed-dev
	$(BIN)/python -m research.record --due --data $(DATA)

# The tables of times, on a machine that does nothing else. Half an hour.
results-speed: $(VENV)/installed-dev
	$(BIN)/python -m research.record --due --idle --data $(DATA)

# The same work by us and by peers, in turns. PyPI's peers are installed; Debian's are named.
peers: $(VENV)/installed-dev
	$(BIN)/python -m pip install --quiet filterpy "evo>=1.28"
	@command -v kf-slam >/dev/null || echo "for MRPT: sudo apt-get install mrpt-apps mrpt-common"
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m research.peers $(if $(ONLY),--only $(ONLY))

# Jobs by the code of a commit (BASE; main and the last release if left out) and by the tree's, in turns;
# what has become slower by more than 10 % is an error. Three to five minutes a commit.
bench: $(VENV)/installed-dev
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m research.bench $(BASE)

# Hours: every test; 30,000 damaged files, odd settings, kills, full disks and strange things in an
# output's place, drawn anew each time, with how many of each kind were tried; the quick tests as on
# each processor, on each Python, and with the newest and the oldest libraries that pyproject.toml
# admits; and mutants of the code, of which 95 % must be rejected.
nightly: lint
	$(PYTEST)
	HYPOTHESIS_PROFILE=nightly OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 \
		--dist worksteal tests/fuzz
	OPENBLAS_CORETYPE=Haswell $(PYTEST) $(QUICK)
	$(OLD) $(PYTEST) $(QUICK)
	$(MAKE) test-pythons test-newest test-lowest
	$(BIN)/python -m research.mutants

# Source distribution and wheels, built, looked into, and used in fresh environments on Python 3.11,
# 3.12 and 3.13: those on PATH or PYTHONS="/path/to/python3.11 ...". ALLOW_MISSING=1: those there are.
release-check: $(VENV)/bin/python
	$(BIN)/python -m tests.release_check $(if $(ALLOW_MISSING),--allow-missing) $(PYTHONS)

$(VENV)/bin/python:
	@for p in $(CANDIDATES); do \
		if $$p -c "$(FITS)" 2>/dev/null; then exec $$p -m venv $(VENV); fi; \
	done; \
	echo "no Python 3.11 to 3.13 found; name one: make PYTHON=/path/to/python3" >&2; exit 2

$(VENV)/installed: $(VENV)/bin/python pyproject.toml
	$(BIN)/python -m pip install --quiet --editable .
	@touch $@

# By uv, which takes a quarter of pip's time; by pip where uv does not get everything.
$(VENV)/installed-dev: $(VENV)/bin/python pyproject.toml
	{ $(BIN)/python -m pip install --quiet uv && \
		$(BIN)/uv pip install --quiet --python $(BIN)/python --editable ".[dev]"; } || \
		$(BIN)/python -m pip install --quiet --editable ".[dev]"
	@touch $@ $(VENV)/installed

clean:
	rm -rf $(VENV) build *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
