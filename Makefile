# make demo: the main job end to end. make test: lint, types and all tests. make bench: how fast.
# make quality: how good. make coverage: what of the code the tests run. make parameters: write
# config/ and docs/parameters.md from the table of parameters.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

# ROS traffic stays on this machine.
export ROS_AUTOMATIC_DISCOVERY_RANGE := LOCALHOST

.PHONY: demo test lint bench quality coverage parameters clean

demo: $(VENV)/.installed
	$(BIN)/python -m demo.main demo_output

test: lint
	$(BIN)/python -m pytest

bench: $(VENV)/.installed
	$(BIN)/python -m benchmark.speed --json benchmark_output.json

quality: $(VENV)/.installed
	$(BIN)/python -m benchmark.quality
	$(BIN)/python -m benchmark.bias

coverage: $(VENV)/.installed
	$(BIN)/coverage erase
	$(BIN)/coverage run -m pytest
	$(BIN)/coverage combine --quiet
	$(BIN)/coverage report --fail-under 95

parameters: $(VENV)/.installed
	$(BIN)/python -m tools.write_parameter_files

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
	$(BIN)/pip install --quiet --editable '.[fast,offline,identify,jazzy,demo,benchmark,test]'
	touch $@

clean:
	rm -rf $(VENV) demo_output benchmark_output.json build install log
