# Frames of a scene whose $parameters a table sets, and a movie: OUT/movie.mp4.
#
#   find what the frames share;  trace its image (BASE_SPP samples) and GRAPHS path graphs (SPP samples), once;
#   render each frame as that image plus the residual of what moves, from the graph's paths that it touches (loom-residual
#   --frames), BATCH frames by a process;  draw them with one exposure (loom-frames)
#
#   OUT/report.html             page with the frames under a slider, their costs and errors
#   OUT/frames.svg              CPU time, share of paths traced again and expected error of each frame, from frame-costs.tsv
#   OUT/images/frame-NNNN.exr   frames;  frames/frame-NNNN.png, strip.png and movie.mp4 are drawn from them, or, with
#                               DENOISE=1, from denoised/frame-NNNN.exr
#   OUT/base/                   image and graphs of what the frames share
#
# Contents count, not times: a row that changes makes its frame be made again, a row that is added is made, and both leave base
# as it is unless something else moves. Frame t takes graph t mod GRAPHS: frames of one graph share its noise.
# METHOD=pt traces every frame by itself, with SPP samples and no base.
#
# BASE_SPP=auto asks loom-residual --plan (OUT/plan.txt): as many samples as give the least error for the time of all frames; and where
# path tracing of equal error would cost less, METHOD=pt.
#
# CACHE=points or grid: where the camera moves, frames have no image in common. They take what they share from a radiance cache
# (OUT/cache/cache.h5, animation-cache.mk) and add the path-traced difference, SPP samples per pixel; biased, by about the layer
# CacheError of each frame. BASE_SPP and GRAPHS are for a camera that stands still. With CORRECT the frames are unbiased, and noisier:
# paths end in the cache one vertex later, and this share of them is traced on.
## make animation SCENE=scenes/animated/ball.xml FRAMES=scenes/animated/ball.tsv SPP=16
## make animation SCENE=scenes/animated/walk.xml FRAMES=scenes/animated/walk.tsv CACHE=points

.DELETE_ON_ERROR:
.PHONY: animation report
.DEFAULT_GOAL := animation
include pipelines/variables.mk

SCENE ?= scenes/animated/ball.xml  ## scene file (Mitsuba XML)
FRAMES ?= scenes/animated/ball.tsv  ## table (.tsv): `frame` and names of $parameters of the scene, then a row per frame
SPP ?= 8  ## samples per pixel of each graph, and so of each frame's residual
BASE_SPP ?= auto  ## samples per pixel of the image of what the frames share; auto: by a pilot, see OUT/plan.txt
GRAPHS ?= 2  ## number of graphs
METHOD ?= hybrid  ## hybrid: what the frames share plus what moves; pt: path tracing of each frame
# CACHE=  ## points, grid: a radiance cache in place of the image of what the frames share; needed where the camera moves (none)
CACHE_VIEWS ?= 8  ## frames from whose cameras the cache is made
CACHE_SPP ?= 4  ## samples per pixel of each of these views
# CORRECT=  ## with CACHE: share of the paths that are traced on behind it, .001 to 1, for unbiased frames (none: biased)
DENOISE ?= 0  ## 1: remove the noise of each frame
# EXTRA=  ## further pairs of paths per pixel of each frame, where its graph finds noise (0)
# MASK=  ## weight of the image of what the frames share: none: 1; first-hit: 0 where the camera sees what moves, biased at edges (coverage)
BATCH ?= 24  ## frames rendered by one process
FPS ?= 24  ## frames per second of the movie
# SEED=  ## seed of all random numbers (0)
# THREADS=  ## threads of each stage; no result depends on it (all)
# ABSENT=  ## in FRAMES, value of a parameter whose shapes a frame lacks: ABSENT=none
# DEFINES=  ## values of the scene's other parameters: DEFINES="resx=320 resy=180"
# SENSOR=  ## sensor of the scene, by id or by number from 0 (the first)
# TRACE=  ## further options of loom-trace: TRACE="--roulette throughput"
# DRAW=  ## further options of loom-frames: DRAW="--exposure 1 --count 6"
# OUT=  ## folder of the results (out/NAME/animation, NAME from the scene)
# LAUNCH=  ## command to put before each stage: LAUNCH="srun -c8"
BUILD ?= build
SCENE := $(strip $(SCENE))
FRAMES := $(strip $(FRAMES))
SPP := $(strip $(SPP))
BASE_SPP := $(strip $(BASE_SPP))
GRAPHS := $(strip $(GRAPHS))
CACHE_VIEWS := $(strip $(CACHE_VIEWS))
CACHE_SPP := $(strip $(CACHE_SPP))
BATCH := $(strip $(BATCH))
METHOD := $(strip $(METHOD))
DENOISE := $(strip $(DENOISE))
include pipelines/words.mk
ifeq ($(filter hybrid pt,$(METHOD)),)
$(error METHOD=$(METHOD): expected hybrid or pt)
endif
ifeq ($(filter points grid,$(CACHE))$(if $(CACHE),,none),)
$(error CACHE=$(CACHE): expected points or grid)
endif
ifneq ($(and $(CACHE),$(filter pt,$(METHOD))),)
$(error METHOD=pt CACHE=$(CACHE): path tracing of each frame has no cache; leave out one of them)
endif
ifneq ($(CORRECT),)
ifeq ($(CACHE),)
$(error CORRECT=$(CORRECT): there is no cache to correct; give CACHE=points or CACHE=grid)
endif
ifneq ($(shell awk 'BEGIN { r = "$(CORRECT)" + 0; print (r >= .001 && r <= 1) }'),1)
$(error CORRECT=$(CORRECT): must be from .001 to 1)
endif
endif
$(foreach v,SCENE FRAMES,$(if $(call exists,$($(v))),,$(error $(v)=$($(v)): no such file)))
OUT ?= out/$(call scene_name,$(SCENE))/animation
OUT := $(OUT)
ifeq ($(abspath $(FRAMES)),$(abspath $(OUT)/frames.tsv))
$(error FRAMES=$(FRAMES): the chart of the frames would overwrite it, OUT/frames.svg has its data beside it; name or place it otherwise)
endif

