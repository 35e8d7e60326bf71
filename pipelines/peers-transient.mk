# mitransient beside ours on one time-resolved scene: OUT/rates.tsv, paths per second of both, OUT/mitransient.h5, its cube, and
# what loom-compare says of our cube (of PASSES graphs of independent samples) beside it; fails when they differ by more than
# noise.
#
# PYTHON=  an interpreter that has mitransient and h5py; make peers-transient puts one into the build folder.

.DELETE_ON_ERROR:
.PHONY: peers-transient
.DEFAULT_GOAL := peers-transient
include pipelines/variables.mk

SCENE ?= scenes/flash.xml
DEFINES ?= resx=64 resy=64
BUILD ?= build
include pipelines/words.mk
OUT ?= out/$(call scene_name,$(SCENE))/peers-transient
OUT := $(OUT)

# The JIT of Mitsuba's llvm variants loads LLVM at run time; versions other than 16 fail with Mitsuba 3.8.
export DRJIT_LIBLLVM_PATH ?= $(wildcard /usr/lib/x86_64-linux-gnu/libLLVM-16.so.1)

peers-transient:
	$(call quote,$(PYTHON)) tests/peers/transient.py $(call quote,$(SCENE)) --bin $(BUILD)/bin --out $(OUT) $(if $(SPP),--spp $(SPP)) \
		$(if $(THREADS),--threads $(THREADS)) $(call defines,-D,$(DEFINES))
	@[ ! -e $(OUT)/mitransient.h5 ] || { $(MAKE) -s --no-print-directory -f pipelines/transient.mk DEFINES=$(call quote,$(DEFINES)) SPP=64 PASSES=16 \
		SAMPLER=independent OUT=$(OUT)/ours cube >/dev/null && $(BUILD)/bin/loom-compare ours=$(OUT)/ours/cube.h5 --reference $(OUT)/mitransient.h5 \
		--fail-below p_bins=1e-4 --fail-below p_tiles=1e-4; }
