# mitransient compared with ours on one time-resolved scene: OUT/rates.tsv, paths per second of both, OUT/mitransient.h5, its cube, and
# the comparison with our cube (PASSES graphs of independent samples) by loom-compare; fails when they differ by more than noise.
#
# PYTHON is PEERS_PYTHON of the Makefile, else the interpreter that it puts into the build folder.
## make peers-transient SCENE=scenes/flash.xml DEFINES="resx=64 resy=64"
## Also SPP, THREADS, and OUT (out/NAME/peers-transient)

.DELETE_ON_ERROR:
.PHONY: peers-transient
.DEFAULT_GOAL := peers-transient
include pipelines/variables.mk

# PEERS_PYTHON=  ## interpreter with mitransient and h5py (one in the build folder)
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
