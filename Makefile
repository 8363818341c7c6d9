# The first call of any target sets up .venv from the pinned requirements.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
PROBLEM ?= cylinder_logo
PARALLEL := -n 2 --dist loadfile --no-loadscope-reorder
BIN := .venv/bin
READY := .venv/.ready
DOCS := .venv-docs
PEERS := .venv-peers
THIRD := .venv-third-party
FLOORS := .venv-floors

.PHONY: solve test test-all test-floors lint format docs docs-serve peers third-party attack requirements clean

solve: $(READY)
	$(BIN)/python -m planner.solve $(PROBLEM)

# SLICE=3/8 adds a part of the slow tests, as continuous integration does.
test: $(READY)
	$(BIN)/python -m pytest $(PARALLEL) $(if $(SLICE),--slice $(SLICE))

test-all: $(READY)
	$(BIN)/python -m pytest $(PARALLEL) --all-tests

# The same with the oldest releases that pyproject.toml allows, in an environment of their own.
test-floors: $(FLOORS)/.ready
	$(FLOORS)/bin/python -m pytest $(PARALLEL)

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(READY)
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

# The site, in site/; open site/index.html. Its packages have an environment of their own.
# On http://127.0.0.1:8000 the search works, too, and pages follow their files: make docs-serve
docs: $(DOCS)/.ready
	NO_MKDOCS_2_WARNING=1 $(DOCS)/bin/mkdocs build --quiet

docs-serve: $(DOCS)/.ready
	NO_MKDOCS_2_WARNING=1 $(DOCS)/bin/mkdocs serve

# The same waypoints through other planners, which have an environment of their own; a table, and out/peers.
peers: $(READY) $(PEERS)/.ready
	$(BIN)/python -m benchmarks.peers --python $(PEERS)/bin/python

# Written programs through parsers and interpreters of other people; docs/third_party.md names Debian's packages.
third-party: $(READY) $(THIRD)/.ready
	$(BIN)/python -m benchmarks.third_party --python $(THIRD)/bin/python

# Writes requirements.txt anew from what is installed; for whoever changes a version in pyproject.toml.
requirements: $(READY)
	$(BIN)/pip freeze --exclude-editable > requirements.txt

# Problems, files, motions, programs and runs, spoilt or killed at random: what is not found escapes.
attack: $(READY)
	$(BIN)/python -m benchmarks.attack

clean:
	rm -rf .venv $(DOCS) $(PEERS) $(THIRD) $(FLOORS) out site

$(READY): requirements.txt pyproject.toml
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check --requirement requirements.txt
	$(BIN)/pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	touch $(READY)

$(DOCS)/.ready: requirements-docs.txt
	$(PYTHON) -m venv $(DOCS)
	$(DOCS)/bin/pip install --quiet --disable-pip-version-check --requirement requirements-docs.txt
	touch $@

$(PEERS)/.ready: requirements-peers.txt
	$(PYTHON) -m venv $(PEERS)
	$(PEERS)/bin/pip install --quiet --disable-pip-version-check --requirement requirements-peers.txt
	touch $@

$(THIRD)/.ready: requirements-third-party.txt
	$(PYTHON) -m venv $(THIRD)
	$(THIRD)/bin/pip install --quiet --disable-pip-version-check --requirement requirements-third-party.txt
	touch $@

$(FLOORS)/.ready: pyproject.toml
	$(PYTHON) -m venv $(FLOORS)
	$(PYTHON) -c "import tomllib; print(*(each.replace('>=', '==') for each in \
	    tomllib.load(open('pyproject.toml', 'rb'))['project']['dependencies']), sep='\n')" > $(FLOORS)/floors.txt
	$(FLOORS)/bin/pip install --quiet --disable-pip-version-check --constraint $(FLOORS)/floors.txt --editable ".[test]"
	touch $@
