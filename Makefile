# Everything a developer runs, by name. `make bake` needs python3 (3.11 or newer, with venv) and nothing else.

PYTHON ?= python3
WORKERS ?= 2
MINUTES ?= 2
SEED ?= $(shell date +%s)

BIN := .venv/bin
PACKAGE := .venv/package.stamp
DEV := .venv/dev.stamp
NODE_MODULES := tests/support/node_modules/.stamp
BLENDER := build/blender/stamp
GODOT := build/godot/version
CARGO ?= $(or $(shell command -v cargo),$(HOME)/.cargo/bin/cargo)
BUILT_FROM := pyproject.toml setup.py $(wildcard src/skinbake/*.h src/skinbake/*/*.c src/skinbake/*/loops/*.h)
EXAMPLE := fixtures/bent_tube.glb

# What the caller's shell has set up for other projects must not leak into .venv.
unexport PYTHONHOME PYTHONPATH PYTHONDONTWRITEBYTECODE VIRTUAL_ENV

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help bake setup setup-blender setup-godot setup-bevy test test-all check lint fixtures golden picture table scores bench speeds man
.PHONY: docs dist release-check try-dist fuzz fuzz-native fuzz-coverage faults clean

help: ## List the targets
	@awk 'BEGIN { FS = ":.*## " } /^[a-z-]+:.*## / { printf "  make %-13s %s\n", $$1, $$2 }' Makefile

bake: $(PACKAGE) ## Set up .venv, bake a fixture into build/, and print what it gained
	@mkdir -p build
	$(BIN)/skinbake bake $(EXAMPLE) --out-dir build
	$(BIN)/skinbake verify build/$(notdir $(EXAMPLE))

setup: $(DEV) $(NODE_MODULES) ## Set up .venv and tests/support

setup-blender: $(BLENDER) ## Set up build/blender for the tests of the add-on: Blender as a Python module (1 GB), and the zip

setup-godot: $(GODOT) ## Set up build/godot for the tests of that add-on: Debian unstable's Godot and its libraries (170 MB to load, 670 on disk)

setup-bevy: ## Build Bevy for the tests of its crate, once a machine, in ~/.cache/skinbake-bevy (Rust 1.95, a long time)
	CARGO_TARGET_DIR="$${XDG_CACHE_HOME:-$$HOME/.cache}/skinbake-bevy" \
	  $(CARGO) build --manifest-path tests/bevy/draw/Cargo.toml

test: setup ## Set up, and run the tests without the slow ones: under two minutes
	$(BIN)/python -m pytest -n $(WORKERS) --dist worksteal -m "not slow"

test-all: setup ## Set up, and run all tests
	$(BIN)/python -m pytest -n $(WORKERS) --dist worksteal

check: lint docs test-all ## Run every check: style, types, layers, fixtures, documentation, all tests

lint: $(DEV)
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m fixtures.make_fixtures --check

fixtures: $(DEV) ## Write fixtures/ anew
	$(BIN)/python -m fixtures.make_fixtures

golden: $(DEV) ## Write tests/shaders/golden and the shader text in engines/ anew, after a change of templates: review the diff
	$(BIN)/python -m tests.shaders.write_golden

picture: $(DEV) $(NODE_MODULES) ## Draw bend.png, shaders.png, view.webp (need a Vulkan driver, the last the corpus), sheet.webp, three-*.png (Chromium) of docs/ anew
	$(BIN)/python -m benchmarks.bend_picture docs/bend.png
	$(BIN)/python -m benchmarks.bend_render docs/shaders.png
	$(BIN)/python -m benchmarks.character_picture
	$(BIN)/python -m benchmarks.sheet_picture
	$(BIN)/python -m benchmarks.three_picture
	$(BIN)/python -m benchmarks.skinned_normals_scores --pictures fixtures/SkinnedNormalsTest/screenshot

table: $(DEV) ## Write the tables of docs/ that models yield anew, from the models of SKINBAKE_CORPUS or ../shared/corpus
	$(BIN)/python -m benchmarks.corpus_table
	$(BIN)/python -m benchmarks.fitted_poses
	$(BIN)/python -m benchmarks.welded_meshes
	$(BIN)/python -m benchmarks.extended_influences
	$(BIN)/python -m benchmarks.encoding_table
	$(BIN)/python -m benchmarks.morph_frames

scores: $(DEV) $(NODE_MODULES) ## Write docs/scores.md anew: the engines of the tests in Chromium (4 minutes)
	$(BIN)/python -m benchmarks.skinned_normals_scores

bench: $(DEV) $(NODE_MODULES) ## Time bake and verify against peers: write benchmarks/RESULTS.md (12 minutes)
	$(BIN)/python -m benchmarks.results

speeds: $(DEV) $(NODE_MODULES) ## Time the shaders (writes docs/gpu.md) and frames of three.js (Chromium)
	$(BIN)/python -m benchmarks.shader_speed
	$(BIN)/python -m benchmarks.three_frame

man: $(PACKAGE) ## Write the man page build/skinbake.1 from the declarations of the commands
	@mkdir -p build
	$(BIN)/python -m skinbake.cli.help > build/skinbake.1

docs: $(DEV) $(NODE_MODULES) ## Build the documentation's site and the page that bakes into build/site/html: warnings and broken links are errors
	$(BIN)/python -m website.build

dist: .venv/dist.stamp ## Build the sdist, the wheels of seven systems and of browsers, and the wheel without compiled loops into dist/; the zips for Blender into build/
	$(BIN)/python -m release.build

release-check: .venv/dist.stamp ## Say what PyPI, npm and the site would refuse of what dist and docs have built
	$(BIN)/python -m release.check

try-dist: dist $(DEV) ## Try them with each Python at hand, and on the other systems that Linux can run (a quarter of an hour)
	$(BIN)/python -m pytest tests/release/test_cross.py
	$(BIN)/python -m release.try_dist

FUZZ_MODELS := build/fuzz-models

fuzz: $(DEV) ## Damage models for MINUTES=2 in WORKERS=2 from SEED, by every command; then the coverage-guided readers
	status=0; \
	$(BIN)/python -m fuzz --minutes $(MINUTES) --workers $(WORKERS) --seed $(SEED) --corpus $(FUZZ_MODELS) || status=1; \
	$(BIN)/python -m fuzz.targets --minutes $(MINUTES) --models $(FUZZ_MODELS) || status=1; \
	exit $$status

fuzz-native: $(DEV) ## The compiled loops and the decoders under sanitizers for MINUTES=2 from SEED
	$(BIN)/python -m fuzz.native --minutes $(MINUTES) --seed $(SEED)

fuzz-coverage: $(DEV) ## Which branches of src/skinbake/files and gltf the fuzzer reaches in MINUTES=2, and which it misses
	$(BIN)/python -m fuzz.branches --minutes $(MINUTES) --workers $(WORKERS) --seed $(SEED) --corpus $(FUZZ_MODELS)

faults: $(DEV) ## Kills, signals and I/O errors at every call that writes
	$(BIN)/python -m fuzz.faults

clean: ## Remove everything that make made
	rm -rf .venv build dist tests/support/node_modules src/*.egg-info
	rm -rf .pytest_cache .mypy_cache .ruff_cache .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

.venv/created.stamp:
	@$(PYTHON) -c 'import sys; sys.version_info >= (3, 11) or sys.exit("skinbake needs Python 3.11 or newer; set PYTHON=…")'
	$(PYTHON) -m venv .venv
	@touch $@

# setuptools and pip of an old distribution are enough: nothing here is newer than PEP 660.
$(PACKAGE): .venv/created.stamp $(BUILT_FROM)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable .
	@touch $@

$(DEV): .venv/created.stamp $(BUILT_FROM)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $(PACKAGE) $@

.venv/dist.stamp: $(PACKAGE)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dist]'
	@touch $@

# Only tests/blender needs it, and is skipped without it (SKINBAKE_STRICT=1: fails). It takes Python 3.11 and no other.
$(BLENDER): tests/blender/requirements.txt $(DEV)
	$(PYTHON) -m venv --clear build/blender/venv
	build/blender/venv/bin/python -m pip install --quiet --disable-pip-version-check --no-compile --requirement $<
	$(BIN)/python -m engines.blender.build --wheels build/blender/wheels
	@touch $@

# tests/godot/test_native.py needs it, and is skipped without it (SKINBAKE_STRICT=1: fails). No rights are needed.
$(GODOT): tests/godot/install.py
	$(PYTHON) -m tests.godot.install build/godot

# Independent glTF tools; the tests that need them are skipped where npm is absent (SKINBAKE_STRICT=1: fail).
$(NODE_MODULES): tests/support/package-lock.json tests/support/other_versions/package-lock.json
	@if command -v npm >/dev/null; then \
	  echo "npm ci --prefix tests/support" && \
	  npm ci --prefix tests/support --no-audit --no-fund --loglevel=error && \
	  npm ci --prefix tests/support/other_versions --no-audit --no-fund --loglevel=error && \
	  touch $@; \
	else echo "npm is not installed: tests that need it are skipped"; fi
