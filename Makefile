# Two commands: `make demo` swings the arm, `make test` proves the house. Each sets itself up in .venv.
PYTHON ?= python3
BIN := .venv/bin
SHELL := /bin/sh

.PHONY: install demo test lint types imports unit clean

install: .venv/.installed

.venv/.installed: pyproject.toml
	@echo "setting up .venv (once, about half a minute) ..."
	@test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[sim]'
	@touch $@

.venv/.installed-dev: .venv/.installed
	@echo "adding what the tests need (once, a minute or more) ..."
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $@

demo: install
	$(BIN)/softarm demo

test: .venv/.installed-dev
	$(MAKE) --no-print-directory lint types imports unit

lint:
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types:
	$(BIN)/mypy

imports:
	$(BIN)/lint-imports

unit:
	$(BIN)/pytest -n 2

clean:
	rm -rf .venv build *.egg-info
