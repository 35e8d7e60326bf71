# One picture of one scene: OUT/image.exr, and a PNG beside it.
#
#   METHOD=graph   per pass: trace a path graph, gather it into an image;  then merge the passes
#   METHOD=pt      per pass: trace an image;                               then merge the passes
#
# Pass i takes samples [i SPP, (i+1) SPP) of every pixel, so passes can be added later, made on other
# machines or made again alone. Parameters are prerequisites: a change of one remakes what depends on it.

.DELETE_ON_ERROR:
.PHONY: image demo FORCE
.DEFAULT_GOAL := image

SCENE ?= scenes/cornell-box.xml  ## scene file, Mitsuba XML
METHOD ?= graph  ## graph, or pt: path tracing without a graph
PASSES ?= 1  ## passes to merge (the demo: 4)
# SPP=  ## samples per pixel of each pass (4; METHOD=pt: 16)
# SEED=  ## seed of the random numbers
# THREADS=  ## threads of a stage (all); no result depends on it
# DEFINES=  ## values of the scene's parameters: DEFINES="resx=320 resy=180"
# TRACE=  ## further options of loom-trace: TRACE="--roulette throughput"
# EXPOSURE=  ## of the PNG, in stops
# OUT=  ## folder of the results (out/NAME, after the scene)
# KEEP=  ## 1: keep the graphs of all passes, not only of the last
# LAUNCH=  ## put before each stage: LAUNCH="srun -c8"
BUILD ?= build
SCENE := $(strip $(SCENE))
METHOD := $(strip $(METHOD))
SPP := $(or $(strip $(SPP)),$(if $(filter pt,$(METHOD)),16,4))
PASSES := $(strip $(PASSES))

empty :=
space := $(empty) $(empty)
quote = '$(subst ','\'',$(1))'

ifeq ($(filter pt graph,$(METHOD)),)
$(error METHOD=$(METHOD): must be graph or pt)
endif
ifneq ($(shell printf '%s\n' $(call quote,$(SPP)) $(call quote,$(PASSES)) | grep -cxE '[1-9][0-9]{0,8}'),2)
$(error SPP=$(SPP) PASSES=$(PASSES): must be whole numbers from 1)
endif
ifeq ($(shell test -f $(call quote,$(SCENE)) && echo there),)
$(error SCENE=$(SCENE): no such file)
endif

# scenes/veach-ajar/scene_v3.xml is called veach-ajar-v3, scenes/mirror.xml mirror.
OUT := $(or $(strip $(OUT)),out/$(shell realpath -s $(call quote,$(SCENE)) | sed -E \
	's/[.]xml$$//; s,.*/([^/]+)/scene_?([^/]*)$$,\1-\2,; s,-$$,,; s,.*/,,' | tr -c 'A-Za-z0-9._+\n-' _))
ifneq ($(words $(OUT)),1)
$(error OUT=$(OUT): make cannot handle blanks in the names of what it makes)
endif

trace := $(BUILD)/bin/loom-trace
gather := $(BUILD)/bin/loom-gather
merge := $(BUILD)/bin/loom-merge
inspect := $(BUILD)/bin/loom-inspect
work := $(OUT)/$(METHOD)
numbers := $(shell seq 0 $$(($(PASSES) - 1)))
last := $(lastword $(numbers))
passes := $(numbers:%=$(work)/pass-%.exr)
graphs := $(numbers:%=$(work)/pass-%.h5)
traced := $(if $(filter graph,$(METHOD)),$(graphs),$(passes))
scene_prerequisite := $(subst $(space),\$(space),$(SCENE))

# What reaches the result, and what only says how fast.
trace_parameters = $(call quote,$(SCENE)) --spp $(SPP)$(if $(SEED), --seed $(SEED))$(if \
	$(DEFINES), $(foreach d,$(DEFINES),-D $(call quote,$(d))))$(if $(TRACE), $(TRACE))
threads = $(if $(THREADS), --threads $(THREADS))

# $(call parameter,FILE,VALUE): FILE holds VALUE and is written anew only when VALUE is another one.
equal = $(and $(findstring x$(1)x,x$(2)x),$(findstring x$(2)x,x$(1)x))
define parameter
$(1): $(if $(call equal,$(file <$(1)),$(2)),,FORCE)
	@mkdir -p $$(@D) && printf '%s\n' $(call quote,$(2)) >$$@
endef

image: $(OUT)/image.exr $(OUT)/image.png
	@echo $<

demo: $(OUT)/image.exr $(OUT)/image.png
	@echo
	@echo 'image    $(OUT)/image.exr'
	@echo 'picture  $(OUT)/image.png'
	@$(if $(filter graph,$(METHOD)),echo 'graph    $(work)/pass-$(last).h5')
	@echo 'look     $(inspect) $(lastword $(traced))'

$(eval $(call parameter,$(work)/trace.parameters,$(trace_parameters)))
$(traced): $(work)/pass-%: $(scene_prerequisite) $(work)/trace.parameters $(trace)
	$(LAUNCH) $(trace) $(trace_parameters) --first-sample $$(($(basename $*) * $(SPP)))$(threads) --depfile $@.d -o $@

# A graph is as large as its picture is small: once gathered it goes, but for the last, which stays to be
# looked at. Secondary: that it is gone does not make it be traced again.
ifeq ($(METHOD),graph)
.SECONDARY: $(graphs)
$(passes): $(work)/pass-%.exr: $(work)/pass-%.h5 $(gather)
	$(LAUNCH) $(gather) $< -o $@$(threads)
	$(if $(filter $(last),$*)$(KEEP),,rm -f $<)
endif

$(eval $(call parameter,$(OUT)/image.parameters,$(METHOD) $(PASSES)))
$(OUT)/image.exr: $(passes) $(OUT)/image.parameters $(merge)
	$(LAUNCH) $(merge) $(passes) -o $@

$(eval $(call parameter,$(OUT)/preview.parameters,$(EXPOSURE)))
$(OUT)/image.png: $(OUT)/image.exr $(OUT)/preview.parameters $(inspect)
	$(LAUNCH) $(inspect) $< --png $@$(if $(EXPOSURE), --exposure $(EXPOSURE))

# Run alone on a tree that is not built yet.
$(trace) $(gather) $(merge) $(inspect) &:
	$(MAKE) --no-print-directory -f Makefile stages

# Files that the scene includes: meshes, textures, other scene files.
-include $(traced:=.d)
