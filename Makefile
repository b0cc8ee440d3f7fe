# make compare: the main job on the bundled sample log. make test: what must hold before a change is merged. make check: its
# quick part. make test-all: with the tests of the night, the whole site, the engine's own tests, fuzzer and lint, and a wheel;
# it takes an hour.
# All set up .venv by themselves; PYTHON names the interpreter to build it with.
PYTHON ?= python3
BIN := .venv/bin
PIP := $(BIN)/python -m pip --quiet --disable-pip-version-check
# compiling every module takes longer than installing them, and 90 MB; Python compiles those that are imported, and keeps them
FETCH := $(PIP) install --no-compile
export PYTHONDONTWRITEBYTECODE :=

.PHONY: compare test pytest test-nightly test-all check lint wheel-check engine-test engine-fuzz engine-lint engine-format engine-wasm docs docs-check clean

compare: .venv/.installed
	$(BIN)/slam-compare run

# two processes; the tests of a file stay together, because they share its fixtures, in the order of tests/conftest.py
PYTEST := $(BIN)/python -m pytest --numprocesses 2 --dist loadfile --no-loadscope-reorder

# mypy takes one core, so that it runs beside the tests
# with SOME=6, one in six of the tests of the night, which the commit chooses, are among them
test: ONLY := $(if $(SOME),--one-in $(SOME),-m "not nightly and not browser and not cluster")
test: .venv/.installed-test
	$(MAKE) --jobs=2 lint pytest ONLY='$(ONLY)'

pytest: .venv/.installed-test
	$(PYTEST) $(ONLY)

# the tests that take too long for every change
NIGHTLY := -m "nightly or browser or cluster"
test-nightly: .venv/.installed-test
	$(PYTEST) $(NIGHTLY)
	EXAMPLES=100 $(PYTEST) -m hypothesis

# the site comes first, because its tests are skipped without it
test-all: docs engine-test engine-fuzz engine-lint wheel-check test test-nightly

check: ONLY := -m "not slow and not nightly and not browser and not cluster"
check: .venv/.installed-test
	$(MAKE) --jobs=2 lint pytest ONLY='$(ONLY)'

lint: .venv/.installed-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

.venv/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "Python 3.11 or newer is needed; name it with: make PYTHON=/path/to/python" >&2; exit 1; }
	$(PYTHON) -m venv .venv

# cmake, ninja and a compiler come from PyPI where the machine has none; they stay, so that later builds take seconds
.venv/.tools: engine/build_backend.py | .venv/bin/python
	$(FETCH) 'scikit-build-core>=0.11' 'nanobind>=2.4'
	@mkdir -p build
	$(BIN)/python engine/build_backend.py > build/requirements
	$(FETCH) --requirement build/requirements
	@touch $@

# pip runs again when the requirements or the engine change; a stamp is written only when everything is installed
ENGINE := $(shell find engine -name '*.[ch]pp' -o -name CMakeLists.txt)
# packages are fetched while the engine is built; its steps are shown, and all of its output if it fails
INSTALL = @echo "Installing packages and building the engine"; mkdir -p build; rm -f build/failed; \
	$(BIN)/python engine/build_backend.py '$(1)' | $(FETCH) --requirement /dev/stdin & \
	{ $(BIN)/python -m pip --verbose install --no-build-isolation --no-deps --editable . 2>&1 || touch build/failed; } \
		| tee build/output | grep --line-buffered -o '\[[0-9]*/[0-9]*\]'; \
	wait $$! && { test ! -e build/failed || { cat build/output >&2; false; }; }

.venv/.installed: pyproject.toml $(ENGINE) .venv/.tools
	$(call INSTALL,)
	@touch $@

.venv/.installed-test: pyproject.toml $(ENGINE) .venv/.tools
	$(call INSTALL,test)
	@touch $@ .venv/.installed

