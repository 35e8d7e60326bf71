# Mitsuba's derivative of a steady image compared with ours at equal CPU time: OUT/derive.tsv, mean, MSE and CPU seconds of both.
#
# SCENE has one parameter theta that moves the shape `occluder` along x. Without SCENE: ../shared/oracles/derivative, with its image of
# differences as reference. PYTHON is PEERS_PYTHON of the Makefile, else the interpreter that it puts into the build folder.
## make peers-derive PEERS_PYTHON=/usr/bin/python3
## Also SCENE, SPP, DEPTH, GUIDING, and OUT (out/peers-derive)

.DELETE_ON_ERROR:
.PHONY: peers-derive
.DEFAULT_GOAL := peers-derive
include pipelines/variables.mk

# PEERS_PYTHON=  ## interpreter with mitsuba and h5py (one in the build folder)
# DEPTH=  ## longest path in edges; above 2 by prb_projective, and each program is judged by the other (2)
# GUIDING=  ## octree, grid or none: of Mitsuba's silhouette samples (octree)
BUILD ?= build
OUT ?= out/peers-derive
OUT := $(OUT)
include pipelines/words.mk

oracles := ../shared/oracles/derivative
ifeq ($(SCENE),)
SCENE := $(oracles)/translate_occluder_area_light.xml
reference := $(if $(filter-out 2,$(DEPTH)),,$(wildcard $(oracles)/refs/translate_occluder_area_light_fwd.exr))
endif
ifeq ($(call exists,$(SCENE)),)
$(error SCENE=$(SCENE): no such file; give a scene whose parameter theta moves the shape occluder along x)
endif

# The JIT of Mitsuba's llvm variants loads LLVM at run time; versions other than 16 fail with Mitsuba 3.8.
export DRJIT_LIBLLVM_PATH ?= $(wildcard /usr/lib/x86_64-linux-gnu/libLLVM-16.so.1)

peers-derive:
	$(call quote,$(PYTHON)) tests/peers/derive.py $(call quote,$(SCENE)) --bin $(BUILD)/bin --out $(OUT) $(if $(SPP),--spp $(SPP)) \
		$(if $(DEPTH),--depth $(DEPTH)) $(if $(GUIDING),--guiding $(GUIDING)) \
		$(if $(reference),--reference $(reference))
	@[ ! -e $(OUT)/derive.tsv ] || echo $(OUT)/derive.tsv
