# Pathloom's front door. `make` = tools, build, demo; `make test` = every test; `make help` = the rest.

.DEFAULT_GOAL := demo
.DELETE_ON_ERROR:
.PHONY: format demo image edit edit-techniques transient chart chart-transient chart-edit-graph chart-edit-cost chart-all report table table-edit edit-pictures choices test test-full stability asan bench peers peers-transient oidn tools build stages clean help
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

demo: stages ## (default) install, build, trace a small scene, show where the results lie; takes SCENE= too
	@$(MAKE) --no-print-directory -f pipelines/still.mk demo
	@$(MAKE) --no-print-directory -f pipelines/transient.mk demo SCENE=scenes/flash.xml DEFINES= TRACE= SPP=8 PASSES=4 \
		$(if $(OUT),OUT=$(OUT)/flash)

image: stages ## render SCENE; with -s the only line on stdout is the path of the EXR
	@$(MAKE) --no-print-directory -f pipelines/still.mk image

transient: stages ## light in flight of SCENE, binned over time; with -s the only line on stdout is the path of the cube
	@$(MAKE) --no-print-directory -f pipelines/transient.mk transient

edit: stages ## image of NEW from that of OLD and the difference that the edit makes; with -s prints only its path
	@$(MAKE) --no-print-directory -f pipelines/edit.mk edit

edit-techniques: stages ## what each technique of dynamic paths finds of the edit of OLD to NEW, weighted and raw, as PNG
	@$(MAKE) --no-print-directory -f pipelines/edit.mk edit-techniques

table-edit: stages ## residuals beside correlated path tracing at equal time, a row per edit ([RP] Tables 2 and 3); takes ROWS= METHODS= OUT= DOCS=
	@$(MAKE) --no-print-directory -f pipelines/table-edit.mk table-edit

edit-pictures: stages ## old, new and residual of the edits of table-edit, as PNG; takes ROWS=
	@$(MAKE) --no-print-directory -f pipelines/table-edit.mk edit-pictures

chart: stages ## error against cost of METHODS on SCENE; the last lines are the paths of the charts
	@$(MAKE) --no-print-directory -f pipelines/chart.mk chart

chart-transient: stages ## error of the cubes of SCENE against paths and cost; the last lines are the paths of the charts
	@$(MAKE) --no-print-directory -f pipelines/chart-transient.mk chart-transient

chart-edit-graph: stages ## error, bias and variance of the residual of OLD to NEW by path graphs and by paths; the last lines are the paths of the charts
	@$(MAKE) --no-print-directory -f pipelines/chart-edit-graph.mk chart-edit-graph

chart-edit-cost: stages ## CPU time of residuals from a graph of the old scene against how many paths the edit touches; takes ROWS= OUT= DOCS=
	@$(MAKE) --no-print-directory -f pipelines/chart-edit-cost.mk chart-edit-cost

chart-all: stages ## charts of pt, west and pathgraph on many scenes at small size, OUT=out/chart-all; DOCS= copies them
	@$(MAKE) --no-print-directory -f pipelines/chart-all.mk chart-all

report: stages ## one page of METHODS on SCENE, OUT/report.html: images, errors, charts, tables, lineage
	@$(MAKE) --no-print-directory -f pipelines/report.mk report

table: stages ## cost and error of path graphs beside path tracing, a row per scene; takes SCENES= OUT=
	@$(MAKE) --no-print-directory -f pipelines/table.mk table

choices: stages ## what gathers, pools or directs (CHOICES=) bring at equal time; takes SCENES= OUT=
	@$(MAKE) --no-print-directory -f pipelines/choices.mk choices

test: build ## install, build and run all tests
	cd $(BUILD) && ctest --output-on-failure --no-tests=error

test-full: build ## the tests with the longer statistical runs, and the report in a browser
	@$(call packages,install,browser) || echo "without a browser the test of reports in one is left out" >&2
	cd $(BUILD) && LOOM_TEST_FULL=1 ctest --output-on-failure --no-tests=error

stability: build ## scenes that are hard on path graphs, edits that are hard on residuals, and fifty edits in a row, at full length
	LOOM_TEST_FULL=1 $(BUILD)/test_statistical --gtest_filter='Stability*:Blend*'

asan: ## unit and formats tests under AddressSanitizer and UndefinedBehaviorSanitizer
	@$(call compile,$(BUILD)-asan,-DCMAKE_BUILD_TYPE=Debug -DLOOM_SANITIZE=ON,test_unit test_formats)
	cd $(BUILD)-asan && ctest --output-on-failure --no-tests=error -R '^(unit|formats)$$'

bench: build ## measure throughput against a bare Embree loop
	$(BUILD)/bin/loom-bench

peers: stages ## (optional) Mitsuba 3 on SCENE, fetched from PyPI into a virtual environment; charts and reports then show it
	@[ -n $(python) ] || [ -e $(BUILD)/peers/ready ] || { $(call packages,install,peers mitsuba); python3 -m venv $(BUILD)/peers && \
		$(BUILD)/peers/bin/pip install -q mitsuba==3.8.0 >&2 && touch $(BUILD)/peers/ready; }
	@$(MAKE) --no-print-directory -f pipelines/peers.mk peers PYTHON=$(if $(PEERS_PYTHON),$(python),$(BUILD)/peers/bin/python)

