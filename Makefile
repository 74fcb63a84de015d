# `make demo` swings the arm, `make test` proves the house, `make quick` is for between two thoughts. Each sets itself up
# in .venv.
PYTHON ?= python3
BIN := .venv/bin
SHELL := /bin/sh

.PHONY: install demo test quick lint types imports unit unit-quick coverage docs prove clean

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

# All that a landing has to pass.
test: .venv/.installed-dev
	$(MAKE) --no-print-directory lint types imports unit

# The same without the tests that take long or want the machine for themselves: under a minute.
quick: .venv/.installed-dev
	$(MAKE) --no-print-directory lint types imports unit-quick

lint:
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types:
	$(BIN)/mypy

imports:
	$(BIN)/lint-imports

# Those with deadlines run last and alone: two cores that are busy with other tests keep none.
unit:
	$(BIN)/pytest -n 2 -m 'not realtime' $(COVER)
	$(BIN)/pytest -m realtime $(if $(COVER),$(COVER) --cov-append)

unit-quick:
	$(BIN)/pytest -n 2 -m 'not realtime and not slow'

# Which share of the lines the tests run, room by room; half as long again as the tests alone.
coverage: .venv/.installed-dev
	$(MAKE) --no-print-directory unit COVER='--cov --cov-report='
	@for room in $$(cd softarm && ls -d */ | grep -v benchmarks); do \
	    echo "$$room $$($(BIN)/coverage report --format=total --include="softarm/$$room*") %"; \
	done; echo "the house $$($(BIN)/coverage report --format=total) %"

# The pages as a site in site/: open site/index.html.
docs: .venv/.installed-dev
	$(BIN)/mkdocs build --quiet

# What is shown by trying for long, part by part: docs/proof.md. A small part of each is among the tests.
FUZZ_MINUTES ?= 60
SOAK_HOURS ?= 1
ADVERSARY_TICKS ?= 10000000
prove: .venv/.installed-dev
	$(BIN)/python -m softarm.benchmarks.adversary --ticks $(ADVERSARY_TICKS)
	$(BIN)/python -m softarm.benchmarks.adversary --ticks $$(( $(ADVERSARY_TICKS) / 20 )) --through tick
	$(BIN)/python -m softarm.benchmarks.matrix
	$(BIN)/python -m softarm.benchmarks.prove.mutants
	$(BIN)/python -m softarm.benchmarks.prove.fuzz --minutes $(FUZZ_MINUTES)
	$(BIN)/python -m softarm.benchmarks.prove.api
	$(BIN)/softarm soak --hours $(SOAK_HOURS) --lockstep-days 1

clean:
	rm -rf .venv build *.egg-info .coverage
