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
.PHONY: transient
.DEFAULT_GOAL := transient
include pipelines/variables.mk

SCENE ?= scenes/flash.xml  ## scene file (Mitsuba XML); its transient_hdr_film sets the window
# PASSES=  ## number of graphs to trace (4)
# SPP=  ## samples per pixel of each graph (16); about 300 bytes per sample on disk
BATCH ?= 4  ## graphs traced by one process
SAMPLER ?= sobol  ## sobol, or independent: larger error, but exact error bars
# K=  ## vertices of a cluster whose first hits share light (none: the paths' own samples)
# CLUSTER=  ## further options of loom-cluster: CLUSTER="--method centres"
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

$(eval $(call parameter,$(OUT)/passes.parameters,$(PASSES) $(if $(keep),together,merged)$(if $(K), $(K))))
beside := $(if $(K),clusters.h5)
flag := --clusters
drawn :=
$(if $(K),$(eval $(cluster_passes)))
include pipelines/cube.mk

transient: $(OUT)/cube.h5 $(OUT)/strip.png
	@echo $<
