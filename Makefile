# The first call of any target sets up .venv from the pinned requirements: what plans a print, and besides that,
# where a target needs it, what tests do.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
PROBLEM ?= cylinder_logo
# One worker more than there are cores: some tests wait for servers and browsers. Each worker holds about 1 GB.
WORKERS := $(shell expr $$(nproc 2>/dev/null || echo 2) + 1)
PARALLEL := -n $(WORKERS) --maxprocesses 8 --dist loadfile --no-loadscope-reorder
BIN := .venv/bin
READY := .venv/.ready
TESTS := .venv/.ready-test
DOCS := .venv-docs
PEERS := .venv-peers
THIRD := .venv-third-party
FLOORS := .venv-floors
ADVISORIES := .venv-advisories
PIP_INSTALL := pip install --quiet --disable-pip-version-check

.PHONY: solve test test-all test-floors lint format notebooks docs docs-serve peers third-party attack \
    requirements licences advisories clean

solve: $(READY)
	$(BIN)/python -m planner.solve $(PROBLEM)

# SLICE=3/32 adds a part of the slow tests, as continuous integration does.
test: $(TESTS)
	$(BIN)/python -m pytest $(PARALLEL) $(if $(SLICE),--slice $(SLICE))

test-all: $(TESTS)
	$(BIN)/python -m pytest $(PARALLEL) --all-tests

# The same with the oldest releases that pyproject.toml allows, in an environment of their own.
test-floors: $(FLOORS)/.ready
	$(FLOORS)/bin/python -m pytest $(PARALLEL)

lint: $(TESTS)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(TESTS)
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

# The notebooks, in a browser.
notebooks: $(READY) .venv/.ready-notebooks
	$(BIN)/jupyter lab notebooks

# The site, in site/; open site/index.html. Its packages have an environment of their own.
# On http://127.0.0.1:8000 the search works, too, and pages follow their files: make docs-serve
docs: $(DOCS)/.ready
	NO_MKDOCS_2_WARNING=1 $(DOCS)/bin/mkdocs build --quiet

docs-serve: $(DOCS)/.ready
	NO_MKDOCS_2_WARNING=1 $(DOCS)/bin/mkdocs serve

# The same waypoints through other planners, which have an environment of their own; a table, and out/peers.
peers: $(TESTS) $(PEERS)/.ready
	$(BIN)/python -m benchmarks.peers --python $(PEERS)/bin/python

# Written programs through parsers and interpreters of other people; docs/third_party.md names Debian's packages.
third-party: $(TESTS) $(THIRD)/.ready
	$(BIN)/python -m benchmarks.third_party --python $(THIRD)/bin/python

# Writes requirements.txt and requirements-test.txt anew from what is installed; for whoever changes a version.
requirements: $(TESTS)
	$(BIN)/python -m benchmarks.dependencies locks

# Writes docs/licences.md anew, for whoever changes a lock file.
licences: $(TESTS)
	$(BIN)/python -m benchmarks.dependencies licences

# Versions in lock files that have known advisories, where the package index is reached; docs/licences.md has the exit
# codes (make's own is 2 for any of them). LOCKS="requirements-docs.txt" looks at others.
advisories: $(TESTS) $(ADVISORIES)/.ready
	$(BIN)/python -m benchmarks.dependencies advisories --audit $(ADVISORIES)/bin/pip-audit $(LOCKS)

# Problems, files, motions, programs and runs, spoilt or killed at random: what is not found escapes.
attack: $(TESTS)
	$(BIN)/python -m benchmarks.attack

clean:
	rm -rf .venv $(DOCS) $(PEERS) $(THIRD) $(FLOORS) $(ADVISORIES) out site

$(READY): requirements.txt pyproject.toml
	$(PYTHON) -m venv .venv
	$(BIN)/$(PIP_INSTALL) --requirement requirements.txt
	$(BIN)/$(PIP_INSTALL) --no-deps --no-build-isolation --editable .
	touch $@

# On top of that, in the same environment.
.venv/.ready-%: requirements-%.txt $(READY)
	$(BIN)/$(PIP_INSTALL) --requirement $<
	touch $@

# Environments of their own.
.venv-%/.ready: requirements-%.txt
	$(PYTHON) -m venv $(@D)
	$(@D)/bin/$(PIP_INSTALL) --requirement $<
	touch $@

$(FLOORS)/.ready: pyproject.toml
	$(PYTHON) -m venv $(FLOORS)
	$(PYTHON) -c "import tomllib; print(*(each.replace('>=', '==') for each in \
	    tomllib.load(open('pyproject.toml', 'rb'))['project']['dependencies']), sep='\n')" > $(FLOORS)/floors.txt
	$(FLOORS)/bin/$(PIP_INSTALL) --constraint $(FLOORS)/floors.txt --editable ".[test]"
	touch $@
