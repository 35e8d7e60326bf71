# The image of an edited scene from that of the scene before: OUT/new.exr = OLD's image + OUT/residual.exr.
#
# OLD's image depends on OLD, its values, BASE_SPP and SEED alone and lies in BASE, so that many edits of one scene
# share it: give each its own OUT and all the same BASE. Edits after edits: OLD_IMAGE=FIRST/new.exr, where OLD and its
# values are the NEW of the edit in FIRST; only the difference is then traced, and OUT/new.exr has a ledger of all edits.
# GRAPH stores OLD's paths in BASE, too, 300 to 500 bytes per sample, and each edit traces only those that it touches.
## make edit OLD=scenes/cornell-box.xml NEW_DEFINES="light=20,10,5" OUT=out/warm

.DELETE_ON_ERROR:
.PHONY: edit edit-techniques
.DEFAULT_GOAL := edit
include pipelines/variables.mk

OLD ?= scenes/cornell-box.xml  ## scene before the edit
# NEW=  ## scene after the edit (OLD, with NEW_DEFINES)
METHOD ?= auto  ## method of the residual: auto, correlated, independent, dynamic, or graph: difference of two path graphs, slightly biased
SPP ?= 16  ## pairs of paths per pixel of the residual; auto: their cost is its budget; graph: of each of its PASSES
# MAP=  ## auto: 0: spread camera paths evenly over the pixels (1)
# MASK=  ## weight of OLD's image in the new one: none: 1; GRAPH: first-hit, 0 where the camera sees a change; see loom-residual (coverage)
# PASSES=  ## graph: number of passes, whose spread is the variance (4)
# K=  ## graph: vertices of a cluster (as for make image)
# ITERATIONS=  ## graph: steps of the refinement (6)
# GRAPH=  ## correlated: 1: reuse a stored graph of OLD with SPP samples; same: reuse the samples of OLD's image (none)
# GRAPH_SEED=  ## GRAPH=1: seed of the graph, unlike that of OLD's image and of earlier edits (image's + 1)
# UNBIASED=  ## graph: 1: correct the bias by the own paths of some passes, which brings most of their noise back (0)
# CLUSTER=  ## graph: further options of loom-cluster; REFINE, GATHER, MERGE likewise
# KEEP=  ## graph: 1: keep the graphs (0)
BASE_SPP ?= 64  ## samples per pixel of OLD's image
# DEFINES=  ## values of the parameters of both scenes
# OLD_DEFINES=  ## values of OLD only
# NEW_DEFINES=  ## values of NEW only: NEW_DEFINES="light=20"
# SENSOR=  ## sensor of both scenes, by id or by number from 0 (the first)
# SEED=  ## seed of all random numbers (0)
# DENOISE=  ## 1: denoise the residual with loom-denoise, slightly biased; the noisy one is OUT/noisy.exr (0)
# BASE_SEED=  ## seed of OLD's image, if it is not that of the residual (SEED)
# THREADS=  ## threads of each stage; no result depends on it (all)
# EXPOSURE=  ## exposure of the PNGs, in stops (0)
# OUT=  ## folder of the results (out/NAME/edit, NAME from NEW)
# OLD_IMAGE=  ## image of OLD: the new.exr of an earlier edit; not with METHOD=graph (BASE/old.exr, traced)
# BASE=  ## folder of OLD's image (out/NAME/base, from OLD and its values)
# LAUNCH=  ## command to put before each stage: LAUNCH="srun -c8"
OLD_IMAGE ?= $(OLD_PICTURE)
BUILD ?= build
OLD := $(strip $(OLD))
NEW ?= $(OLD)
METHOD := $(strip $(METHOD))
SPP := $(strip $(SPP))
BASE_SPP := $(strip $(BASE_SPP))

include pipelines/words.mk

ifeq ($(filter auto correlated independent dynamic graph,$(METHOD)),)
$(error METHOD=$(METHOD): must be auto, correlated, independent, dynamic or graph)
endif
ifneq ($(filter-out 1 same,$(GRAPH)),)
$(error GRAPH=$(GRAPH): must be 1 or same)
endif
ifneq ($(and $(GRAPH),$(filter-out auto correlated,$(METHOD))),)
$(error GRAPH=$(GRAPH): needs METHOD=correlated, not $(METHOD))
endif
ifneq ($(and $(filter same,$(GRAPH)),$(OLD_IMAGE)),)
$(error GRAPH=same OLD_IMAGE=$(OLD_IMAGE): that image is a sum with more samples than the graph; give GRAPH=1)
endif
missing := $(foreach v,OLD NEW $(if $(OLD_IMAGE),OLD_IMAGE),$(if $(call exists,$($(v))),,$(v)=$($(v))))
ifneq ($(strip $(missing)),)
$(error $(strip $(missing)): no such file)
endif

base_seed := $(or $(BASE_SEED),$(SEED))
of_old = $(call quote,$(OLD))$(call defines,-D,$(DEFINES) $(OLD_DEFINES))$(sensor)
old_parameters = $(of_old) --spp $(BASE_SPP)$(if $(base_seed), --seed $(base_seed))
graph_seed = $(or $(GRAPH_SEED),$(shell echo $$(($(or $(base_seed),0) + 1))))
graph_parameters = $(if $(filter same,$(GRAPH)),$(old_parameters),$(of_old) --spp $(SPP) --seed $(graph_seed)) --misses
edit_parameters = $(scene_parameters) --method $(METHOD)$(if $(filter 0,$(MAP)), --no-map)$(if $(strip $(MASK)), --mask $(strip $(MASK))) \
	$(if $(GRAPH),--old-graph $(BASE)/graph.h5,--spp $(SPP)$(if $(SEED), --seed $(SEED))) --old $(call quote,$(old_image))

