# The first call of any target sets up .venv from the pinned requirements.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
PROBLEM ?= cylinder_logo
BIN := .venv/bin
READY := .venv/.ready

.PHONY: solve test lint format requirements clean

solve: $(READY)
	$(BIN)/python -m planner.solve $(PROBLEM)

test: $(READY)
	$(BIN)/python -m pytest -n 2

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(READY)
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

# Writes requirements.txt anew from what is installed; for whoever changes a version in pyproject.toml.
requirements: $(READY)
	$(BIN)/pip freeze --exclude-editable > requirements.txt

clean:
	rm -rf .venv out

$(READY): requirements.txt pyproject.toml
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check --requirement requirements.txt
	$(BIN)/pip install --quiet --disable-pip-version-check --no-deps --editable .
	touch $(READY)
