# Pathloom's front door. `make` = tools, build, demo; `make test` = every test; `make help` = the rest.
# `## text` behind a target and `##@ group` are what make help prints.

.DEFAULT_GOAL := demo
.DELETE_ON_ERROR:
pipelines := demo image edit edit-techniques edit-images transient derive fit animation chart chart-all chart-transient chart-edit-graph chart-edit-cost chart-animation report \
	table table-edit table-derive choices peers peers-transient peers-derive
.PHONY: $(pipelines) edit-pictures oidn format lint tools build stages test test-full stability asan bench clean help
SHELL := /bin/sh
include pipelines/variables.mk

BUILD ?= build
JOBS ?= $(shell nproc)
# The variables of an image (SCENE METHOD SPP ...) go through to pipelines/still.mk, which has their defaults.

python = $(call quote,$(PEERS_PYTHON))
STAGES := $(patsubst stages/%/main.cpp,loom-%,$(wildcard stages/*/main.cpp))

# $(call packages,install,SETS): what is missing of sets of Debian packages. All output of tools and compilers goes to stderr: stdout
# is for results.
packages = BUILD=$(BUILD) sh pipelines/packages.sh $(1) $(2) >&2

# Without the sloppiness ccache leaves alone whatever uses a precompiled header (the tests).
launcher := env;CCACHE_SLOPPINESS=pch_defines,time_macros;ccache

# $(call compile,FOLDER,OPTIONS,TARGETS): configures once, with Ninja and ccache where they are, and builds. Packages are looked at
# before the first time and when something fails: a tree that is built needs none.
# Variables of this make (OUT, DEFINES, ...) are none of the compiler's business, hence `unset`.
compile = unset MAKEFLAGS MFLAGS; \
	if ! [ -f $(1)/build.ninja ] && ! [ -f $(1)/Makefile ]; then \
		$(call packages,install,build) || told=yes; \
		cmake --fresh -S . -B $(1) $(2) \
			$$(command -v ninja >/dev/null && echo -G Ninja) \
			$$(command -v ccache >/dev/null && echo '-DCMAKE_CXX_COMPILER_LAUNCHER=$(launcher)') >&2; \
	fi && cmake --build $(1) --parallel $(JOBS) $(if $(3),--target $(3)) >&2 || { [ -n "$$told" ] || $(call packages,missing,build); exit 1; }

##@ Images

demo: stages ## (default) install, build, and make a page of examples, out/demo/index.html
	@$(MAKE) --no-print-directory -f pipelines/demo.mk demo

image: stages ## image of SCENE, OUT/image.exr
	@$(MAKE) --no-print-directory -f pipelines/still.mk image

##@ Edits

edit: stages ## image of NEW from the image of OLD and the residual, OUT/new.exr
	@$(MAKE) --no-print-directory -f pipelines/edit.mk edit

edit-techniques: stages ## paths that each technique of METHOD=dynamic finds, as PNG
	@$(MAKE) --no-print-directory -f pipelines/edit.mk edit-techniques

edit-images: stages ## old, new and residual images of the edits of table-edit, as PNG
	@$(MAKE) --no-print-directory -f pipelines/table-edit.mk edit-images

edit-pictures: edit-images

animation: stages ## frames of SCENE for the rows of FRAMES, from the image of what they share, and a movie
	@$(MAKE) --no-print-directory -f pipelines/animation.mk animation

##@ Transients

transient: stages ## cube of SCENE over time, OUT/cube.h5, with frames, streaks and curves
	@$(MAKE) --no-print-directory -f pipelines/transient.mk transient

derive: stages ## cube of SCENE and its derivatives by the parameters WRT, OUT/cube.h5
	@$(MAKE) --no-print-directory -f pipelines/derive.mk derive

fit: stages ## values of the parameters WRT that explain the cube MEASURED, OUT/fit.h5
	@$(MAKE) --no-print-directory -f pipelines/fit.mk fit

##@ Charts and tables

chart: stages ## error against cost of METHODS on SCENE
	@$(MAKE) --no-print-directory -f pipelines/chart.mk chart

chart-all: stages ## error against cost of pt, west and pathgraph on many small scenes
	@$(MAKE) --no-print-directory -f pipelines/chart-all.mk chart-all

chart-transient: stages ## error of the cubes of SCENE against samples and cost
	@$(MAKE) --no-print-directory -f pipelines/chart-transient.mk chart-transient

chart-edit-graph: stages ## error, bias and variance of residuals by path graphs
	@$(MAKE) --no-print-directory -f pipelines/chart-edit-graph.mk chart-edit-graph

chart-edit-cost: stages ## CPU time of residuals against the share of touched paths
	@$(MAKE) --no-print-directory -f pipelines/chart-edit-cost.mk chart-edit-cost

chart-animation: stages ## error, cost and flicker of animations and of path tracing of each frame
	@$(MAKE) --no-print-directory -f pipelines/chart-animation.mk chart-animation

report: stages ## one HTML page of METHODS on SCENE: images, errors, charts, lineage
	@$(MAKE) --no-print-directory -f pipelines/report.mk report

table: stages ## cost and error of path graphs and path tracing, a row per scene
	@$(MAKE) --no-print-directory -f pipelines/table.mk table

table-edit: stages ## residuals and correlated paths at equal time, a row per edit
	@$(MAKE) --no-print-directory -f pipelines/table-edit.mk table-edit

table-derive: stages ## derivatives and differences of scenes at equal time, a row per parameter
	@$(MAKE) --no-print-directory -f pipelines/table-derive.mk table-derive

choices: stages ## gathers, pools or directs (CHOICES=) compared at equal time
	@$(MAKE) --no-print-directory -f pipelines/choices.mk choices

peers: stages ## Mitsuba 3 on SCENE, for later charts and reports (from PyPI)
	@[ -n $(python) ] || [ -e $(BUILD)/peers/ready ] || { $(call packages,install,peers mitsuba); python3 -m venv $(BUILD)/peers && \
		$(BUILD)/peers/bin/pip install -q mitsuba==3.8.0 >&2 && touch $(BUILD)/peers/ready; }
	@$(MAKE) --no-print-directory -f pipelines/peers.mk peers PYTHON=$(if $(PEERS_PYTHON),$(python),$(BUILD)/peers/bin/python)

peers-transient: stages ## mitransient on SCENE, compared with our cube (from PyPI)
	@[ -n $(python) ] || [ -e $(BUILD)/peers/ready-transient ] || { $(call packages,install,peers mitsuba); python3 -m venv $(BUILD)/peers && \
		$(BUILD)/peers/bin/pip install -q mitsuba==3.8.0 mitransient==1.3.1 h5py >&2 && touch $(BUILD)/peers/ready-transient; }
	@$(MAKE) --no-print-directory -f pipelines/peers-transient.mk peers-transient PYTHON=$(if $(PEERS_PYTHON),$(python),$(BUILD)/peers/bin/python)

peers-derive: stages ## Mitsuba 3's derivatives of a steady image, compared with ours (from PyPI)
	@[ -n $(python) ] || [ -e $(BUILD)/peers/ready-derive ] || { $(call packages,install,peers mitsuba); python3 -m venv $(BUILD)/peers && \
		$(BUILD)/peers/bin/pip install -q mitsuba==3.8.0 h5py >&2 && touch $(BUILD)/peers/ready-derive; }
	@$(MAKE) --no-print-directory -f pipelines/peers-derive.mk peers-derive PYTHON=$(if $(PEERS_PYTHON),$(python),$(BUILD)/peers/bin/python)

##@ Build and test

# Without precompiled headers, which clang cannot read from g++; tests get some headers from theirs.
lint_headers := -include cmath -include filesystem -include fstream -include functional -include map -include string -include vector
lint: ## check all sources with clang-tidy 16, a line per finding
	@$(call packages,install,build lint)
	@cmake -S . -B $(BUILD)/lint -DCMAKE_DISABLE_PRECOMPILE_HEADERS=ON -DCMAKE_COMPILE_WARNING_AS_ERROR=OFF \
		-DCMAKE_CXX_FLAGS="$(lint_headers)" >$(BUILD)/lint.log || \
		{ cat $(BUILD)/lint.log; exit 1; }
	@run-clang-tidy-16 -quiet -j $(JOBS) -p $(BUILD)/lint >$(BUILD)/lint.log 2>&1 && echo 'lint: clean' || \
		{ grep -E ' (warning|error): ' $(BUILD)/lint.log | sort -u | grep . || tail $(BUILD)/lint.log; exit 1; }

tools: ## install the missing Debian packages
	@$(call packages,install,build convenience)

build: ## compile everything, tests included
	@$(call compile,$(BUILD),-DCMAKE_BUILD_TYPE=Release)

stages: # what an image needs, without the tests
	@$(call compile,$(BUILD),-DCMAKE_BUILD_TYPE=Release,$(STAGES))

oidn: ## fetch Open Image Denoise for loom-denoise (from PyPI)
	@[ -e $(BUILD)/oidn/libOpenImageDenoise.so.2 ] || { $(call packages,install,peers); python3 -m venv $(BUILD)/oidn && \
		$(BUILD)/oidn/bin/pip install -q --no-deps pyoidn==2.5.1.0 >&2 && cd $(BUILD)/oidn && \
		ln -s lib/python3*/site-packages/pyoidn/oidn/lib/libOpenImageDenoise.so.2 .; }
	@echo $(BUILD)/oidn/libOpenImageDenoise.so.2

test: build ## install, build and run all tests
	cd $(BUILD) && ctest --output-on-failure --no-tests=error

test-full: build ## all tests with longer statistical runs, and reports in a browser
	@$(call packages,install,browser) || echo "without a browser the test of reports in one is left out" >&2
	cd $(BUILD) && LOOM_TEST_FULL=1 ctest --output-on-failure --no-tests=error

stability: build ## hard scenes, hard edits and fifty edits in a row, at full length
	LOOM_TEST_FULL=1 $(BUILD)/test_statistical --gtest_filter='Stability*:Blend*'

asan: ## unit and formats tests under AddressSanitizer and UBSan
	@$(call compile,$(BUILD)-asan,-DCMAKE_BUILD_TYPE=Debug -DLOOM_SANITIZE=ON,test_unit test_formats)
	cd $(BUILD)-asan && ctest --output-on-failure --no-tests=error -R '^(unit|formats)$$'

bench: build ## throughput compared with a bare Embree loop
	$(BUILD)/bin/loom-bench

format: ## format all sources with clang-format 14
	@sh tests/format.sh --fix

clean: ## remove build folders and out/
	rm -rf $(BUILD) $(BUILD)-asan out

help: ## this list
	@awk -F':[^#]*## ' '/^##@ / { print substr($$0, 5) } /^[a-z-]+:[^#]*## / { printf "  %-17s %s\n", $$1, $$2 }' Makefile
	@echo
	@echo 'make -s TARGET prints only the paths of its results. Variables of a target: make help-image, help-edit, ...'
	@echo 'Variables of the build: BUILD=$(BUILD) (its folder), JOBS=$(JOBS) (compilations at a time)'
	@echo 'Example: make image SCENE=scenes/cornell-box.xml METHOD=pt SPP=64 DEFINES="resx=320 resy=320"'

# Only names of pipelines reach a shell.
$(pipelines:%=help-%): help-%:
	@awk -v target=$* -f pipelines/help.awk Makefile
help-%:
	$(error $@: no such page; there are $(pipelines:%=help-%))
