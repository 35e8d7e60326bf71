# Frames of a scene whose $parameters a table sets, and a movie: OUT/movie.mp4.
#
#   find what the frames share;  trace its image (BASE_SPP samples) and GRAPHS path graphs (SPP samples), once;
#   render each frame as that image plus the residual of what moves, from the graph's paths that it touches (loom-residual
#   --frames), BATCH frames by a process;  draw them with one exposure (loom-frames)
#
#   OUT/images/frame-NNNN.exr   frames;  frames/frame-NNNN.png, strip.png and movie.mp4 are drawn from them
#   OUT/base/                   image and graphs of what the frames share
#
# Contents count, not times: a row that changes makes its frame be made again, a row that is added is made, and both leave base
# as it is unless something else moves. Frame t takes graph t mod GRAPHS: frames of one graph share its noise.
## make animation SCENE=scenes/animated/ball.xml FRAMES=scenes/animated/ball.tsv SPP=16

.DELETE_ON_ERROR:
.PHONY: animation
.DEFAULT_GOAL := animation
include pipelines/variables.mk

SCENE ?= scenes/animated/ball.xml  ## scene file (Mitsuba XML)
FRAMES ?= scenes/animated/ball.tsv  ## table (.tsv): `frame` and names of $parameters of the scene, then a row per frame
SPP ?= 8  ## samples per pixel of each graph, and so of each frame's residual
BASE_SPP ?= 256  ## samples per pixel of the image of what the frames share
GRAPHS ?= 2  ## number of graphs
BATCH ?= 24  ## frames rendered by one process
FPS ?= 24  ## frames per second of the movie
# SEED=  ## seed of all random numbers (0)
# THREADS=  ## threads of each stage; no result depends on it (all)
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
BATCH := $(strip $(BATCH))
include pipelines/words.mk
$(foreach v,SCENE FRAMES,$(if $(call exists,$($(v))),,$(error $(v)=$($(v)): no such file)))
OUT ?= out/$(call scene_name,$(SCENE))/animation
OUT := $(OUT)

trace := $(BUILD)/bin/loom-trace
residual := $(BUILD)/bin/loom-residual
draw := $(BUILD)/bin/loom-frames
base := $(OUT)/base
threads = $(if $(THREADS), --threads $(THREADS))
scene_parameters = $(call quote,$(SCENE))$(call defines,-D,$(DEFINES))$(sensor)
static_parameters = $(scene_parameters) --static $(call quote,$(FRAMES))$(if $(TRACE), $(TRACE))
seeded = $(if $(SEED), --seed $(SEED))

listed := $(shell $(inspect) --quiet --frames $(call quote,$(FRAMES)) --scene $(scene_parameters) \
	| OUT=$(call quote,$(OUT)) THERE=$(call quote,$(patsubst $(OUT)/images/frame-%.exr,%,$(wildcard $(OUT)/images/frame-*.exr))) awk -F '\t' -v graphs=$(GRAPHS) -v batch=$(BATCH) -f pipelines/animation.awk)
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

animation: $(OUT)/strip.png
	@if [ -e $(OUT)/movie.mp4 ]; then echo $(OUT)/movie.mp4; else echo $(OUT)/frames; fi

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

# $(call batch,GRAPH,STATE,NAMES): the hash of a frame is written when the frame is there.
define batch
$(3:%=$(OUT)/images/frame-%.exr) &: $(base)/static.exr $(base)/graph-$(1).h5 $(residual) $(if $(filter missing,$(2)),FORCE)
	@mkdir -p $(OUT)/images && rm -f $(3:%=$(OUT)/images/frame-%.hash)
	$(LAUNCH) $(residual) $(scene_parameters) --frames $(call quote,$(FRAMES)) \
		--only $(call number,$(firstword $(3))):$(shell expr $(lastword $(3)) + 1):$(GRAPHS) \
		--old $(base)/static.exr --old-graph $(base)/graph-$(1).h5$(threads) --new $(OUT)/images/frame-%.exr
	@$(foreach n,$(3),echo $(call hash_of,$(n)) >$(OUT)/images/frame-$(n).hash;)
endef
$(foreach b,$(filter batch:%,$(listed)),$(eval $(call batch,$(word 2,$(subst :, ,$(b))),$(word 3,$(subst :, ,$(b))),$(subst $(comma), ,$(word 4,$(subst :, ,$(b)))))))

$(eval $(call parameter,$(OUT)/draw.parameters,$(names) --fps $(FPS)$(if $(DRAW), $(DRAW))))
$(OUT)/strip.png: $(names:%=$(OUT)/images/frame-%.exr) $(OUT)/draw.parameters $(draw)
	$(LAUNCH) $(draw) $(names:%=$(OUT)/images/frame-%.exr) -o $@ --png --fps $(FPS) --movie $(OUT)/movie.mp4$(if $(DRAW), $(DRAW))
