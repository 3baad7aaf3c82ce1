# Two commands for a newcomer: `make study` and `make test`. Each sets up a .venv in this folder by itself.
PYTHON ?= python3
# -P keeps the source folder off the import path, so that everything runs on the installed package.
VENV_PYTHON := .venv/bin/python -P
SOURCES := $(shell find sumo_hmdp networks scenarios -type f -not -name '*.pyc')
OUT ?= results

.PHONY: help setup study test check docs browser paper bench bench-traffic lock clean

help: ## list the targets
	@grep -hE '^[a-z-]+:.*##' Makefile | sed -E 's/:[^#]*## /\t/' | expand -t 12

setup: .venv/.package ## make .venv and install the package with its pinned dependencies

.venv/.dependencies: pyproject.toml constraints.txt
	@echo "setting up .venv (once, about two minutes)"
	@$(PYTHON) -m venv .venv
	@$(VENV_PYTHON) -m pip install --quiet --disable-pip-version-check -c constraints.txt hatchling
	@# The project's own metadata names what to install; the package itself follows below.
	@mkdir -p .venv/empty/sumo_hmdp .venv/empty/networks .venv/empty/scenarios
	@cp pyproject.toml README.md LICENSE .venv/empty/ && touch .venv/empty/sumo_hmdp/__init__.py
	@$(VENV_PYTHON) -m pip install --quiet --disable-pip-version-check -c constraints.txt --no-build-isolation '.venv/empty/[test]'
	@touch $@

.venv/.package: .venv/.dependencies $(SOURCES) README.md
	@$(VENV_PYTHON) -m pip install --quiet --disable-pip-version-check --no-deps --force-reinstall --no-build-isolation .
	@touch $@

study: setup ## the main job: Case 2 in SUMO with its replay, then a small study in random traffic with its report, in results/
	.venv/bin/sumo-hmdp run case2 --out $(OUT)
	.venv/bin/sumo-hmdp study main --out $(OUT)/main
	.venv/bin/sumo-hmdp report $(OUT)/main

check: setup ## the fast part of the tests: format, lint, types, import rules
	$(VENV_PYTHON) -m ruff format --check sumo_hmdp tests analysis docs
	$(VENV_PYTHON) -m ruff check sumo_hmdp tests analysis docs
	$(VENV_PYTHON) -m mypy
	.venv/bin/lint-imports

.venv/.docs: .venv/.dependencies
	@$(VENV_PYTHON) -m pip install --quiet --disable-pip-version-check -c constraints.txt --no-build-isolation '.[docs]'
	@touch $@

docs: .venv/.docs setup ## the documentation as a site in site/; broken links and missing pages are errors
	$(VENV_PYTHON) -m sphinx -q -E -W --keep-going -d .venv/doctrees docs site

browser: # pages are tested in a real browser; where a container lacks one, Debian's is installed
	@command -v chromium chromium-browser google-chrome >/dev/null || { \
	  [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null && \
	  apt-get update -qq && apt-get install -y -qq --no-install-recommends chromium >/dev/null; \
	} || echo "no Chromium or Chrome here: the tests of pages will be skipped"

test: check docs browser ## everything that must hold: check, the site, then all tests on the installed package with coverage
	$(VENV_PYTHON) -m coverage erase
	$(VENV_PYTHON) -m pytest -n 2 --dist worksteal --cov --cov-report=term

paper: setup ## every figure and claim of the paper from our runs, into docs/ (about a minute)
	$(VENV_PYTHON) analysis/01_paper_cases.py --figures docs/figures --page docs/reproduction.md

bench: setup ## decision times by horizon and vehicles, into docs/benchmarks.md (about a minute)
	$(VENV_PYTHON) analysis/04_decision_times.py > docs/benchmarks.md.partial
	mv docs/benchmarks.md.partial docs/benchmarks.md

bench-traffic: setup ## simulated seconds per second in traffic, and where the time goes, into docs/throughput.md (about two minutes)
	$(VENV_PYTHON) analysis/06_throughput.py > docs/throughput.md.partial
	mv docs/throughput.md.partial docs/throughput.md

lock: ## pin today's versions of all dependencies
	rm -rf .venv-lock && $(PYTHON) -m venv .venv-lock
	.venv-lock/bin/python -m pip install --quiet hatchling '.[test,docs]'
	.venv-lock/bin/python -m pip freeze --exclude sumo-hmdp > constraints.txt
	rm -rf .venv-lock

clean: ## remove what the other targets made
	rm -rf .venv build dist results site .coverage* .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
