# Light in flight of one scene: OUT/cube.h5, an image whose pixels are histograms over the optical path length.
#
#   trace PASSES path graphs of SPP samples each;  with K, cluster the vertices of each, whose light first hits then
#   share;  bin the paths of all of them together (loom-transient);
#   draw strip.png, streak-x.png, streak-y.png, peak.png, curves.svg, frames/ and, where ffmpeg is, movie.mp4 (loom-frames)
#
# The graphs stay: another window, pulse or unit bins the same paths again, and nothing is traced. With KEEP=0 each graph
# is binned by itself and goes, and the cubes are merged: for more samples than the disk or the memory has room for, and
# for a window that the film or START and WIDTH say. Parameters are prerequisites, pass i takes samples
# [i SPP, (i+1) SPP) of every pixel: as in still.mk.
## make transient SCENE=scenes/flash.xml PULSE=gaussian LENGTH=0.1 UNIT=ns START=14 WIDTH=0.1

.DELETE_ON_ERROR:
.PHONY: transient cube
.DEFAULT_GOAL := transient
include pipelines/variables.mk

SCENE ?= scenes/flash.xml  ## scene file (Mitsuba XML); its transient_hdr_film sets the window
# PASSES=  ## number of graphs to trace (4)
# SPP=  ## samples per pixel of each graph (16); about 300 bytes per sample on disk
BATCH ?= 4  ## graphs traced by one process
SAMPLER ?= sobol  ## sobol, or independent: larger error, but exact error bars
# K=  ## vertices of a cluster whose first hits share light (none: the paths' own samples)
# CLUSTER=  ## further options of loom-cluster: CLUSTER="--method centres"
# BINS=  ## number of bins (the film's, else 300)
# START=  ## start of the first bin, in UNIT (the film's, else the first arrival of light)
# WIDTH=  ## width of a bin, in UNIT (the film's, else 99.9 % of the light is in the window)
# UNIT=  ## unit of START, WIDTH, LENGTH and the images: opl (units of the scene) or ns (opl)
# PULSE=  ## delta, box, gaussian, expgauss, table, sine or square (the film's)
# LENGTH=  ## box: length of the pulse; gaussian: its standard deviation, in UNIT
# TRANSIENT=  ## further options of loom-transient: TRANSIENT="--unwarp --group-index 1.5=1.53"
FRAMES ?= --png  ## further options of loom-frames: FRAMES="--png --exr --row 40 --pixel 30:60 --exposure 1"
# SEED=  ## seed of all random numbers (0)
# THREADS=  ## threads of each stage; no result depends on it (all)
# DEFINES=  ## values of the scene's parameters: DEFINES="resx=256 resy=256"
# SENSOR=  ## sensor of the scene, by id or by number from 0 (the first)
# TRACE=  ## further options of loom-trace: TRACE="--roulette throughput"
KEEP ?= 1  ## 0: bin each graph by itself and keep its cube instead of the graph
# OUT=  ## folder of the results (out/NAME, NAME from the scene)
# LAUNCH=  ## command to put before each stage: LAUNCH="srun -c8"
BUILD ?= build
SCENE := $(strip $(SCENE))
SPP ?= 16
PASSES ?= 4
BATCH := $(strip $(BATCH))
SAMPLER := $(strip $(SAMPLER))
override TRACE := --sampler $(SAMPLER)$(if $(strip $(TRACE)), $(strip $(TRACE)))
keep := $(filter-out 0,$(strip $(KEEP)))
folder := transient
kind := h5
made := $(if $(keep),h5,cube.h5)
include pipelines/passes.mk

ifneq ($(if $(keep),,$(K)),)
$(error K=$(K) KEEP=0: graphs that share light must be binned together; leave out one of K, KEEP)
endif

bin := $(BUILD)/bin/loom-transient
merge := $(BUILD)/bin/loom-merge
draw := $(BUILD)/bin/loom-frames
graphs := $(numbers:%=$(work)/pass-%.h5)
clusters := $(if $(K),$(numbers:%=$(work)/pass-%.clusters.h5))

transient: $(OUT)/cube.h5 $(OUT)/strip.png
	@echo $<

cube: $(OUT)/cube.h5 # without images
	@echo $<

cube_parameters = $(strip $(if $(UNIT),--unit $(UNIT)) $(if $(BINS),--bins $(BINS)) $(if $(START),--start $(START)) \
	$(if $(WIDTH),--width $(WIDTH)) $(if $(PULSE),--pulse $(PULSE)) $(if $(LENGTH),--pulse-length $(LENGTH)) $(TRANSIENT))
# Files that options name: the table of a pulse.
option_files := $(wildcard $(subst =, ,$(TRANSIENT)))
cube_parameter_files := $(work)/cube.parameters $(if $(option_files),$(work)/cube.stamp)
$(eval $(call parameter,$(work)/cube.parameters,$(cube_parameters)))
$(if $(option_files),$(eval $(call stamp,$(work)/cube.stamp,$(option_files))))
$(eval $(call parameter,$(OUT)/passes.parameters,$(PASSES) $(if $(keep),together,merged)$(if $(K), $(K))))
ifneq ($(keep),)
# Secondary: clusters may go, as a chart's do, and are made again where another cube is wanted.
.SECONDARY: $(graphs) $(clusters)
$(if $(clusters),$(eval $(cluster_passes)))

$(OUT)/cube.h5: $(graphs) $(clusters) $(cube_parameter_files) $(OUT)/passes.parameters $(bin)
	$(LAUNCH) $(bin) $(graphs)$(if $(K), --clusters $(clusters)) $(cube_parameters) -o $@$(threads)
else
cubes := $(graphs:.h5=.cube.h5)
# Secondary: that a graph is gone does not make it be traced again.
.SECONDARY: $(graphs) $(cubes)
$(cubes): %.cube.h5: %.h5 $(cube_parameter_files) $(bin)
	$(LAUNCH) $(bin) $< $(cube_parameters) -o $@$(threads)
	rm -f $<

$(OUT)/cube.h5: $(cubes) $(OUT)/passes.parameters $(merge)
	$(LAUNCH) $(merge) $(cubes) -o $@
endif

$(eval $(call parameter,$(OUT)/frames.parameters,$(FRAMES)))
$(OUT)/strip.png: $(OUT)/cube.h5 $(OUT)/frames.parameters $(draw)
	$(LAUNCH) $(draw) $< -o $@ --movie $(OUT)/movie.mp4 $(FRAMES)
