# Needs Python >= 3.11 and make, nothing else: every target creates .venv and installs what it needs, once.

PYTHON ?= python3
BIN := .venv/bin
PRODUCT := .venv/.product
READY := .venv/.ready

unexport PYTHONDONTWRITEBYTECODE  # else every process that a test starts compiles the same modules again

FUZZ ?=  # more words for the fuzzing, as: make fuzz FUZZ_CASES=100 FUZZ='--hypothesis-seed 7 -k trace'
FUZZ_CASES ?= 600

SOAK ?=  # more words for the soak, as: make soak SOAK="--seed 7 --minutes 30"

BENCH ?=  # more words for the benchmarks, as: make bench BENCH="--only wire service"

PART ?=  # of the second tier, as: make test-long PART=3

PYTEST := $(BIN)/python -m pytest -n 3 --dist worksteal  # two cores; a test often waits
TIER = $(PYTEST) --durations 20 --tier 1 $(if $(PART),--part $(PART))
GUEST := VCAN_OPTIONAL=1 VCAN_TIMEOUT=1800 tests/vcan/run $(BIN)/python -m pytest --vcan --color=no tests/vcan tests/contract
NODES := $(BIN)/python -m tests.node_canopen.install  # the guest has no network
TESTS := test-computing test-machines test-vcan
CHECKS := check-tests-types check-types check-style check-arrows check-habits

MUTANTS ?=  # more words for the mutants, as: make mutants MUTANTS="--each 5 --room service/planning/safety"

SEED ?=  # of an order that test-random printed, to have it again

.PHONY: demo venv docs test $(TESTS) test-long test-fast test-random test-drives test-compose fuzz soak bench mutants explore check format lock sbom audit openapi clean
.PHONY: check-and-vcan $(CHECKS)

demo: $(PRODUCT)  ## measure, identify and report a virtual robot
	$(BIN)/sweepid demo --out demo-out

venv: $(READY)  ## .venv with all that is needed; every other target does it as well

docs: $(READY)  ## the documents as a site, docs/_build/index.html; warnings are errors
	$(BIN)/sphinx-build -q -n -W --keep-going docs docs/_build

test: test-computing check-and-vcan test-machines  ## the first tier and all checks; with PART=k a part of the second as well

check-and-vcan: $(READY)  # the guest takes one core, the checks the other; after tests, since a guest compiles slowly
	@$(MAKE) --no-print-directory --output-sync=target --jobs=2 test-vcan $(CHECKS)

# What computes, the longest first, then what moves a machine in real time, which starves beside a third process.
test-computing: $(READY)
	$(TIER) tests/virtual_time tests/numeric tests/architecture tests/benchmarks tests/fuzz tests/unit

test-machines: $(READY)
	$(TIER) -n 2 -m "not alone" tests/browser tests/contract tests/system
	$(BIN)/python -m pytest -m alone tests/system

test-long: $(READY)  ## the second tier, all ten parts; with PART=k, from 1 to 10, one of them
	$(PYTEST) $(if $(PART),--part $(PART),--tier 2)
	$(NODES)
	$(GUEST) $(if $(PART),--part $(PART),--tier 2)

test-fast: $(READY)  ## unit and architecture tests that are not marked slow, in a minute
	$(PYTEST) -m "not slow" --durations 10 --durations-min 2 tests/unit tests/architecture

test-random: $(READY)  ## unit and architecture tests, the files and the tests in each shuffled; prints the seed
	$(BIN)/python -m pytest --random-order $(if $(strip $(SEED)),--random-order-seed $(strip $(SEED))) tests/unit tests/architecture

test-vcan: $(READY)  ## what needs a real SocketCAN vcan0; in a guest (user-mode-linux) where the kernel has no CAN
	$(NODES)
	$(GUEST) --tier 1 $(if $(PART),--part $(PART))