# a wheel as it would be published, for every processor, which is built, and used on the sample log, in an environment that has
# nothing else. A later Python makes it, if this machine has one: from 3.12 on the engine has the stable ABI and is built
# otherwise, and that of 3.11 is what most tests have run. The other one: make wheel-check LATER=python3.11
LATER ?= $(or $(lastword $(sort $(wildcard $(HOME)/.pyenv/versions/3.1[2-9].*/bin/python3 /usr/bin/python3.1[2-9] \
	/usr/local/bin/python3.1[2-9] /opt/hostedtoolcache/Python/3.1[2-9].*/x64/bin/python3))),$(PYTHON))
WHEEL_PIP := build/wheel-venv/bin/python -m pip --quiet --disable-pip-version-check
wheel-check:
	rm -rf build/wheels build/wheel-venv build/wheel-run
	$(LATER) -m venv build/wheel-venv
	VMSLAM_NATIVE=OFF $(WHEEL_PIP) wheel --no-deps --wheel-dir build/wheels --config-settings build-dir=build/portable .
	$(WHEEL_PIP) install --no-compile build/wheels/*.whl
	mkdir build/wheel-run
	cd build/wheel-run && ../wheel-venv/bin/slam-compare run

# the tests of the engine that need no Python, with sanitizers
engine-test: build/engine-test/CMakeCache.txt
	cmake --build build/engine-test --parallel 2 --target vmslam_tests
	build/engine-test/vmslam_tests

# solves, online loops and filters on 12,000 inputs, many of them at the limits of floating point, with sanitizers
FUZZ_INPUTS ?= 12000
engine-fuzz: build/engine-test/CMakeCache.txt
	cmake --build build/engine-test --parallel 2 --target vmslam_fuzz
	build/engine-test/vmslam_fuzz $(FUZZ_INPUTS)

# formatting and static analysis of the engine; the versions are fixed, because other ones format differently
engine-lint: .venv/.engine-lint
	$(BIN)/clang-format --style=file:engine/.clang-format --dry-run --Werror $$(git ls-files '*.cpp' '*.hpp')
	cmake -S engine -B build/engine-lint -DCMAKE_EXPORT_COMPILE_COMMANDS=ON -DCMAKE_DISABLE_PRECOMPILE_HEADERS=ON -DVMSLAM_UNITY=OFF
	git ls-files 'engine/sources/*.cpp' | xargs -P 2 -n 4 \
		$(BIN)/clang-tidy -p build/engine-lint --quiet --header-filter=vmslam

engine-format: .venv/.engine-lint
	$(BIN)/clang-format --style=file:engine/.clang-format -i $$(git ls-files '*.cpp' '*.hpp')

.venv/.engine-lint: | .venv/bin/python
	$(PIP) install clang-format==23.1.5 clang-tidy==23.1.4
	@touch $@

build/engine-test/CMakeCache.txt: engine/CMakeLists.txt
	cmake -S engine -B build/engine-test -DVMSLAM_TESTS=ON -DVMSLAM_NATIVE=ON -DVMSLAM_SANITIZE=address,undefined,float-cast-overflow \
		-DCMAKE_BUILD_TYPE=Debug
	@touch $@

# the engine for web pages: build/wasm/vmslam.wasm and vmslam.js; the first build takes minutes, because it builds the library of C++, too
engine-wasm: .venv/.engine-wasm
	$(MAKE) -C engine/wasm -j2 PYTHON=$(abspath $(BIN)/python)

.venv/.engine-wasm: | .venv/bin/python
	$(PIP) install 'ziglang>=0.13'
	@touch $@

# the documentation site in English and Japanese; results of its code are kept in .cache, and its pages are tested if it is built
docs: .venv/.installed-docs .venv/.installed engine-wasm
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet
	@echo "to read it: python3 -m http.server --directory site, then open http://localhost:8000"

# a quick check of the site: links, formulas, both languages, and the code of some pages, which the commit chooses
docs-check: .venv/.installed-docs .venv/.installed
	NO_MKDOCS_2_WARNING=1 SITE_SECONDS=$${SITE_SECONDS:-30} $(BIN)/mkdocs build --strict --quiet --site-dir .cache/site-check

.venv/.installed-docs: pyproject.toml $(ENGINE) .venv/.tools
	$(call INSTALL,docs)
	@touch $@ .venv/.installed

clean:
	rm -rf .cache site .venv build graphslam/_engine.*
