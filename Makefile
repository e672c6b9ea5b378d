# Facadelake: `make demo` on a fresh Debian 12 or Ubuntu with git, make, ca-certificates and python3 >= 3.11.

SHELL := /bin/bash
.DEFAULT_GOAL := help
PYTHON3 ?= python3
# Two at a time, a file at a time (files share what is dear to make), in their order: the dear ones come early.
PYTEST_ARGS ?= -n 2 --dist loadfile --no-loadscope-reorder
BIN := .venv/bin
STAMP := .venv/.setup-done

# The interpreter is the one that is there; none is downloaded.
export UV_PYTHON_DOWNLOADS := never
# An environment that happens to be active is not ours.
unexport VIRTUAL_ENV

# A virtual environment whose Python is gone (an upgraded system, a moved checkout) is made anew.
ifneq ($(wildcard $(STAMP)),)
ifneq ($(shell $(BIN)/python -c 'import facadelake, flows; print("ok")' 2>/dev/null),ok)
$(shell rm -f $(STAMP))
endif
endif

.PHONY: help setup demo up test lint format types directions unused doctor clean distclean

help:  ## list the targets
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## (.*)/  make \1|\2/' | column -t -s '|' 2>/dev/null \
	  || grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST)

setup: $(STAMP)  ## install all that Facadelake needs into .venv (and, as root, missing system libraries)

$(STAMP): pyproject.toml uv.lock scripts/bootstrap.py scripts/uv-requirements.txt facadelake/core/system_libraries.py
	@$(PYTHON3) scripts/bootstrap.py
	@.tools/bin/uv sync --locked
	@touch $@

demo: setup  ## generate the demo building, inspect its four campaigns and show the defects
	@$(BIN)/facadelake demo

up: setup  ## start the service: Prefect's page, a worker, the schedules and the intake (stop: facadelake down)
	@$(BIN)/facadelake up

test: setup  ## run all tests; choose with PYTEST_ARGS="tests/unit -k geodesy"
	$(BIN)/python -m pytest $(PYTEST_ARGS)

lint: format types directions unused  ## check style, types, the direction of imports and unused code

format: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: setup
	$(BIN)/mypy --strict

directions: setup
	$(BIN)/lint-imports --no-logo

unused: setup
	$(BIN)/vulture

doctor: setup  ## say what is missing on this machine, and how to get it
	@$(BIN)/facadelake doctor

clean:  ## remove what can be made again: build/ and caches (a lake stays)
	rm -rf build .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache

distclean: clean  ## remove the environment too
	rm -rf .venv .tools
