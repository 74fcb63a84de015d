# `make demo` swings the arm, `make test` runs what a landing must pass, `make quick` a part of it in two minutes,
# `make prove` the long evidence. Each sets itself up in .venv.
PYTHON ?= python3
BIN := .venv/bin
SHELL := /bin/sh
# Tests start many Python processes; each would compile every module again.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: install demo test quick lint types imports unit unit-together unit-alone unit-quick coverage docs prove release clean

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

# Kernels and test modules, compiled once, before processes start that would each compile them. The tests themselves
# report a module that cannot be imported.
.venv/.compiled: .venv/.installed-dev $(wildcard softarm/simulator/*.py softarm/simulator/kernel/*.py)
	@echo "compiling the simulator and the tests (once after each change, about a minute) ..."
	@$(BIN)/python -m tools.kernels
	@$(BIN)/pytest --collect-only --quiet >/dev/null || true
	@touch $@

demo: install
	$(BIN)/softarm demo

# Everything that a landing must pass.
test: .venv/.compiled
	$(MAKE) --no-print-directory lint imports
	$(MAKE) --no-print-directory --jobs 2 types unit-together
	$(MAKE) --no-print-directory unit-alone

# The same without slow tests and tests that need the machine alone.
quick: .venv/.compiled
	$(MAKE) --no-print-directory lint imports
	$(MAKE) --no-print-directory --jobs 2 types unit-quick

lint:
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/python -m tools.prose

# Beside the tests, which leave a part of two cores idle; the first run takes a minute of one.
types:
	nice $(BIN)/mypy

imports:
	$(BIN)/lint-imports

unit:
	$(MAKE) --no-print-directory unit-together
	$(MAKE) --no-print-directory unit-alone

# A module's fixtures are made once. Three processes: tests wait for daemons and browsers, and with four those miss frames.
unit-together:
	$(BIN)/pytest -n 3 --dist loadscope --no-loadscope-reorder -m 'not realtime and not prove' $(COVER)

# Tests that assert deadlines, since two busy cores keep none.
unit-alone:
	$(BIN)/pytest -m 'realtime and not prove' $$(grep -rl --include='test_*.py' 'mark.realtime' tests) \
	    $(if $(COVER),$(COVER) --cov-append)

unit-quick:
	$(BIN)/pytest -n 3 --dist loadscope --no-loadscope-reorder -m 'not realtime and not slow and not prove'

# Share of the lines that the tests run, package by package.
coverage: .venv/.compiled
	$(MAKE) --no-print-directory unit COVER='--cov --cov-report='
	@for package in $$(cd softarm && ls -d */); do \
	    echo "$$package $$($(BIN)/coverage report --format=total --include="softarm/$$package*") %"; \
	done; echo "total $$($(BIN)/coverage report --format=total) %"

# The pages as a site in site/: open site/index.html.
docs: .venv/.installed-dev
	$(BIN)/mkdocs build --quiet

# The long evidence, about an hour on two quiet cores. Every part runs although one fails, and prints its time;
# `make prove-fuzz` runs one part. docs/evidence/proof.md has the sizes for a release, which are stored.
ADVERSARY_TICKS ?= 6000000
MUTANTS ?= --sample 40
FUZZ_MINUTES ?= 15
API_EXAMPLES ?= 100
SOAK_HOURS ?= 0.3
LOCKSTEP_DAYS ?= 0.5
RESULTS ?= build/prove

prove_tests = $(BIN)/pytest -m 'prove and not realtime' --timeout 900 -n 2 --dist loadscope --no-loadscope-reorder
prove_realtime = $(BIN)/pytest -m 'prove and realtime'
prove_adversary = $(BIN)/python -m validation.adversary --ticks $(ADVERSARY_TICKS) --json $(RESULTS)/adversary.json
prove_adversary-tick = $(BIN)/python -m validation.adversary --ticks $$(( $(ADVERSARY_TICKS) / 20 )) --through tick \
    --json $(RESULTS)/adversary-tick.json
prove_matrix = $(BIN)/python -m validation.matrix --json $(RESULTS)/matrix.json
prove_mutants = $(BIN)/python -m validation.mutants $(MUTANTS)
prove_fuzz = $(BIN)/python -m validation.fuzz --minutes $(FUZZ_MINUTES)
prove_api = $(BIN)/python -m validation.api --examples $(API_EXAMPLES)
prove_soak = $(BIN)/python -m validation.soak --hours $(SOAK_HOURS) --lockstep-days $(LOCKSTEP_DAYS) --allow-undecided
PROVE := tests realtime adversary adversary-tick matrix mutants fuzz api soak

.PHONY: $(PROVE:%=prove-%)
prove: .venv/.compiled
	@$(MAKE) --no-print-directory --keep-going --jobs 1 $(PROVE:%=prove-%)

$(PROVE:%=prove-%): prove-%: .venv/.compiled
	@mkdir -p $(RESULTS)
	@begun=$$(date +%s); echo "$(prove_$*)"; $(prove_$*); code=$$?; \
	    echo "$@: $$(( $$(date +%s) - begun )) s, exit code $$code"; exit $$code

# Build and tag the version. Refuses while a stored result is older than its code.
release: .venv/.installed-dev
	$(BIN)/python -m benchmarks.results --check
	$(BIN)/python -m build --outdir dist
	git tag "v$$($(BIN)/python -c 'import softarm; print(softarm.__version__)')"

clean:
	rm -rf .venv build *.egg-info .coverage