# A base with other values lies in another folder.
OUT ?= out/$(call scene_name,$(NEW))/edit
OUT := $(OUT)
BASE ?= out/$(call scene_name,$(OLD))/base-$(shell printf '%s' $(call quote,$(old_parameters)) | cksum | cut -d' ' -f1)
BASE := $(BASE)
old_image := $(or $(OLD_IMAGE),$(BASE)/old.exr)
ifneq ($(OLD_IMAGE),)
ifeq ($(METHOD),graph)
$(error METHOD=graph OLD_IMAGE=$(OLD_IMAGE): the bias of path graphs would add up unnoticed; give another METHOD, or OLD without OLD_IMAGE)
endif
ifeq ($(shell realpath -m $(call quote,$(OLD_IMAGE))),$(shell realpath -m $(OUT)/new.exr))
$(error OLD_IMAGE=$(OLD_IMAGE): is an output of this edit; give another OUT)
endif
endif

denoised := $(filter-out 0,$(DENOISE))
# Output of the method.
found := $(OUT)/$(if $(denoised),noisy,residual).exr
trace := $(BUILD)/bin/loom-trace
denoise := $(BUILD)/bin/loom-denoise
residual := $(BUILD)/bin/loom-residual
threads = $(if $(THREADS), --threads $(THREADS))

edit: $(OUT)/new.exr $(OUT)/new.png
	@echo $<

# The contents of both scenes, and of an image that is given, whose scene BASE need not have.
base_stamp := $(BASE)/old.stamp
old_stamp := $(if $(OLD_IMAGE),$(OUT),$(BASE))/old.stamp
new_stamp := $(OUT)/new.stamp
old_image_made := $(if $(OLD_IMAGE),$(OUT)/old-image.stamp,$(BASE)/old.exr)
$(foreach s,$(sort $(base_stamp) $(old_stamp)),$(eval $(call stamp,$(s),--scene $(of_old))))
$(eval $(call stamp,$(new_stamp),--scene $(call quote,$(NEW))$(call defines,-D,$(DEFINES) $(NEW_DEFINES))$(sensor)))
$(if $(OLD_IMAGE),$(eval $(call stamp,$(OUT)/old-image.stamp,$(call quote,$(OLD_IMAGE)))))

$(eval $(call parameter,$(BASE)/old.parameters,$(old_parameters)))
$(BASE)/old.exr: $(base_stamp) $(BASE)/old.parameters $(trace)
	$(LAUNCH) $(trace) $(old_parameters)$(threads) -o $@

ifneq ($(GRAPH),)
$(eval $(call parameter,$(BASE)/graph.parameters,$(graph_parameters)))
$(BASE)/graph.h5: $(base_stamp) $(BASE)/graph.parameters $(trace)
	$(LAUNCH) $(trace) $(graph_parameters)$(threads) -o $@
endif

scene_parameters = $(call quote,$(OLD)) $(call quote,$(NEW))$(call defines,-D,$(DEFINES))$(call defines,--old-define,$(OLD_DEFINES))$(call defines,--new-define,$(NEW_DEFINES))$(sensor)
edited := $(old_stamp) $(new_stamp) $(old_image_made) $(GRAPH:%=$(BASE)/graph.h5)
$(eval $(call parameter,$(OUT)/edit.parameters,$(if $(filter graph,$(METHOD)),graph,$(edit_parameters))$(denoised:%= denoised)))
ifeq ($(METHOD),graph)
include pipelines/edit-graph.mk
else ifneq ($(denoised),)
$(found): $(edited) $(OUT)/edit.parameters $(residual)
	$(LAUNCH) $(residual) $(edit_parameters)$(threads) -o $@
else
$(OUT)/new.exr $(found) &: $(edited) $(OUT)/edit.parameters $(residual)
	$(LAUNCH) $(residual) $(edit_parameters)$(threads) \
		-o $(found) --residual-png $(OUT)/residual.png --new $(OUT)/new.exr
endif
ifneq ($(denoised),)
$(OUT)/residual.exr: $(found) $(denoise)
	$(LAUNCH) $(denoise) $< -o $@$(threads)
endif
ifneq ($(denoised)$(filter graph,$(METHOD)),)
$(OUT)/new.exr: $(OUT)/residual.exr $(old_image_made) $(OUT)/edit.parameters $(residual)
	$(LAUNCH) $(residual) $(scene_parameters) --residual $(OUT)/residual.exr --old $(call quote,$(old_image)) \
		--residual-png $(OUT)/residual.png --new $(OUT)/new.exr
endif

$(eval $(call parameter,$(OUT)/preview.parameters,$(EXPOSURE)))
$(OUT)/new.png: $(OUT)/new.exr $(OUT)/preview.parameters $(inspect)
	$(LAUNCH) $(inspect) $< --png $@$(if $(EXPOSURE), --exposure $(EXPOSURE))

# Paths that each technique of dynamic paths finds, weighted against the others and raw, in false colours.   [RP] Fig. 3
technique_parameters = $(scene_parameters) --method dynamic --spp $(SPP)$(if $(SEED), --seed $(SEED))$(threads)
edit-techniques: $(residual)
	@mkdir -p $(OUT)/techniques
	@names=$$($(residual) --quiet $(technique_parameters) --technique list) && for name in $$names; do for how in weighted raw; do \
		png=$(OUT)/techniques/$$name-$$how; raw=; [ $$how = weighted ] || raw=--raw; \
		$(LAUNCH) $(residual) $(technique_parameters) --technique $$name $$raw -o $$png.exr --residual-png $$png.png || exit; \
		echo $$png.png; done; done

