# make demo: the main job end to end. make check: lint, types and quick tests.
# make test: lint, types and all tests. make coverage: what of the code the tests run.
# make bench: how fast. make quality: how good. make docs: the site of the documentation, in site/.
# make parameters, make commands, make poses: write the reference pages and a picture in docs/, and
# config/, from the code.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Processes that share the tests: test/conftest.py says how. Of all tests there is one more than of
# the quick ones, as that with the tests of the node mostly waits.
check: WORKERS ?= 2
test coverage: WORKERS ?= 3

# ROS traffic stays on this machine.
export ROS_AUTOMATIC_DISCOVERY_RANGE := LOCALHOST

# Else each process of the tests, and of the workers, would compile all Python anew where it is set.
unexport PYTHONDONTWRITEBYTECODE

# Types are checked by two processes, where mypy can do so: in a fresh clone it takes a minute by one.
export MYPY_NUM_WORKERS ?= 2

.PHONY: demo check test ready ready-for-all lint compile compile-both bench quality coverage parameters commands poses docs clean

demo: $(VENV)/.installed
	$(BIN)/python -m demo.main demo_output

check: ready
	$(BIN)/python -m pytest -n $(WORKERS) -m 'not slow and not node'

test: ready-for-all
	$(BIN)/python -m pytest -n $(WORKERS)

# Compiled before the workers start, as two of them would compile the same.
ready: $(VENV)/.installed
	@$(MAKE) --no-print-directory --jobs 2 --output-sync lint compile

ready-for-all: $(VENV)/.installed
	@$(MAKE) --no-print-directory --jobs 2 --output-sync lint compile-both

compile: $(VENV)/.installed
	$(BIN)/python -m gyro_drift_filter.cli.main compile

# By numba, too, which the tests compare with.
compile-both: $(VENV)/.installed
	PYTHONPATH=test:$$PYTHONPATH $(BIN)/python -m support.compiling

bench: $(VENV)/.installed
	$(BIN)/python -m benchmark.speed --json benchmark_output.json

quality: $(VENV)/.installed
	@status=0; \
	$(BIN)/python -m benchmark.quality --check || status=1; \
	$(BIN)/python -m benchmark.quality --check --rate 50 --only adaptive || status=1; \
	$(BIN)/python -m benchmark.bias || status=1; \
	$(BIN)/python -m benchmark.drivers --check || status=1; \
	$(BIN)/python -m benchmark.covariance || status=1; \
	$(BIN)/python -m benchmark.vehicles --check || status=1; \
	$(BIN)/python -m benchmark.scale || status=1; \
	$(BIN)/python -m benchmark.without_rest --check || status=1; \
	$(BIN)/python -m benchmark.unmeasured --check || status=1; \
	$(BIN)/python -m benchmark.contradictions --check || status=1; \
	exit $$status

# Of what runs on a robot, and reads and writes bags, the tests run nearly all.
coverage: IN := gyro_drift_filter
coverage: COVERED := $(IN)/core/*,$(IN)/messages/*,$(IN)/mcap/*,$(IN)/bags/*,$(IN)/ros/*
coverage: compile-both
	$(BIN)/coverage erase
	$(BIN)/coverage run -m pytest -n $(WORKERS)
	$(BIN)/coverage combine --quiet
	$(BIN)/coverage report
	$(BIN)/coverage report --fail-under 95 --include '$(COVERED)'

parameters: $(VENV)/.installed
	$(BIN)/python -m tools.write_parameter_files

commands: $(VENV)/.installed
	$(BIN)/python -m tools.write_command_page

poses: $(VENV)/.installed
	$(BIN)/python -m tools.draw_poses

docs: $(VENV)/.installed
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict
	@echo 'open site/index.html'

lint: $(VENV)/.installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

$(VENV)/.installed: setup.py package.xml
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 13))' || { \
	  echo 'Python 3.11 or 3.12 is needed: make PYTHON=python3.12 ...' >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' || { \
	  echo 'the venv module is missing: apt install python3-venv' >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)
	@$(BIN)/pip install --quiet --editable '.[fleet,jazzy,docs,benchmark,test]' || { \
	  echo 'not all could be installed; docs/installation.md says what to do without a network,' >&2; \
	  echo 'behind a proxy, and on an ARM processor' >&2; exit 1; }
	touch $@

clean:
	rm -rf $(VENV) demo_output benchmark_output.json site build install log
