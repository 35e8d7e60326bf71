# Mitsuba 3 compared with ours on one scene, in OUT of chart.mk: later charts and reports include it.
#
#   OUT/peers.tsv             paths per second of loom-trace and of Mitsuba
#   OUT/peers/*/image.exr     images by Mitsuba at SPPS samples, REPLICATES of each, timed in turn
#
# PYTHON is PEERS_PYTHON of the Makefile, else the interpreter that it puts into the build folder.
## make peers SCENE=scenes/cornell-box.xml SPPS="1 4 16"

include pipelines/variables.mk
include pipelines/chart.mk

# PEERS_PYTHON=  ## interpreter with mitsuba (one in the build folder)
.DEFAULT_GOAL := peers
.PHONY: peers

# The JIT of Mitsuba's llvm variants loads LLVM at run time; versions other than 16 fail with Mitsuba 3.8.
export DRJIT_LIBLLVM_PATH ?= $(wildcard /usr/lib/x86_64-linux-gnu/libLLVM-16.so.1)

peers:
	$(call quote,$(PYTHON)) tests/peers/throughput.py $(call quote,$(SCENE)) --trace $(BUILD)/bin/loom-trace --out $(OUT) \
		$(if $(SPP),--spp $(SPP)) $(if $(THREADS),--threads $(THREADS)) --images '$(SPPS)' \
		--replicates $(REPLICATES) $(call defines,-D,$(DEFINES))
	@echo $(OUT)/peers.tsv