peers-transient: stages ## (optional) mitransient on SCENE, fetched from PyPI: paths per second of both, and whether their cubes agree
	@[ -n $(python) ] || [ -e $(BUILD)/peers/ready-transient ] || { $(call packages,install,peers mitsuba); python3 -m venv $(BUILD)/peers && \
		$(BUILD)/peers/bin/pip install -q mitsuba==3.8.0 mitransient==1.3.1 h5py >&2 && touch $(BUILD)/peers/ready-transient; }
	@$(MAKE) --no-print-directory -f pipelines/peers-transient.mk peers-transient PYTHON=$(if $(PEERS_PYTHON),$(python),$(BUILD)/peers/bin/python)

oidn: ## (optional) Open Image Denoise for loom-denoise, fetched from PyPI into a folder beside the build's bin/
	@[ -e $(BUILD)/oidn/libOpenImageDenoise.so.2 ] || { $(call packages,install,peers); python3 -m venv $(BUILD)/oidn && \
		$(BUILD)/oidn/bin/pip install -q --no-deps pyoidn==2.5.1.0 >&2 && cd $(BUILD)/oidn && \
		ln -s lib/python3*/site-packages/pyoidn/oidn/lib/libOpenImageDenoise.so.2 .; }
	@echo $(BUILD)/oidn/libOpenImageDenoise.so.2

format: ## give all sources the shape that .clang-format says (clang-format 14)
	@sh tests/format.sh --fix

tools: ## install the Debian packages that are missing
	@$(call packages,install,build convenience)

build: ## compile everything, tests included
	@$(call compile,$(BUILD),-DCMAKE_BUILD_TYPE=Release)

stages: # what an image needs, without the tests
	@$(call compile,$(BUILD),-DCMAKE_BUILD_TYPE=Release,$(STAGES))

clean: ## remove build folders and out/
	rm -rf $(BUILD) $(BUILD)-asan out

help: ## list targets and variables
	@echo 'Targets:'
	@sed -n 's/^\([a-z-]*\):[^#]*## \(.*\)/\1\t\2/p' Makefile | sort | awk -F'\t' '{printf "  %-15s %s\n", $$1, $$2}'
	@echo 'Variables of demo and image:'
	@sed -n 's/^\([A-Z]*\) ?= *\(.*[^ ]\)  *## \(.*\)/\1=\2\t\3/p; s/^# *\([A-Z]*\)=  *## \(.*\)/\1=\t\2/p' \
		pipelines/still.mk | awk -F'\t' '{printf "  %-28s %s\n", $$1, $$2}'
	@echo 'Variables of transient:'
	@sed -n 's/^\([A-Z]*\) ?= *\(.*[^ ]\)  *## \(.*\)/\1=\2\t\3/p; s/^# *\([A-Z]*\)=  *## \(.*\)/\1=\t\2/p' \
		pipelines/transient.mk | awk -F'\t' '{printf "  %-28s %s\n", $$1, $$2}'
	@echo 'Variables of chart, report and peers, beside SCENE, DEFINES, SEED, THREADS, TRACE, LAUNCH and OUT (out/NAME/chart):'
	@sed -n 's/^# *\([A-Z_]*\)=  *## \(.*\)/\1=\t\2/p' pipelines/chart.mk pipelines/report.mk | awk -F'\t' '{printf "  %-28s %s\n", $$1, $$2}'
	@echo 'Variables of chart-transient, beside SCENE, DEFINES, SEED, THREADS, TRACE, LAUNCH, those of the cube and OUT (out/NAME/chart-transient):'
	@sed -n 's/^# *\([A-Z_]*\)=  *## \(.*\)/\1=\t\2/p' pipelines/chart-transient.mk | awk -F'\t' '{printf "  %-28s %s\n", $$1, $$2}'
	@echo 'Variables of chart-all, beside METHODS, SPPS, REPLICATES, COST, ERROR and OUT (out/chart-all):'
	@sed -n 's/^# *\([A-Z_]*\)=  *## \(.*\)/\1=\t\2/p' pipelines/chart-all.mk | awk -F'\t' '{printf "  %-28s %s\n", $$1, $$2}'
	@echo 'Variables of edit and edit-techniques:'
	@sed -n 's/^\([A-Z_]*\) ?= *\(.*[^ ]\)  *## \(.*\)/\1=\2\t\3/p; s/^# *\([A-Z_]*\)=  *## \(.*\)/\1=\t\2/p' \
		pipelines/edit.mk | awk -F'\t' '{printf "  %-28s %s\n", $$1, $$2}'
	@echo 'Variables of table-edit and edit-pictures, beside SEED and OUT (out/table-edit):'
	@sed -n 's/^# *\([A-Z_]*\)=  *## \(.*\)/\1=\t\2/p' pipelines/table-edit.mk | awk -F'\t' '{printf "  %-28s %s\n", $$1, $$2}'
	@echo 'Variables of chart-edit-cost, beside OUT (out/chart-edit-cost):'
	@sed -n 's/^# *\([A-Z_]*\)=  *## \(.*\)/\1=\t\2/p' pipelines/chart-edit-cost.mk | awk -F'\t' '{printf "  %-28s %s\n", $$1, $$2}'
	@echo 'Variables of the build:'
	@printf '  %-28s %s\n' 'BUILD=$(BUILD)' 'build folder' 'JOBS=$(JOBS)' 'compilations at a time' \
		PEERS_PYTHON=$(python) 'an interpreter that has mitsuba, for peers'
	@echo 'Example: make image SCENE=scenes/cornell-box.xml METHOD=pt SPP=64 DEFINES="resx=320 resy=320"'
