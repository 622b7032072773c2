# make regress   render the default suite without a display, compare it with the evaluator, write report/index.html
# make test      run the tests
# make regress-full  the larger suite; more textured cases, each drawn first in a process of its own; and a picture of
#                each shipped material, on each backend
# make sweep     MaterialX's own documents, where they lie beside the checkout, through everything, beside its own
#                renderer, and all of its examples moved over; a quarter of an hour
# make targets   install the targets' compilers and a browser, then compile and run the nodes in every target
# make clients   the same in every release of MaterialX (or RELEASES), with its own tools and its own renderer; prints a
#                table
# make fuzz      damage 2,400 files and send them through the command line; beside it ten minutes of fuzzing led by
#                coverage, for each reader
# make faults    kill runs 200 times, fill the disk at every change, cut the power at every moment, draw the default suite with
#                the cache and without; hours
# make mutants   change the nodes' GLSL in 240 ways, one at a time, and say which of them the default suite does not notice;
#                half an hour (SEED=2 chooses others)
# make random    300 random materials on each backend (MRM_SEED=N makes those of another run); half an hour
# make decades   ten million random configurations of each node, by decade of alpha and of both cosines; a quarter of an hour
# make docs      build the documentation's site, build/site/index.html; what is wrong with a page or a link ends it
# make lint      check types, lint, format, and that nothing imports upward
#
# Each sets up what it needs: a virtual environment in .venv, the package, and the GL libraries.

PYTHON ?= python3
BACKEND ?= all
REPORT ?= report
RELEASES ?=
SEED ?= 1
BIN := .venv/bin

# They need compilers, a browser or an X server, which only `make targets` sets up.
TARGET_TESTS := tests/test_targets.py tests/test_webgl.py tests/test_webgpu.py tests/test_slang.py \
	tests/test_materialx_renderer.py tests/test_report_browser.py tests/test_tonemap_three.py tests/test_vectors.py

SWEEP := tests/test_sweep.py
# `make regress-full` runs all of its cases, and `make test` three.
TEXTURED := render_tests/test_textured.py

.PHONY: regress regress-full sweep test docs lint setup clean targets clients fuzz faults decades mutants random

regress: setup
	$(BIN)/mrm-nodes regress -o $(REPORT) --backend $(BACKEND) --scenes

# What `make regress` has drawn comes from the cache.
regress-full: setup
	$(BIN)/mrm-nodes regress -o $(REPORT) --backend $(BACKEND) --suite full
	MRM_REGRESS_FULL=1 $(BIN)/python -m pytest -q -n 2 --dist loadgroup $(TEXTURED)
	MRM_PICTURES=1 $(BIN)/python -m pytest -q -n 2 tests/test_pictures.py -k shipped_material

sweep: targets
	MRM_EXAMPLES=all $(BIN)/python -m pytest -q $(SWEEP) tests/test_retrofit_examples.py

test: setup
	$(BIN)/python -m pytest -q -n 2 --dist loadscope $(TARGET_TESTS:%=--ignore=%) $(SWEEP:%=--ignore=%)

# Here a compiler that is missing is a failure, where `make test` skips its tests.
targets: setup
	@sh .ci/compilers
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[targets]'
	MRM_REQUIRE_COMPILERS=cc,glsl,essl,vulkan,wgsl,slang,msl,clients $(BIN)/python -m pytest -q -n 2 --dist loadscope \
		--junitxml .venv-clients/targets.xml $(TARGET_TESTS)

clients: targets
	@sh .ci/clients $(RELEASES)

fuzz: setup
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[fuzz]'
	MRM_FUZZ=2400 MRM_FUZZ_SECONDS=560 $(BIN)/python -m pytest -q -n 2 --dist loadfile \
		tests/test_fuzz.py tests/test_fuzz_readers.py

faults: setup
	MRM_FAULTS=200 $(BIN)/python -m pytest -q -n 2 tests/test_full_disk.py tests/test_power_cut.py tests/test_kills.py \
		render_tests/test_robust_kills.py
	MRM_REGRESS_FULL=1 $(BIN)/python -m pytest -q -n 2 render_tests/test_cache_agrees.py

mutants: setup
	$(BIN)/python tests/mutants.py --seed $(SEED) -o build/mutants.json

random: setup
	MRM_RANDOM=300 $(BIN)/python -m pytest -q -n 2 tests/test_random_materials.py

decades: setup
	MRM_CONFIGURATIONS=10000000 $(BIN)/python -m pytest -q -s render_tests/test_decades.py

docs: setup
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-logo

setup: .venv/ready
	@sh .ci/gl-libraries

.venv/ready: pyproject.toml .ci/virtual-environment
	@sh .ci/virtual-environment $(PYTHON)

clean:
	rm -rf .venv .venv-clients build $(REPORT) .pytest_cache .mypy_cache .ruff_cache
