# One image of one scene: OUT/image.exr, and a PNG beside it.
#
#   METHOD=pathgraph   per pass: trace a path graph, cluster its vertices, let them share their light (refine),
#                      gather an image;  then merge the passes, blended with the paths' own samples
#   METHOD=west        the same with the single filter of West et al. instead of clusters and iteration
#   METHOD=graph       per pass: trace a path graph, gather its own paths' samples;  then merge the passes
#   METHOD=pt          per pass: trace an image;                                     then merge the passes
#
# Pass i takes samples [i SPP, (i+1) SPP) of every pixel, so passes can be added later, made on other
# machines or made again alone. Parameters are prerequisites: a change of one remakes what depends on it.
## make image SCENE=scenes/cornell-box.xml METHOD=pt SPP=64 DEFINES="resx=320 resy=320"

.DELETE_ON_ERROR:
.PHONY: image
.DEFAULT_GOAL := image
include pipelines/variables.mk

SCENE ?= scenes/cornell-box.xml  ## scene file (Mitsuba XML)
METHOD ?= pathgraph  ## pathgraph, west, graph, or pt: path tracing without a graph
# PASSES=  ## number of passes to merge (pathgraph, west: 4, with fewer no blend; else 1)
# SPP=  ## samples per pixel of each pass (4; pt: 16)
BATCH ?= 4  ## passes traced by one process; with a graph, that many lie on disk at a time
# K=  ## vertices of a cluster, or neighbours of west (16 sqrt(SPP), at most 128)
ITERATIONS ?= 6  ## steps of the refinement
# CLUSTER=  ## further options of loom-cluster: CLUSTER="--method centres"
# REFINE=  ## further options of loom-refine: REFINE="--reuse points"
# GATHER=  ## further options of loom-gather: GATHER="--direct own --indirect subset --members 8 --occlusion"
# DIRECT=  ## further samples of direct light for the blend of pathgraph, 0: none (as many as pay off)
# MERGE=  ## further options of loom-merge: MERGE=--no-blend
# DENOISE=  ## 1: also denoise the image, into OUT/clean.exr
# SEED=  ## seed of all random numbers (0)
# THREADS=  ## threads of each stage; no result depends on it (all)
# DEFINES=  ## values of the scene's parameters: DEFINES="resx=320 resy=180"
# SENSOR=  ## sensor of the scene, by id or by number from 0 (the first)
# TRACE=  ## further options of loom-trace: TRACE="--roulette throughput"
# EXPOSURE=  ## exposure of the PNG, in stops (0)
# OUT=  ## folder of the results (out/NAME, NAME from the scene)
# KEEP=  ## 1: keep the graphs of all passes (only the last)
# LAUNCH=  ## command to put before each stage: LAUNCH="srun -c8"
BUILD ?= build
SCENE := $(strip $(SCENE))
METHOD := $(strip $(METHOD))
refined := $(filter pathgraph west,$(METHOD))
SPP ?= $(if $(filter pt,$(METHOD)),16,4)
PASSES ?= $(if $(refined),4,1)
BATCH := $(strip $(BATCH))
ITERATIONS := $(strip $(ITERATIONS))

ifeq ($(filter pathgraph west graph pt,$(METHOD)),)
$(error METHOD=$(METHOD): must be pathgraph, west, graph or pt)
endif
folder := $(METHOD)
kind := $(if $(filter pt,$(METHOD)),exr,h5)
made := exr
include pipelines/passes.mk
K ?= $(default_k)
K := $(K)

refine := $(BUILD)/bin/loom-refine
denoise := $(BUILD)/bin/loom-denoise
gather := $(BUILD)/bin/loom-gather
merge := $(BUILD)/bin/loom-merge
passes := $(numbers:%=$(work)/pass-%.exr)
graphs := $(numbers:%=$(work)/pass-%.h5)
clusters := $(if $(filter pathgraph,$(METHOD)),$(numbers:%=$(work)/pass-%.clusters.h5))
radiances := $(if $(refined),$(numbers:%=$(work)/pass-%.radiance.h5))
traced := $(if $(filter pt,$(METHOD)),$(passes),$(graphs))
clean := $(if $(filter-out 0,$(DENOISE)),$(OUT)/clean.exr $(OUT)/clean.png)