trace := $(BUILD)/bin/loom-trace
residual := $(BUILD)/bin/loom-residual
denoise := $(BUILD)/bin/loom-denoise
draw := $(BUILD)/bin/loom-frames
compare := $(BUILD)/bin/loom-compare
chart := $(BUILD)/bin/loom-chart
page := $(BUILD)/bin/loom-report
base := $(OUT)/base
threads = $(if $(THREADS), --threads $(THREADS))
hybrid := $(if $(CACHE),,$(filter hybrid,$(METHOD)))
# Of TRACE alone the length of paths counts for residuals.
max_depth := $(patsubst --max-depth=%,%,$(lastword $(filter --max-depth=%,$(subst --max-depth$(space),--max-depth=,$(TRACE)))))
depth = $(if $(max_depth), --max-depth $(max_depth))
absent = $(if $(ABSENT), --absent $(ABSENT))
scene_parameters = $(call quote,$(SCENE))$(call defines,-D,$(DEFINES))$(sensor)
static_parameters = $(scene_parameters) --static $(call quote,$(FRAMES))$(absent)$(if $(TRACE), $(TRACE))
seeded = $(if $(SEED), --seed $(SEED))

listed := $(shell $(inspect) --quiet --frames $(call quote,$(FRAMES))$(absent) --scene $(scene_parameters) \
	| OUT=$(call quote,$(OUT)) THERE=$(call quote,$(patsubst $(OUT)/images/frame-%.exr,%,$(wildcard $(OUT)/images/frame-*.exr))) awk -F '\t' -v graphs=$(if $(hybrid),$(GRAPHS),1) -v batch=$(BATCH) -f pipelines/animation.awk)
static_hash := $(patsubst static:%,%,$(filter static:%,$(listed)))
ifeq ($(static_hash),)
$(error FRAMES=$(FRAMES): no frames of this scene, see above)
endif
frames := $(filter frame:%,$(listed))
names := $(foreach f,$(frames),$(word 2,$(subst :, ,$(f))))
graphs := $(shell seq 0 $$(($(GRAPHS) - 1)))
hash_of = $(word 3,$(subst :, ,$(filter frame:$(1):%,$(frames))))
# $(call number,NNNN): without leading zeros, which a shell takes for octal.
number = $(shell expr $(1) + 0)

