# make demo   sets up and runs the main job on the virtual rig
# make test   sets up and runs everything that must hold
# Needs Debian's python3 (3.11 or later) with python3-venv, and make; nothing else.

PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
SEED   ?= 1
# one more than there are cores: some tests wait for simulated devices, terminals and browsers; every worker collects
# all tests and reads all kernels
WORKERS ?= $(shell expr $$(getconf _NPROCESSORS_ONLN) + 1)

# Bytecode is kept: otherwise each of the tests' processes would compile the package and all tests for itself.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test test-all fast rewritten soak statistics evidence figures types lint contracts tree quick docs docs-check benchmark benchmark-record lock clean help

help:
	@echo "make demo       inspect three parts on the virtual rig; reports in demo-output/"
	@echo "make test       formatting, lint, types, import contracts, links of the docs, tests"
	@echo "make quick      one module and its tests, in seconds: FILE=inspect/decision/decision.py"
	@echo "make docs       the docs as a site; open site/index.html"
	@echo "make test-all   the same, then the fast tests on Python 3.12 and 3.13"
	@echo "make soak       the long test campaigns"
	@echo "make statistics rates over many draws: coverage, false alarms, power of the studies"
	@echo "make evidence   the detection study (docs/detection.md); options of it in STUDY"
	@echo "make figures    figures of light and design against their judges (docs/evidence/reflectance.md)"
	@echo "make benchmark  speed against named alternatives"
	@echo "make clean      remove what make made"

# The demo waits for its own kernels only; the others are compiled behind it.
demo: $(VENV)/.warm-demo
	$(BIN)/anisoscope demo --out demo-output --seed $(SEED)
	@test -e $(VENV)/.warm || { echo "Compiling the kernels of the other commands in the background, about a minute."; \
	  (nohup nice $(BIN)/anisoscope warm --quiet && touch $(VENV)/.warm) >/dev/null 2>&1 </dev/null & \
	  echo $$! >$(VENV)/.warming; }

test: $(VENV)/.warm rewritten lint contracts types docs-check
	@while kill -0 $$(cat $(VENV)/.rewriting) 2>/dev/null; do sleep 1; done
	$(BIN)/python -Im pytest -n $(WORKERS) --dist worksteal

# The tests without commands and pages, on the other versions of Python: PYTHONS="python3.12 /opt/py/bin/python3.13".
PYTHONS ?= python3.12 python3.13
test-all: test
	@for python in $(PYTHONS); do \
	  $(MAKE) fast PYTHON=$$python VENV=.venv-$$(basename $$python) || exit 1; \
	done

fast: $(VENV)/.dev
	$(BIN)/python -Im pytest -n $(WORKERS) --dist worksteal tests/profiles tests/rig tests/sim

# The long campaigns: hundreds of seeds, thousands of damaged files.
soak: $(VENV)/.dev
	$(BIN)/python -Im pytest -n $(WORKERS) --dist worksteal -m soak

# Rates over many draws or parts; each has a test of a few fixed draws in make test.
statistics: $(VENV)/.dev
	$(BIN)/python -Im pytest -n $(WORKERS) --dist worksteal -m statistics

# How often good parts fail and bad ones pass, on virtual rigs: docs/detection.md. make evidence STUDY="--world ggx --rigs 4"
STUDY ?= --world same --rigs 2
evidence: $(VENV)/.dev
	$(BIN)/python tests/evidence/detection.py $(STUDY)

# Light and design against their judges: docs/evidence/reflectance.md. Rows of judges that are not installed stay.
figures: $(VENV)/.dev
	ANISOSCOPE_WRITE_DOCS=1 $(BIN)/python -Im pytest -m figures $$(grep -rlw --include='test_*.py' judged_figure tests)

# One process rewrites the assertions of all tests while types are checked; otherwise each worker does it for itself.
rewritten: $(VENV)/.dev
	@$(BIN)/python -Im pytest --collect-only -q >/dev/null 2>&1 & echo $$! >$(VENV)/.rewriting

lint: $(VENV)/.dev
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .

