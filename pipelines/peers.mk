# Mitsuba 3 beside ours on one scene, for OUT of chart.mk: charts and reports made afterwards have it among them.
#
#   OUT/peers.tsv             paths per second of loom-trace and of Mitsuba
#   OUT/peers/*/image.exr     images by Mitsuba at SPPS samples, REPLICATES of each, timed in turn
#
# PYTHON=  an interpreter that has mitsuba; make peers puts one into the build folder.

include pipelines/variables.mk
include pipelines/chart.mk
.DEFAULT_GOAL := peers
.PHONY: peers

# The JIT of Mitsuba's llvm variants loads LLVM at run time; versions other than 16 fail with Mitsuba 3.8.
export DRJIT_LIBLLVM_PATH ?= $(wildcard /usr/lib/x86_64-linux-gnu/libLLVM-16.so.1)

peers:
	$(call quote,$(PYTHON)) tests/peers/throughput.py $(call quote,$(SCENE)) --trace $(BUILD)/bin/loom-trace --out $(OUT) \
		$(if $(SPP),--spp $(SPP)) $(if $(THREADS),--threads $(THREADS)) --pictures '$(SPPS)' \
		--replicates $(REPLICATES) $(call defines,-D,$(DEFINES))
	@echo $(OUT)/peers.tsv
