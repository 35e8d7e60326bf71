# Transient cube of one scene with its derivatives with respect to parameters: OUT/cube.h5.
#
#   trace PASSES path graphs of SPP samples each;  derive the light of each graph by the parameters WRT (loom-derive);
#   bin values and derivatives of all graphs together (loom-transient);
#   draw strip.png, streaks, curves.svg and frames/ of the value, and of each derivative in derivative-NAME/ (loom-frames)
#
# The graphs stay: other parameters trace nothing, and another window, pulse or unit derives nothing. With KEEP=0 each
# graph is binned by itself with its derivatives, both go, and the cubes are merged: for more samples than the disk has
# room for, and for a window that the film or START and WIDTH set. Parameters are prerequisites: as in still.mk.
#
# With DOPPLER=1 WRT moves in time: doppler.h5 holds the velocity of each pixel and spectra, drawn as velocity.png and
# beat.svg, and nothing is derived or binned.
## make derive SCENE=scenes/edits.xml WRT="across turn" DEFINES="resx=96 resy=96"
## make derive SCENE=scenes/edits.xml WRT="shape:short/pose" PULSE=box LENGTH=0.1 START=4 WIDTH=0.1 BINS=80
## make derive SCENE=scenes/edits.xml WRT=across DOPPLER=1 SPEED="across=2" CHIRP=1e14

.DELETE_ON_ERROR:
.PHONY: derive
.DEFAULT_GOAL := derive
include pipelines/variables.mk

SCENE ?= scenes/edits.xml  ## scene file (Mitsuba XML); its transient_hdr_film sets the window
# WRT=  ## parameters, by name: $variables of the scene, shape:ID/pose ... (required)
# PASSES=  ## number of graphs to trace (4)
# SPP=  ## samples per pixel of each graph (16); about 320 bytes per sample on disk
BATCH ?= 4  ## graphs traced by one process
SAMPLER ?= independent  ## independent, or sobol: smaller error, but too large error bars
# EFFORT=  ## time for moving boundaries, as a share of the time to trace and bin (as loom-derive)
# DERIVE=  ## further options of loom-derive
# SEED=  ## seed of all random numbers (0)
# THREADS=  ## threads of each stage; no result depends on it (all)
# DEFINES=  ## values of the scene's parameters: DEFINES="resx=256 resy=256"
# SENSOR=  ## sensor of the scene, by id or by number from 0 (the first)
# TRACE=  ## further options of loom-trace: TRACE="--roulette throughput"
# DOPPLER=  ## 1: velocities and Doppler shifts instead of derivatives
# SPEED=  ## with DOPPLER: NAME=SPEED of each parameter, its unit per second (1 of a single one)
# WAVELENGTH=  ## with DOPPLER: wavelength of the light, m (as loom-derive)
# CHIRP=  ## with DOPPLER: rise of the frequency, Hz/s, for a beat spectrum (none)
KEEP ?= 1  ## 0: bin each graph by itself and keep its cube instead of the graph
# OUT=  ## folder of the results (out/NAME/derive, NAME from the scene)
# LAUNCH=  ## command to put before each stage: LAUNCH="srun -c8"
BUILD ?= build
SCENE := $(strip $(SCENE))
SPP ?= 16
PASSES ?= 4
BATCH := $(strip $(BATCH))
SAMPLER := $(strip $(SAMPLER))
override TRACE := --sampler $(SAMPLER) --primitives --media$(if $(strip $(TRACE)), $(strip $(TRACE)))
keep := $(filter-out 0,$(strip $(KEEP)))
folder := passes
kind := h5
made := $(if $(keep),h5,cube.h5)
# Its own: make transient of the same scene has another cube.h5.
OUT ?= out/$(call scene_name,$(SCENE))/derive
include pipelines/passes.mk

ifeq ($(WRT),)
$(error WRT=: name the parameters of the derivatives, for example WRT="across turn")
endif

derive := $(BUILD)/bin/loom-derive
beside := derivative.h5
flag := --derivative
drawn := --derivatives
derive_parameters = $(call defines,-D,$(DEFINES))$(sensor)$(call defines,--wrt,$(WRT))$(if $(EFFORT), --effort $(EFFORT))$(if $(DERIVE), $(DERIVE))
# PASS:SEED of each pass, far from the seeds of other runs.
seeds := $(shell for i in $(numbers); do echo $$i:$$(($(or $(SEED),0) + 1000003 * (i + 1))); done)
$(eval $(call parameter,$(work)/derive.parameters,$(call quote,$(SCENE))$(derive_parameters)$(if $(SEED), --seed $(SEED))))
# In OUT together: a cube of make transient in the same folder is replaced.
$(eval $(call parameter,$(OUT)/passes.parameters,$(PASSES) $(if $(keep),together,merged) with derivatives))
include pipelines/cube.mk

doppler := $(filter-out 0,$(strip $(DOPPLER)))
ifneq ($(doppler),)
ifeq ($(keep),)
$(error KEEP=0: DOPPLER needs all graphs at once)
endif
doppler_parameters = $(call defines,--speed,$(SPEED))$(if $(WAVELENGTH), --wavelength $(WAVELENGTH))$(if $(CHIRP), --chirp $(CHIRP))
$(eval $(call parameter,$(OUT)/doppler.parameters,$(doppler_parameters)))
derive: $(OUT)/doppler.h5 $(OUT)/velocity.png
	@echo $<

$(OUT)/doppler.h5: $(graphs) $(scene_stamp) $(work)/derive.parameters $(OUT)/passes.parameters $(OUT)/doppler.parameters $(derive)
	$(LAUNCH) $(derive) $(call quote,$(SCENE)) $(firstword $(graphs))$(derive_parameters)$(doppler_parameters)$(if $(word 2,$(graphs)), --with $(wordlist 2,$(words $(graphs)),$(graphs))) --doppler $@$(threads)

$(OUT)/velocity.png: $(OUT)/doppler.h5 $(draw)
	$(LAUNCH) $(draw) $< -o $@
else
derive: $(OUT)/cube.h5 $(OUT)/strip.png
	@echo $<
endif

$(companions): $(work)/pass-%.derivative.h5: $(work)/pass-%.h5 $(scene_stamp) $(work)/derive.parameters $(derive)
	$(LAUNCH) $(derive) $(call quote,$(SCENE)) $<$(derive_parameters) --seed $(patsubst $*:%,%,$(filter $*:%,$(seeds))) -o $@$(threads)