ifeq ($(BASE_SPP)$(hybrid),autohybrid)
# What the pilot says goes to another make, whose targets depend on it. make -n without a plan ends with the pilot.
planned = $$(sed -n 's/^$(1): //p' $(OUT)/plan.txt)
animation report: $(OUT)/plan.txt
	@[ ! -e $< ] || { spp=$(call planned,samples of the static image); method=$(call planned,method); \
		[ "$$spp" ] && [ "$$method" ] || { echo "$<: says no method and samples; remove it" >&2; exit 1; }; \
		$(MAKE) --no-print-directory -f pipelines/animation.mk BASE_SPP="$$spp" METHOD="$$method" $@; }

$(eval $(call parameter,$(OUT)/plan.parameters,$(static_hash) $(frames) --spp $(SPP) --graphs $(GRAPHS)$(depth)$(seeded)))
$(OUT)/plan.txt: $(OUT)/plan.parameters $(residual)
	$(LAUNCH) $(residual) $(scene_parameters) --frames $(call quote,$(FRAMES))$(absent) --plan --spp $(SPP) --graphs $(GRAPHS)$(depth)$(seeded)$(threads) >$@.partial
	@mv $@.partial $@
else
animation: $(OUT)/strip.png $(OUT)/report.html
	@if [ -e $(OUT)/movie.mp4 ]; then echo $(OUT)/movie.mp4; else echo $(OUT)/frames; fi
report: $(OUT)/strip.png $(OUT)/report.html
	@echo $(OUT)/report.html

ifneq ($(CACHE),)
include pipelines/animation-cache.mk
endif

# The table is named in commands alone: what it holds is in the hashes.
$(eval $(call parameter,$(base)/static.hash,$(static_hash)))
$(eval $(call parameter,$(base)/image.parameters,$(sensor)$(if $(TRACE), $(TRACE)) --spp $(BASE_SPP)$(seeded)))
$(eval $(call parameter,$(base)/graphs.parameters,$(sensor)$(if $(TRACE), $(TRACE)) --spp $(SPP) --passes $(GRAPHS)$(seeded)))

$(base)/static.exr: $(base)/static.hash $(base)/image.parameters $(trace)
	$(LAUNCH) $(trace) $(static_parameters) --spp $(BASE_SPP)$(seeded)$(threads) -o $@

# Not the seed of the image, whose noise would be in the residuals too.
$(graphs:%=$(base)/graph-%.h5) &: $(base)/static.hash $(base)/graphs.parameters $(trace)
	$(LAUNCH) $(trace) $(static_parameters) --spp $(SPP) --passes $(GRAPHS) --seed $(shell echo $$(($(or $(SEED),0) + 1))) --misses$(threads) \
		-o $(base)/graph-%.h5

# $(call of_hybrid,GRAPH), $(call of_cache,), $(call of_pt,): command of a batch, less its frames and its output.
of_hybrid = $(residual) $(scene_parameters)$(depth) --old $(base)/static.exr --old-graph $(base)/graph-$(1).h5$(hybrid_parameters)
hybrid_parameters := $(if $(strip $(MASK)), --mask $(strip $(MASK)))$(if $(strip $(EXTRA)), --extra $(strip $(EXTRA)))
of_cache = $(residual) $(scene_parameters)$(depth) --cache $(cache)$(correct) --spp $(SPP)$(seeded)
correct := $(if $(CORRECT), --correct $(CORRECT))
of_pt = $(trace) $(scene_parameters)$(pt_parameters)
pt_parameters := $(if $(TRACE), $(TRACE)) --spp $(SPP)$(seeded)
way := $(if $(CACHE),cache,$(METHOD))
output := $(if $(filter pt,$(way)),-o,--new)
# What frames are made of besides their rows: another METHOD, and of pt other samples, make them again.
$(eval $(call parameter,$(OUT)/method.parameters,$(way)$(if $(hybrid),$(hybrid_parameters),$(sensor)$(pt_parameters)$(correct))))

