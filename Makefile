# make run: set up and run the loop against the simulated ring.  make test: set up and test.
# make nightly: all other tests.
PYTHON ?= python3.11
BIN := .venv/bin
STAMP := .venv/.installed
WORKERS := $(shell echo $$(($$(nproc) + 1)))
BESIDE := -n $(WORKERS) --maxprocesses 8 --dist loadscope --no-loadscope-reorder
PYTEST := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest

CHANNEL_ACCESS := tests/unit/epics tests/unit/sim tests/unit/panel \
  $(wildcard tests/system/test_epics_machine*.py tests/system/test_ioc_*.py tests/system/test_panel*.py)
COVERED := loop safety epics learn panel
COMMA := ,
SPACE := $(COMMA:,= )

# make docs: the pages as a site in site/.
.PHONY: run test test-beside test-alone nightly nightly-beside nightly-alone nightly-plain mutants newest coverage test-docs docs newcomer house venv lint types layers audit format bench clean blind chaos soak

run: venv
	$(BIN)/orbitfb run --ioc sim

# What says something about time runs alone, after all others: those run beside each other on all
# cores, one more than there are, as services are waited for; each with ports and a runtime directory
# of its own. What each took is kept in build/times.
# Of a failed test nothing is tried again: it is a bug of test or program.
test: venv
	$(MAKE) --no-print-directory --keep-going --jobs=1 test-beside test-alone

test-beside: venv
	$(PYTEST) -m "not nightly and not timing" $(BESIDE) --times=build/times/beside.txt

test-alone: venv
	$(PYTEST) -m "timing and not nightly" tests/system --times=build/times/alone.txt

# Statistical and long tests, every page, faults at random, the bench, and what needs programs of
# Debian, which are installed where that can be done; then safety rules, broken one at a time, and the
# newest versions of all packages.
nightly: venv
	$(MAKE) --no-print-directory --keep-going --jobs=1 nightly-beside nightly-alone nightly-plain mutants newest

nightly-beside: venv
	@tests/debian/install
	$(PYTEST) -m "nightly and not timing" $(BESIDE) --times=build/times/nightly-beside.txt tests tests/debian

nightly-alone: venv
	$(PYTEST) -m "nightly and timing" tests/system --times=build/times/nightly-alone.txt

# Other tests fork the program from a process that has imported it; here each start is a new one.
nightly-plain: venv
	PLAIN_STARTS=1 $(PYTEST) -m "not nightly and not timing" $(BESIDE) --times=build/times/nightly-plain.txt tests/system

mutants: venv
	$(BIN)/python -m tests.mutants

# The newest versions that pyproject.toml allows, in an environment of their own, and what speaks
# Channel Access on them; most of the time is the installation.
newest:
	test -x build/newest/bin/python || $(PYTHON) -m venv build/newest
	build/newest/bin/python -m pip install --quiet --upgrade --upgrade-strategy eager --editable '.[dev]'
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 build/newest/bin/python -m pytest $(CHANNEL_ACCESS)

# Lines of what steers, learns and shows that its unit tests run; coverage has a folder of its own.
coverage: venv
	test -d build/coverage || $(BIN)/python -m pip install --quiet --target build/coverage coverage
	PYTHONPATH=build/coverage COVERAGE_FILE=build/coverage.data $(subst -m pytest,,$(PYTEST)) -m coverage run \
	  --source $(subst $(SPACE),$(COMMA),$(COVERED:%=orbitfb/%)) -m pytest -q $(COVERED:%=tests/unit/%)
	PYTHONPATH=build/coverage COVERAGE_FILE=build/coverage.data $(BIN)/python -m coverage report --skip-covered

venv: $(STAMP)

# The pip that comes with Python 3.11.7 (23.2) computes 75 s over what this one does in 43.
PIP := pip==26.3

$(STAMP): pyproject.toml constraints.txt
	@echo "setting up .venv, one to some minutes: each package is named as it is fetched"
	@begun=$$(date +%s); set -e; \
	  test -x $(BIN)/python || $(PYTHON) -m venv .venv; \
	  $(BIN)/python -m pip install --disable-pip-version-check --quiet $(PIP) || echo "pip stays as it is"; \
	  $(BIN)/python -m pip install --disable-pip-version-check --progress-bar off \
	    --constraint constraints.txt $(INSTALL) --editable '.[dev]'; \
	  touch $(STAMP); echo ".venv is set up: $$(($$(date +%s) - begun)) s"

lint: venv
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: venv
	$(BIN)/pyrefly check

layers: venv
	$(BIN)/lint-imports

# Versions as pinned, packages reviewed, known vulnerabilities where they can be asked for.
audit: venv
	$(BIN)/python .ci/audit.py

format: venv
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

docs: venv
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet
	@echo "site/index.html; with search: $(BIN)/python -m http.server --bind 127.0.0.1 --directory site"

# Do what every page says: some minutes; a part of make nightly.
test-docs: venv
	$(PYTEST) -m "nightly or not nightly" tests/system/test_docs_snippets.py

newcomer: venv
	$(BIN)/python -m benchmarks.newcomer --out benchmarks/newcomer.json

# Files per folder, loose modules, lengths, circles of imports, what the tests took.
house: venv
	$(BIN)/python -m benchmarks.house

bench: venv
	$(BIN)/python -m benchmarks.loop --out benchmarks/loop.json
	$(BIN)/python -m benchmarks.identification --out benchmarks/identification.json

# The diagnosis on fresh records: of the own generator, of a small ring, and of a further generator if its
# path is given (PLANT=…). Another SEED draws other records.
blind: venv
	$(BIN)/python -m benchmarks.blind --own $(or $(SEED),1) --suite $(or $(SUITE),fast) --fodo $(or $(SEED),1) \
	  $(if $(PLANT),--plant $(PLANT) --seed $(or $(SEED),1)) --leave-out --experiments \
	  --jobs $(or $(JOBS),2) --out $(or $(OUT),orbitfb-data/blind)

chaos: venv
	$(BIN)/python -m tests.chaos --seed $(or $(SEED),1) --faults $(or $(FAULTS),500) $(if $(OUT),--out $(OUT))

soak: venv
	$(BIN)/python -m tests.soak --hours $(or $(HOURS),12) --days $(or $(DAYS),7) --minutes $(or $(MINUTES),30) $(if $(OUT),--out $(OUT)/soak.json)

clean:
	rm -rf .venv build dist
