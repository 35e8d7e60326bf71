# The image of an edited scene from that of the scene before: OUT/new.exr = OLD's image + OUT/residual.exr.
#
# OLD's image depends on OLD, its values, BASE_SPP and SEED alone and lies in BASE, so that many edits of one scene
# share it: give each its own OUT and all the same BASE. Edits after edits: OLD_PICTURE=FIRST/new.exr, where OLD and its
# values are the NEW of the edit in FIRST; nothing is then traced but the difference, and OUT/new.exr has a ledger of all edits.
# GRAPH stores OLD's paths in BASE, too, 300 to 500 bytes per sample, and each edit traces only those that it touches.

.DELETE_ON_ERROR:
.PHONY: edit edit-techniques
.DEFAULT_GOAL := edit
include pipelines/variables.mk

OLD ?= scenes/cornell-box.xml  ## scene before the edit
# NEW=  ## scene after the edit (OLD, with NEW_DEFINES)
METHOD ?= auto  ## of the residual: correlated, independent, dynamic, auto, or graph: the difference of two path graphs, biased a little
SPP ?= 16  ## pairs of paths per pixel of the residual, auto: or what they would cost; graph: of each of its PASSES
# MAP=  ## of auto: 0: as many camera paths in every pixel
# CONTROL=  ## of auto: 0: the new image is the old one plus the residual; else the old one gets the weight that makes the sum least noisy
# PASSES=  ## of graph: passes, whose spread is its variance (4)
# K=  ## of graph: vertices of a cluster (as of make image)
# ITERATIONS=  ## of graph: steps of the refinement (6)
# GRAPH=  ## of correlated paths: 1: those of a graph of OLD, SPP samples of their own; same: the very samples of OLD's image, so that new.exr is what these are in NEW
# GRAPH_SEED=  ## of GRAPH=1, other than that of OLD's image and of edits before (one more than the image's)
# UNBIASED=  ## of graph: 1: what the paths of some passes say beyond it is added, which leaves no bias and most of their noise
# CLUSTER=  ## of graph: further options of loom-cluster; REFINE, GATHER, MERGE likewise
# KEEP=  ## of graph: 1: keep the graphs
BASE_SPP ?= 64  ## samples per pixel of OLD's image
# DEFINES=  ## values of the parameters of both scenes
# OLD_DEFINES=  ## values of OLD only
# NEW_DEFINES=  ## values of NEW only: NEW_DEFINES="light=20"
# SENSOR=  ## sensor of both scenes, by id or by number from 0 (the first)
# SEED=  ## seed of the random numbers
# DENOISE=  ## 1: the residual without its noise (loom-denoise), biased a little; the one with it is OUT/noisy.exr
# BASE_SEED=  ## of OLD's image, where it must not change with that of the residual (SEED)
# THREADS=  ## threads of a stage (all); no result depends on it
# EXPOSURE=  ## of the PNGs, in stops
# OUT=  ## folder of the results (out/NAME/edit, after NEW)
# OLD_PICTURE=  ## image of OLD: the new.exr of an edit before (old.exr in BASE, traced); not for graph, whose bias would add up unseen
# BASE=  ## folder of OLD's image (out/NAME/base, after OLD and its values)
# LAUNCH=  ## put before each stage
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
$(error GRAPH=$(GRAPH): is for METHOD=correlated, not $(METHOD))
endif
ifneq ($(and $(filter same,$(GRAPH)),$(OLD_PICTURE)),)
$(error GRAPH=same OLD_PICTURE=$(OLD_PICTURE): that picture is a sum, of more samples than a graph's; take GRAPH=1)
endif
missing := $(foreach v,OLD NEW $(if $(OLD_PICTURE),OLD_PICTURE),$(if $(call exists,$($(v))),,$(v)=$($(v))))
ifneq ($(strip $(missing)),)
$(error $(strip $(missing)): no such file)
endif

base_seed := $(or $(BASE_SEED),$(SEED))
of_old = $(call quote,$(OLD))$(call defines,-D,$(DEFINES) $(OLD_DEFINES))$(sensor)
old_parameters = $(of_old) --spp $(BASE_SPP)$(if $(base_seed), --seed $(base_seed))
graph_seed = $(or $(GRAPH_SEED),$(shell echo $$(($(or $(base_seed),0) + 1))))
graph_parameters = $(if $(filter same,$(GRAPH)),$(old_parameters),$(of_old) --spp $(SPP) --seed $(graph_seed)) --misses
edit_parameters = $(scene_parameters) --method $(METHOD)$(if $(filter 0,$(MAP)), --no-map)$(if $(filter 0,$(CONTROL)), --no-control) \
	$(if $(GRAPH),--old-graph $(BASE)/graph.h5,--spp $(SPP)$(if $(SEED), --seed $(SEED))) --old $(call quote,$(picture))

# A base with other values lies in another folder.
OUT ?= out/$(call scene_name,$(NEW))/edit
OUT := $(OUT)
BASE ?= out/$(call scene_name,$(OLD))/base-$(shell printf '%s' $(call quote,$(old_parameters)) | cksum | cut -d' ' -f1)
BASE := $(BASE)
picture := $(or $(OLD_PICTURE),$(BASE)/old.exr)
ifneq ($(OLD_PICTURE),)
ifeq ($(METHOD),graph)
$(error METHOD=graph OLD_PICTURE=$(OLD_PICTURE): the bias of path graphs would add up unseen; take another METHOD, or OLD without OLD_PICTURE)
endif
ifeq ($(shell realpath -m $(call quote,$(OLD_PICTURE))),$(shell realpath -m $(OUT)/new.exr))
$(error OLD_PICTURE=$(OLD_PICTURE): is what this edit makes; give another OUT)
endif
endif

denoised := $(filter-out 0,$(DENOISE))
# What the method makes.
found := $(OUT)/$(if $(denoised),noisy,residual).exr
trace := $(BUILD)/bin/loom-trace
denoise := $(BUILD)/bin/loom-denoise
residual := $(BUILD)/bin/loom-residual
threads = $(if $(THREADS), --threads $(THREADS))

edit: $(OUT)/new.exr $(OUT)/new.png
	@echo $<

# The contents of both scenes, and of an image that is given, whose scene BASE need not have.
base_stamp := $(BASE)/old.stamp
old_stamp := $(if $(OLD_PICTURE),$(OUT),$(BASE))/old.stamp
new_stamp := $(OUT)/new.stamp
picture_made := $(if $(OLD_PICTURE),$(OUT)/picture.stamp,$(BASE)/old.exr)
$(foreach s,$(sort $(base_stamp) $(old_stamp)),$(eval $(call stamp,$(s),--scene $(of_old))))
$(eval $(call stamp,$(new_stamp),--scene $(call quote,$(NEW))$(call defines,-D,$(DEFINES) $(NEW_DEFINES))$(sensor)))
$(if $(OLD_PICTURE),$(eval $(call stamp,$(OUT)/picture.stamp,$(call quote,$(OLD_PICTURE)))))

$(eval $(call parameter,$(BASE)/old.parameters,$(old_parameters)))
$(BASE)/old.exr: $(base_stamp) $(BASE)/old.parameters $(trace)
	$(LAUNCH) $(trace) $(old_parameters)$(threads) -o $@

ifneq ($(GRAPH),)
$(eval $(call parameter,$(BASE)/graph.parameters,$(graph_parameters)))
$(BASE)/graph.h5: $(base_stamp) $(BASE)/graph.parameters $(trace)
	$(LAUNCH) $(trace) $(graph_parameters)$(threads) -o $@
endif

scene_parameters = $(call quote,$(OLD)) $(call quote,$(NEW))$(call defines,-D,$(DEFINES))$(call defines,--old-define,$(OLD_DEFINES))$(call defines,--new-define,$(NEW_DEFINES))$(sensor)
edited := $(old_stamp) $(new_stamp) $(picture_made) $(GRAPH:%=$(BASE)/graph.h5)
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
$(OUT)/new.exr: $(OUT)/residual.exr $(picture_made) $(OUT)/edit.parameters $(residual)
	$(LAUNCH) $(residual) $(scene_parameters) --residual $(OUT)/residual.exr --old $(call quote,$(picture)) \
		--residual-png $(OUT)/residual.png --new $(OUT)/new.exr
endif

$(eval $(call parameter,$(OUT)/preview.parameters,$(EXPOSURE)))
$(OUT)/new.png: $(OUT)/new.exr $(OUT)/preview.parameters $(inspect)
	$(LAUNCH) $(inspect) $< --png $@$(if $(EXPOSURE), --exposure $(EXPOSURE))

# What each technique of dynamic paths finds by itself, weighted against the others and raw, in false colours.   [RP] Fig. 3
technique_parameters = $(scene_parameters) --method dynamic --spp $(SPP)$(if $(SEED), --seed $(SEED))$(threads)
edit-techniques: $(residual)
	@mkdir -p $(OUT)/techniques
	@names=$$($(residual) --quiet $(technique_parameters) --technique list) && for name in $$names; do for how in weighted raw; do \
		picture=$(OUT)/techniques/$$name-$$how; raw=; [ $$how = weighted ] || raw=--raw; \
		$(LAUNCH) $(residual) $(technique_parameters) --technique $$name $$raw -o $$picture.exr --residual-png $$picture.png || exit; \
		echo $$picture.png; done; done