# $(call batch,GRAPH,STATE,NAMES): the hash of a frame is written when the frame is there.
define batch
$(3:%=$(OUT)/images/frame-%.exr) &: $(if $(hybrid),$(base)/static.exr $(base)/graph-$(1).h5 $(residual),$(if $(CACHE),$(cache) $(residual),$(trace))) \
		$(OUT)/method.parameters $(if $(filter missing,$(2)),FORCE)$(if $(hybrid), | $(graphs:%=$(base)/graph-%.h5))
	@mkdir -p $(OUT)/images && rm -f $(3:%=$(OUT)/images/frame-%.hash)
	$(LAUNCH) $(call of_$(way),$(1)) --frames $(call quote,$(FRAMES))$(absent) \
		--only $(call number,$(firstword $(3))):$(shell expr $(lastword $(3)) + 1):$(if $(hybrid),$(GRAPHS),1)$(threads) \
		$(output) $(OUT)/images/frame-%.exr
	@$(foreach n,$(3),echo $(call hash_of,$(n)) >$(OUT)/images/frame-$(n).hash;)
endef
$(foreach b,$(filter batch:%,$(listed)),$(eval $(call batch,$(word 2,$(subst :, ,$(b))),$(word 3,$(subst :, ,$(b))),$(subst $(comma), ,$(word 4,$(subst :, ,$(b)))))))

# The static image is denoised once, and apart from what moves.
$(base)/denoised.exr: $(base)/static.exr $(denoise)
	$(LAUNCH) $(denoise) $<$(threads) -o $@
$(names:%=$(OUT)/denoised/frame-%.exr): $(OUT)/denoised/%.exr: $(OUT)/images/%.exr $(if $(hybrid),$(base)/static.exr $(base)/denoised.exr) $(denoise)
	@mkdir -p $(@D)
	$(LAUNCH) $(denoise) $<$(if $(hybrid), --base $(base)/static.exr --denoised-base $(base)/denoised.exr)$(threads) -o $@

drawn := $(names:%=$(OUT)/$(if $(filter 1,$(DENOISE)),denoised,images)/frame-%.exr)
$(eval $(call parameter,$(OUT)/draw.parameters,$(drawn) --fps $(FPS)$(if $(DRAW), $(DRAW))))
$(OUT)/strip.png: $(drawn) $(OUT)/draw.parameters $(draw)
	$(LAUNCH) $(draw) $(drawn) -o $@ --png --fps $(FPS) --movie $(OUT)/movie.mp4$(if $(DRAW), $(DRAW))

$(OUT)/frame-costs.tsv: $(drawn) $(OUT)/draw.parameters $(compare)
	$(LAUNCH) $(compare) --quiet --by-frame --scene $(call quote,$(call scene_name,$(SCENE))) $(drawn:%=$(way)=%) >$@.partial
	@mv $@.partial $@
$(OUT)/frames.svg: $(OUT)/frame-costs.tsv $(chart)
	$(chart) $< --kind frames -o $@
again = make animation SCENE=$(call typed,$(SCENE)) FRAMES=$(call typed,$(FRAMES)) SPP=$(SPP) GRAPHS=$(GRAPHS) METHOD=$(METHOD)$(if \
	$(hybrid), BASE_SPP=$(BASE_SPP)$(if $(MASK), MASK=$(MASK))$(if $(EXTRA), EXTRA=$(EXTRA)))$(if \
	$(CACHE), CACHE=$(CACHE) CACHE_VIEWS=$(CACHE_VIEWS) CACHE_SPP=$(CACHE_SPP)$(if $(CORRECT), CORRECT=$(CORRECT)))$(if $(DENOISE:0=), DENOISE=1)$(if $(ABSENT), ABSENT=$(ABSENT))$(if $(SEED), SEED=$(SEED))$(if \
	$(DEFINES), DEFINES=$(call typed,$(DEFINES)))$(if $(SENSOR), SENSOR=$(call typed,$(SENSOR)))$(if $(TRACE), TRACE=$(call typed,$(TRACE)))
longest_side = $(if $(LONGEST_SIDE), --longest-side $(LONGEST_SIDE))
$(eval $(call parameter,$(OUT)/report.parameters,$(again)$(longest_side)))
$(OUT)/report.html: $(OUT)/frames.svg $(OUT)/strip.png $(OUT)/report.parameters $(page)
	$(page) --animation $(drawn) --by-frame $(OUT)/frame-costs.tsv --chart $(OUT)/frames.svg --fps $(FPS) \
		$$(if [ -e $(OUT)/movie.mp4 ]; then echo --movie $(OUT)/movie.mp4; fi) --title $(call quote,$(call scene_name,$(SCENE))) \
		--made-by $(call quote,$(again))$(longest_side) -o $@
endif
