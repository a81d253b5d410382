# Everything here runs from a fresh checkout: each target first sets up what it needs (scripts/setup.sh).
SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DEFAULT_GOAL := help
.NOTPARALLEL:
.PHONY: help setup demo test test-all fuzz lint types docs docs-format docs-pictures docs-architecture samples clean

# Compiled modules are kept: a process that has to compile hundreds of files starts a second later.
unexport PYTHONDONTWRITEBYTECODE

BIN := .venv/bin
# The demo's commands run inside demo/.
KINECTBENCH := ../$(BIN)/kinectbench

help: ## this list
	@grep -E '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## /make \1\t/' | expand -t 20

setup: ## install what is needed: system libraries, .venv, pinned packages
	@scripts/setup.sh

demo: setup ## a whole benchmark from a real and simulated recordings: build, publish, predict, score, report (two minutes)
	@echo "demo: writing a further small simulated recording to demo/recordings"
	@$(BIN)/kinectbench simulate --demo demo/recordings
	@cd demo && echo "demo: building the pairs, publishing them, and checking the release" && \
	  $(KINECTBENCH) build --jobs 2 && $(KINECTBENCH) publish && $(KINECTBENCH) verify
	@cd demo && echo "demo: completing every view by a small network that comes trained" && \
	  $(KINECTBENCH) predict recae-small benchmark
	@cd demo && echo "demo: scoring it, and simple methods beside it" && $(KINECTBENCH) score predictions --no-surface

test: setup lint types docs ## the checks of each change: ruff, mypy, the documentation's links, pytest
	@$(BIN)/pytest -n 2 -m "not slow"

test-all: setup lint types docs ## the same with further cases of the same promises
	@$(BIN)/pytest -n 2

MINUTES ?= 20
fuzz: setup ## damage recordings, releases, predictions and tables at random, 20 minutes each, two at a time
	@printf '%s\n' recordings releases predictions tables | \
	  xargs -P 2 -I{} $(BIN)/python tests/robustness/fuzzing.py {} --minutes $(MINUTES)

lint: setup ## style, formatting, and which room of the package imports which
	@$(BIN)/ruff check
	@$(BIN)/ruff format --check
	@$(BIN)/lint-imports --cache-dir .import_linter_cache

types: setup ## static types
	@$(BIN)/mypy

docs: setup ## the documentation as a site, in site/; a broken link or anchor is an error
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --clean
	@echo "docs: site/index.html"

docs-pictures: setup ## make the tutorial's pictures and outputs again, of one run (simulated; some minutes; needs chromium)
	@$(BIN)/python scripts/docs_pictures.py

docs-format: setup ## write the schemas, docs/keys.md and docs/errors.md again
	@$(BIN)/python scripts/docs_schemas.py
	@$(BIN)/python scripts/docs_format.py
	@$(BIN)/python scripts/docs_errors.py

docs-architecture: setup ## draw the rooms of the package and list the stored files in docs/architecture.md again
	@$(BIN)/python scripts/docs_architecture.py

samples: setup ## write the sample recordings again (simulated, same bytes)
	@$(BIN)/kinectbench simulate --samples recordings

clean: ## remove .venv, caches and everything built
	rm -rf .venv .mypy_cache .pytest_cache .ruff_cache .hypothesis .import_linter_cache kinectbench.egg-info
	rm -rf build benchmark benchmark-private predictions scores site
	rm -rf demo/recordings demo/build demo/benchmark demo/predictions demo/scores
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