test-drives: $(READY)  ## the contract suite on every drive and bus, those alike to others included
	$(BIN)/python -m pytest --every-drive tests/contract
	VCAN_TIMEOUT=3600 tests/vcan/run $(BIN)/python -m pytest --vcan --every-drive --color=no tests/contract

test-compose: $(READY)  ## start docker-compose.yml for real and measure in it; with an engine of its own where none runs
	tests/compose/run sh -c 'docker-compose build && $(BIN)/python -m pytest --color=no tests/compose'

soak: $(READY)  ## everything that goes wrong, 20 times each at random moments of real campaigns, on each bus; hours
	for way in canopen canopen-streamed modbus; do $(BIN)/python -m tests.soak $$way $(SOAK) || exit 1; done

explore: $(READY)  ## interleavings in virtual time, 80 times as many as in make test; failing seeds are stored; two hours
	$(BIN)/python -m pytest --explore 80 tests/virtual_time

bench: $(READY)  ## what it costs, beside what else could do the same: docs/reference/benchmarks.md; a quarter of an hour
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m docs.benchmarks $(BENCH)

fuzz: $(READY)  ## what no program wrote, given to every parser of files from outside; fails on a finding
	FUZZ_CASES=$(FUZZ_CASES) $(PYTEST) tests/fuzz $(FUZZ)

mutants: $(READY)  ## plant small errors: which do the unit tests of each room notice?
	$(BIN)/python -m tests.mutants $(MUTANTS)

check: $(READY)  ## format, lint, types, import arrows, habits (repo-review; exceptions in pyproject.toml), two at once
	@$(MAKE) --no-print-directory --output-sync=target --jobs=2 $(CHECKS)

check-style:
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .

check-types:
	$(BIN)/basedpyright

check-tests-types:
	$(BIN)/basedpyright -p tests/pyrightconfig.json

check-arrows:
	$(BIN)/lint-imports

check-habits:
	$(BIN)/repo-review --show err .

format: $(READY)  ## put the code into its form
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

lock: $(READY)  ## resolve the dependencies anew, for all platforms
	$(BIN)/uv pip compile pyproject.toml --extra dask --extra hdf5 --extra mcap --extra mdf4 --extra mqtt --extra oidc \
		--extra opcua --extra otel --extra pdf --extra postgresql --extra ros --extra s3 --group dev --universal \
		--python-version 3.11 --generate-hashes \
		--no-emit-index-url --no-header --quiet --output-file requirements.lock

sbom: $(READY)  ## what sweepid is made of, as CycloneDX 1.6: sbom.json
	$(BIN)/cyclonedx-py environment $(BIN)/python --pyproject pyproject.toml --mc-type application --sv 1.6 \
		--output-reproducible --of JSON -o sbom.json

audit: $(READY)  ## known vulnerabilities of what the lock names; needs the network, so it is not part of make test
	$(BIN)/pip-audit --require-hashes --disable-pip -r requirements.lock

openapi: $(READY)  ## write docs/reference/openapi.json
	$(BIN)/python -m service.web.api.openapi

clean:  ## forget the environment and what was made
	rm -rf .venv demo-out docs/_build sbom.json

# uv installs what the lock pins: the product, and for the tests the rest
UV := VIRTUAL_ENV=$(CURDIR)/.venv $(BIN)/uv pip install

.venv/.uv: requirements.lock
	@$(PYTHON) -c 'import sys; sys.exit(None if sys.version_info >= (3, 11) else "sweepid needs Python 3.11 or newer")'
	@echo 'Installing into .venv, once; this takes a minute or two.'
	@$(PYTHON) -m venv .venv
	@sed -n '/^uv==/,/[^\\]$$/p' $< > .venv/uv.lock
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes --requirement .venv/uv.lock
	@touch $@

$(PRODUCT): .venv/.uv pyproject.toml
	@$(UV) --constraint requirements.lock --build-constraint requirements.lock --editable .
	@touch $@

$(READY): $(PRODUCT)
	@$(UV) --require-hashes --requirement requirements.lock
	@touch $@
