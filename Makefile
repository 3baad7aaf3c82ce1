# Two commands for a newcomer: `make study` and `make test`. Each sets up a .venv in this folder by itself.
PYTHON ?= python3
# -P keeps the source folder off the import path, so that everything runs on the installed package.
VENV_PYTHON := .venv/bin/python -P
SOURCES := $(shell find sumo_hmdp networks scenarios -type f -not -name '*.pyc')
OUT ?= results

.PHONY: help setup study test check lock clean

help: ## list the targets
	@grep -hE '^[a-z-]+:.*##' Makefile | sed -E 's/:[^#]*## /\t/' | expand -t 12

setup: .venv/.package ## make .venv and install the package with its pinned dependencies

.venv/.dependencies: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(VENV_PYTHON) -m pip install --quiet --disable-pip-version-check -c constraints.txt hatchling
	# The project's own metadata names what to install; the package itself follows below.
	mkdir -p .venv/empty/sumo_hmdp .venv/empty/networks .venv/empty/scenarios
	cp pyproject.toml README.md LICENSE .venv/empty/ && touch .venv/empty/sumo_hmdp/__init__.py
	$(VENV_PYTHON) -m pip install --quiet --disable-pip-version-check -c constraints.txt --no-build-isolation '.venv/empty/[test]'
	touch $@

.venv/.package: .venv/.dependencies $(SOURCES) README.md
	$(VENV_PYTHON) -m pip install --quiet --disable-pip-version-check --no-deps --force-reinstall --no-build-isolation .
	touch $@

study: setup ## the main job: Case 2 in SUMO, with tables and a replay page in results/
	.venv/bin/sumo-hmdp run case2 --out $(OUT)

check: setup ## the fast part of the tests: format, lint, types, import rules
	$(VENV_PYTHON) -m ruff format --check sumo_hmdp tests analysis
	$(VENV_PYTHON) -m ruff check sumo_hmdp tests analysis
	$(VENV_PYTHON) -m mypy
	.venv/bin/lint-imports

test: check ## everything that must hold: check, then all tests on the installed package with coverage
	$(VENV_PYTHON) -m coverage erase
	$(VENV_PYTHON) -m pytest -n 2 --cov --cov-report=term

lock: ## pin today's versions of all dependencies
	rm -rf .venv-lock && $(PYTHON) -m venv .venv-lock
	.venv-lock/bin/python -m pip install --quiet hatchling '.[test]'
	.venv-lock/bin/python -m pip freeze --exclude sumo-hmdp > constraints.txt
	rm -rf .venv-lock

clean: ## remove what the other targets made
	rm -rf .venv build dist results .coverage* .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