# One module and the tests that mirror it, in seconds: make quick FILE=inspect/decision/decision.py
MIRROR = tests/$(dir $(FILE))test_$(basename $(notdir $(FILE)))
TESTS ?= $(wildcard $(if $(filter tests/%,$(FILE)),$(FILE),$(MIRROR).py $(MIRROR)_*.py))
quick: $(VENV)/.dev
	@test -f "$(FILE)" || { echo "quick: no file '$(FILE)'; say FILE=inspect/decision/decision.py" >&2; exit 1; }
	@$(BIN)/ruff format --check --quiet --diff $(FILE) && $(BIN)/ruff check --quiet $(FILE)
	@test -n "$(TESTS)" || { echo "quick: no test mirrors $(FILE): write $(MIRROR).py, or say TESTS=tests/..." >&2; exit 1; }
	$(BIN)/python -Im pytest -q $(TESTS)

# What checks without importing finds the packages where links lay them as a wheel does (docs/decisions/0037). Links of
# folders show it new modules at once; a new package gets its link here, and a link that leads nowhere goes.
tree:
	@mkdir -p build/tree/anisoscope && find build/tree -ignore_readdir_race -xtype l -delete
	@for entry in $(filter-out %/__pycache__,$(wildcard inspect/*)) rig profiles sim; do \
	  test -e build/tree/anisoscope/$${entry##*/} || ln -sfn ../../../$$entry build/tree/anisoscope/; \
	done

contracts: $(VENV)/.dev tree
	PYTHONPATH=build/tree $(BIN)/lint-imports

types: $(VENV)/.dev tree
	$(BIN)/mypy -p anisoscope -p detection_study -m detection

# The docs as a site. Every warning is an error: missing links, anchors, pictures, pages without a place in the navigation.
SPHINX = $(BIN)/python -Im sphinx -W --keep-going -q -d site/.doctrees
docs: $(VENV)/.dev
	$(SPHINX) -b html docs site

# The same checks without writing a page.
docs-check: $(VENV)/.dev
	$(SPHINX) -b dummy docs site

# Printed results and pictures of the pages, from what makes them; a test compares them with today's.
docs-outputs: $(VENV)/.warm
	$(BIN)/python -I tools/docs_outputs.py

benchmark: $(VENV)/.dev
	# prysm is built from source; without PEP 517 its setup reads the environment and fails
	$(BIN)/pip install --quiet --disable-pip-version-check --use-pep517 -e '.[benchmark]'
	ANISOSCOPE_BENCHMARK_RESULTS=$(CURDIR)/.benchmarks/latest.json $(BIN)/python -Im pytest tests/benchmarks -s -m benchmark
	$(BIN)/python tools/benchmark_page.py compare .benchmarks/latest.json

# Adds the last run of `make benchmark` to the trend and writes its page.
benchmark-record:
	$(BIN)/python tools/benchmark_page.py record .benchmarks/latest.json

$(VENV)/.venv:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "anisoscope needs Python 3.11 or later; $(PYTHON) is $$($(PYTHON) --version 2>&1). Set PYTHON=..." >&2; exit 1; }
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || \
	  { echo "Python's venv module is missing: apt-get install python3-venv" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)
	@touch $@

$(VENV)/.run: $(VENV)/.venv requirements.lock pyproject.toml setup.py
	@echo "Installing packages into $(VENV) (1.6 GB on disk, about a minute) ..."
	$(BIN)/pip install --quiet --disable-pip-version-check --no-compile -r requirements.lock
	rm -rf anisoscope.egg-info # of an earlier build: its list of plug-ins would count in this folder
	$(BIN)/pip install --quiet --disable-pip-version-check --no-deps -e .
	@touch $@

$(VENV)/.warm-demo: $(VENV)/.run
	$(BIN)/anisoscope warm --demo
	@touch $@

# Where `make demo` still compiles in the background, it is waited for.
$(VENV)/.warm: $(VENV)/.run
	@while test -e $(VENV)/.warming && kill -0 $$(cat $(VENV)/.warming) 2>/dev/null; do sleep 1; done
	@test -e $@ || $(BIN)/anisoscope warm
	@touch $@

$(VENV)/.dev: $(VENV)/.run requirements-dev.lock
	$(BIN)/pip install --quiet --disable-pip-version-check --no-compile -r requirements-dev.lock
	@touch $@

# Resolves the newest versions within the ranges of pyproject.toml, in environments of their own.
lock:
	sh tools/lock.sh $(PYTHON)

clean:
	rm -rf $(VENV) build dist site docs/reference *.egg-info demo-output .*_cache* .hypothesis
