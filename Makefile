# Needs Python 3.11 (or later, PYTHON=...), gcc, make and git. Everything else is installed into .venv, in locked versions.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile
# pip would compile to bytecode on one core; a few files of other packages are no Python of this version
BYTECODE := $(BIN)/python -m compileall -qq -j 0 $(VENV)
READY := $(VENV)/.ready
OUT ?= results
STUDIES ?= build/studies
BENCH ?=
SCOREBOARD ?= --quick
EVIDENCE := build/evidence.json

TESTS := $(BIN)/python -m pytest --evidence=$(EVIDENCE)
# as many workers as cores, four at most: threads of the linear algebra would only stand in their way
SPREAD := --numprocesses auto --maxprocesses 4 --dist worksteal
# a test that takes longer than its claim is worth is seen here
SLOWEST := --durations=25 --durations-min=4

.PHONY: help install reproduce test quick test-all test-slow docs bench studies scoreboard validate-real long bounds-checked other-pythons gallery lint contracts style types lock clean

help:
	@echo "make install     sunspin with all that it needs into $(VENV)/; then: . $(VENV)/bin/activate"
	@echo "make reproduce   the whole Philae study into $(OUT)/ (environment built on first use)"
	@echo "make test        import contracts, lint, types, tests and documentation"
	@echo "make test-all    make test, the tests marked long, a smoke test on other versions of Python"
	@echo "make test-slow   the campaigns marked slow"
	@echo "make docs        the documentation into build/site/, with what the last tests have shown"
	@echo "make bench       speed against other software, about 6 minutes (make bench BENCH=--quick: one; decisions: docs/records/bench.md)"
	@echo "make studies     the studies of the paper, into $(STUDIES)/, about 15 minutes (docs/studies.md)"
	@echo "make scoreboard  what must not get worse, case by case (make scoreboard SCOREBOARD='--full --against FILE'); resumable"
	@echo "make validate-real  rates of real satellites against a sensor not used, into build/real-data.md; needs SUNSPIN_DATA (docs/data.md)"
	@echo "make lock        write requirements.lock anew from pyproject.toml"
	@echo "make clean       remove the environment and built files"

# Built once, and anew when the locked versions or pyproject.toml change. Nothing is resolved or fetched beyond the lock: the
# build backend is in it too.
$(READY): requirements.lock pyproject.toml
	@test -n "$(PYTHON)" || { echo "sunspin needs Python 3.11 or later and found none; run make PYTHON=/path/to/python3.11" >&2; exit 1; }
	@"$(PYTHON)" -c 'import sys; sys.exit(0 if sys.version_info >= (3, 11) else "sunspin needs Python 3.11 or later, this is " + sys.version.split()[0] + "; run make PYTHON=/path/to/python3.11")'
	@"$(PYTHON)" -c 'import ensurepip, venv' 2>/dev/null || { echo "$(PYTHON) cannot make environments; install its venv package (python3.11-venv)" >&2; exit 1; }
	"$(PYTHON)" -m venv --clear $(VENV)
	$(PIP) -r requirements.lock
	@$(BYTECODE) || true
	$(PIP) --no-deps --no-build-isolation --editable .
	@$(BIN)/python -m sunspin.dynamics || echo "the first command will compile the integrators (half a minute)" >&2
	@touch $(READY)

install: $(READY)

reproduce: $(READY)
	$(BIN)/sunspin reproduce --out $(OUT)

lint: contracts style types

contracts: $(READY)
	$(BIN)/lint-imports --no-cache

style: $(READY)
	$(BIN)/ruff check --no-cache .
	$(BIN)/ruff format --no-cache --check --quiet .

types: $(READY)
	$(BIN)/ty check

quick long bounds-checked: export OPENBLAS_NUM_THREADS = 1
# each worker, and each program that a test starts, would compile all sources and rewrite all tests anew: a fifth of the time
unexport PYTHONDONTWRITEBYTECODE

# before the tests, whose processes would each compile the integrators; the documents last: one of their pages shows what the tests have reached
test: quick
	@$(MAKE) --no-print-directory docs

quick: $(READY)
	@$(MAKE) --no-print-directory -j2 --output-sync=target types contracts style
	$(BIN)/python -m sunspin.dynamics
	$(TESTS) $(SPREAD) $(SLOWEST)

# what waits for packages or computes on one core goes beside the long tests; the documents are made once, of all that was shown
test-all: quick
	@$(MAKE) --no-print-directory -j2 --output-sync=target long other-pythons bounds-checked gallery
	@$(MAKE) --no-print-directory docs

long: $(READY)
	$(TESTS) $(SPREAD) $(SLOWEST) -m "long and not slow"

# kernels that check each index, compiled into a cache of their own
bounds-checked: $(READY)
	NUMBA_BOUNDSCHECK=1 NUMBA_CACHE_DIR=build/bounds-checked $(BIN)/python -m pytest -q tests/dynamics/test_kernel.py tests/dynamics/test_split_kernel.py

# the pictures of the documents, which `make docs` draws too if they are missing
gallery: $(READY)
	PYTHONPATH=docs $(BIN)/python -c 'import site_parts as site; site.draw_gallery(site.HERE / "gallery")'

other-pythons: $(READY)
	$(BIN)/python tests/support/other_pythons.py

# adds what the campaigns show to what `make test` has shown
test-slow: $(READY)
	$(TESTS) -m slow
	@$(MAKE) --no-print-directory docs

# pages that were read before are not read again, nor their warnings given: after a failure all are
docs: $(READY)
	$(BIN)/python -m sphinx -j auto -W --keep-going -q -b html -D evidence_file=$(abspath $(EVIDENCE)) docs build/site \
	  || { rm -rf build/site/.doctrees; exit 1; }
	@echo "Documentation: build/site/index.html"

bench: $(READY)
	$(BIN)/python -m bench $(BENCH)

# the first resumes where it was stopped; the last needs third-party data; the other modules of studies/ have a --help
studies: $(READY)
	$(BIN)/python -m studies.coverage $(STUDIES)/coverage
	$(BIN)/python -m studies.contradictions $(STUDIES)/contradictions
	$(BIN)/python -m studies.components $(STUDIES)/components
	test -z "$$SUNSPIN_DATA" || $(BIN)/python -m studies.impulse $(STUDIES)/impulse

# goes on where it was stopped
scoreboard: $(READY)
	$(BIN)/python -m validation scoreboard $(SCOREBOARD)

# writes build/real-data.md; needs other people's data
validate-real: $(READY)
	$(BIN)/python -m validation real

lock:
	rm -rf .lock-env && "$(PYTHON)" -m venv .lock-env
	.lock-env/bin/python -m pip install --quiet --disable-pip-version-check ".[study,test,bench,parquet,spice,docs]" hatchling editables
	{ echo "# Exact versions for the make targets; written by make lock from the ranges in pyproject.toml."; \
	  .lock-env/bin/python -m pip freeze --exclude sunspin; } > requirements.lock.part
	mv requirements.lock.part requirements.lock
	rm -rf .lock-env

clean:
	rm -rf $(VENV) .lock-env build dist .pytest_cache .ruff_cache .import_linter_cache requirements.lock.part
