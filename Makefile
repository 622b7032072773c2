# make regress   render the default suite without a display, compare it with the evaluator, write report/index.html
# make test      run the tests
# make lint      check types, lint and format
#
# Each sets up what it needs: a virtual environment in .venv, the package, and the GL libraries.

PYTHON ?= python3
BACKEND ?= all
REPORT ?= report
BIN := .venv/bin

.PHONY: regress test lint setup clean

regress: setup
	$(BIN)/mrm-nodes regress -o $(REPORT) --backend $(BACKEND)

test: setup
	$(BIN)/python -m pytest -q -n 2 --dist loadscope

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

setup: .venv/ready
	@sh .ci/gl-libraries

.venv/ready: pyproject.toml .ci/virtual-environment
	@sh .ci/virtual-environment $(PYTHON)

clean:
	rm -rf .venv $(REPORT) .pytest_cache .mypy_cache .ruff_cache
