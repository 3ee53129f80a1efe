# make run: set up and run the loop against the simulated ring.  make test: set up and test.
PYTHON ?= python3.11
BIN := .venv/bin
STAMP := .venv/.installed
PYTEST := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest

# Tests that start services, on a computer busy with others: what failed is tried again, alone, and
# once more after a while. All results are printed; what failed once is a bug of test or program.
again = { test $$? -eq 1 && echo "again, alone:" && sleep $(2) && $(PYTEST) --last-failed $(1)$(3); }
tried = $(PYTEST) $(1) || $(call again,$(1),1, || $(call again,$(1),60))

# make docs: the pages as a site in site/.
.PHONY: run test test-system test-docs docs newcomer venv lint types layers audit format bench clean blind chaos soak

run: venv
	$(BIN)/orbitfb run --ioc sim

# Unit tests compute: on all cores, each on one. Those that start services come one after the other:
# on two cores several at once take as long, and what they say about time is no longer true.
test: venv
	$(PYTEST) tests/unit -n logical --maxprocesses 8 --dist loadscope --no-loadscope-reorder
	$(call tried,--ignore tests/unit)

venv: $(STAMP)

$(STAMP): pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	touch $(STAMP)

lint: venv
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: venv
	$(BIN)/pyright

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

# Do what every page says: some minutes.
test-docs: venv
	$(PYTEST) -m slow tests/system/test_docs_snippets.py

newcomer: venv
	$(BIN)/python -m benchmarks.newcomer --out benchmarks/newcomer.json

bench: venv
	$(BIN)/python -m benchmarks.loop --out benchmarks/loop.json

# The diagnosis on fresh records: of the own generator, of a small ring, and of a further generator if its
# path is given (PLANT=…). Another SEED draws other records.
blind: venv
	$(BIN)/python -m benchmarks.blind --own $(or $(SEED),1) --suite $(or $(SUITE),fast) --fodo $(or $(SEED),1) \
	  $(if $(PLANT),--plant $(PLANT) --seed $(or $(SEED),1)) --leave-out --experiments \
	  --jobs $(or $(JOBS),2) --out $(or $(OUT),orbitfb-data/blind)

chaos: venv
	$(BIN)/python -m tests.chaos --seed $(or $(SEED),1) --faults $(or $(FAULTS),500) $(if $(OUT),--out $(OUT))

soak: venv
	$(BIN)/python -m tests.soak --hours $(or $(HOURS),12) --minutes $(or $(MINUTES),30) $(if $(OUT),--out $(OUT)/soak.json)

# What needs programs of Debian, and every page: some minutes.
test-system: venv
	@tests/debian/install
	$(call tried,-m "slow or debian" tests/debian tests/system/test_docs_snippets.py)

clean:
	rm -rf .venv build dist