image: $(OUT)/image.exr $(OUT)/image.png $(clean)
	@echo $<

# A graph is as large as its image is small: once gathered it goes, but for the last, which stays to be
# inspected. Secondary: a missing graph is not traced again.
.SECONDARY: $(graphs) $(clusters) $(radiances)

$(if $(clusters),$(eval $(cluster_passes)))

refine_parameters = $(if $(filter west,$(METHOD)),--method west --neighbours $(K),--iterations $(ITERATIONS))$(if $(REFINE), $(REFINE))
$(eval $(call parameter,$(work)/refine.parameters,$(refine_parameters)))
$(radiances): $(work)/pass-%.radiance.h5: $(work)/pass-%.h5 $(if $(clusters),$(work)/pass-%.clusters.h5) $(work)/refine.parameters $(refine)
	$(LAUNCH) $(refine) $(filter %.h5,$^) $(refine_parameters) -o $@$(threads)

ifneq ($(METHOD),pt)
gather_parameters = $(if $(refined),--estimates)$(if $(GATHER), $(GATHER))$(if $(filter --occlusion,$(GATHER)), --scene $(scene_parameters))
gather_clusters := $(if $(filter subset,$(GATHER)),$(clusters))
$(eval $(call parameter,$(work)/gather.parameters,$(gather_parameters)))
$(passes): $(work)/pass-%.exr: $(work)/pass-%.h5 $(if $(refined),$(work)/pass-%.radiance.h5) $(if $(gather_clusters),$(work)/pass-%.clusters.h5) \
		$(work)/gather.parameters $(gather)
	$(LAUNCH) $(gather) $(filter %.h5,$^) $(gather_parameters) -o $@$(threads)
	$(if $(filter $(last),$*)$(filter-out 0,$(KEEP)),,rm -f $(filter %.h5,$^) $(if $(clusters),$(work)/pass-$*.clusters.h5))
endif

# Direct light by itself, of samples that no pass has: another seed. A blend takes four passes. The passes determine the
# number of samples, if DIRECT does not; where none pay off the file is empty.
DIRECT ?= auto
ifeq ($(filter auto 0,$(DIRECT))$(call is_whole,$(DIRECT)),)
$(error DIRECT=$(DIRECT): must be auto or a whole number from 0)
endif
direct := $(if $(refined),$(if $(filter 0,$(DIRECT))$(filter --no-blend,$(MERGE)),,$(shell [ $(PASSES) -ge 4 ] && echo $(work)/direct.exr)))
direct_samples := $(work)/direct.samples
direct_parameters = $(common_parameters) --max-depth 2 --seed $(shell echo $$(($(or $(SEED),0) + 1000003)))
$(eval $(call parameter,$(work)/direct.parameters,$(if $(direct),$(direct_parameters) --spp $(DIRECT))))
$(direct_samples): $(passes) $(work)/direct.parameters $(merge)
	$(if $(filter auto,$(DIRECT)),$(LAUNCH) $(merge) $(passes) --plan-direct >$@,echo $(DIRECT) >$@)
$(work)/direct.exr: $(scene_stamp) $(direct_samples) $(trace)
	n=$$(cat $(direct_samples)); if [ $$n = 0 ]; then : >$@; else $(LAUNCH) $(trace) $(direct_parameters) --spp $$n$(threads) -o $@; fi

$(eval $(call parameter,$(OUT)/image.parameters,$(METHOD) $(PASSES)$(if $(MERGE), $(MERGE))$(if $(direct), $(DIRECT))))
$(OUT)/image.exr: $(passes) $(direct) $(OUT)/image.parameters $(merge)
	$(LAUNCH) $(merge) $(passes)$(if $(direct), $$([ -s $(direct) ] && echo --direct $(direct)))$(if $(MERGE), $(MERGE)) -o $@

$(OUT)/clean.exr: $(OUT)/image.exr $(denoise)
	$(LAUNCH) $(denoise) $< -o $@$(threads)

$(eval $(call parameter,$(OUT)/preview.parameters,$(EXPOSURE)))
$(OUT)/image.png $(OUT)/clean.png: $(OUT)/%.png: $(OUT)/%.exr $(OUT)/preview.parameters $(inspect)
	$(LAUNCH) $(inspect) $< --png $@$(if $(EXPOSURE), --exposure $(EXPOSURE))
