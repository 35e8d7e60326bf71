# Fit of parameters of a scene to a measured transient cube: OUT/fit.h5, the values with their covariance.
#
#   evaluate the scene where the fit asks for it: trace two graphs of SPP samples each, derive their light by the
#   parameters WRT, bin both;  a step of the fit (loom-fit);  and so on until it ends
#
# Beside it loss.svg, parameters.svg, fit.tsv, fitted.h5 (the cube of the last evaluation), and strips and streaks of the cubes at the
# start, at the end and as measured.
#
# Evaluation N is OUT/fits/fit-N.h5, with the values of the next one in fit-N.values: a fit that is killed goes on, and one
# with more MAX_EVALUATIONS as well. Its graphs and cubes go, but for those of the last (KEEP=1). Parameters are
# prerequisites: as in still.mk.
## make fit SCENE=scenes/hidden.xml WRT="x y z" MEASURED=measured.h5 SCALE="x=.2 y=.2 z=.2"

.DELETE_ON_ERROR:
.PHONY: fit
.DEFAULT_GOAL := fit
include pipelines/variables.mk

SCENE ?= scenes/hidden.xml  ## scene file (Mitsuba XML); as wide and high as MEASURED
# WRT=  ## $parameters of the scene to be fitted (required); they start from the scene's values, or those in DEFINES
# MEASURED=  ## measured cube (.h5): of loom-transient, or any HDF5 file with mean and var_mean (required)
# TRUTH=  ## values to compare the result with: TRUTH="x=.1 y=0"
# METHOD=  ## lm, adam or gradient (lm)
# LOSS=  ## squares, pyramid or time_cdf (pyramid)
# LOWER=  ## smallest values: LOWER="x=-1 z=.2"
# UPPER=  ## largest values
# SCALE=  ## longest steps, and reach of starts from elsewhere (not limited)
# FIT=  ## further options of loom-fit: FIT="--merge 4,2,1 --restarts 5 --prior x=0:0.1"
MAX_EVALUATIONS ?= 40  ## evaluations after which the fit ends
# SPP=  ## samples per pixel of each of the two graphs of an evaluation (64)
# BINS=  ## number of bins (with START, WIDTH, PULSE and LENGTH: those of MEASURED, or if one is given, of the film)
# START=  ## start of the first bin, in UNIT (the film's)
# WIDTH=  ## width of a bin, in UNIT (the film's)
# UNIT=  ## unit of START, WIDTH and LENGTH: opl (units of the scene) or ns (opl)
# PULSE=  ## delta, box, gaussian, expgauss, table, sine or square (the film's)
# LENGTH=  ## box: length of the pulse; gaussian: its standard deviation, in UNIT
# TRANSIENT=  ## further options of loom-transient
# EFFORT=  ## time for moving boundaries, as a share of the time to trace and bin (as loom-derive)
# DERIVE=  ## further options of loom-derive
# SEED=  ## seed of all random numbers (0)
# THREADS=  ## threads of each stage; no result depends on it (all)
# DEFINES=  ## values of the scene's parameters: DEFINES="res=32 x=0.1"
# SENSOR=  ## sensor of the scene, by id or by number from 0 (the first)
# TRACE=  ## further options of loom-trace: TRACE="--roulette throughput"
# KEEP=  ## 1: keep graphs and cubes of the last evaluation (none)
# OUT=  ## folder of the results (out/NAME/fit, NAME from the scene)
# LAUNCH=  ## command to put before each stage: LAUNCH="srun -c8"
BUILD ?= build
SCENE := $(strip $(SCENE))
SPP ?= 64
MAX_EVALUATIONS := $(strip $(MAX_EVALUATIONS))
include pipelines/words.mk
ifeq ($(call exists,$(SCENE)),)
$(error SCENE=$(SCENE): no such file)
endif
ifeq ($(call exists,$(MEASURED)),)
$(error MEASURED=$(MEASURED): no such file)
endif
ifeq ($(WRT),)
$(error WRT=: name the parameters to be fitted, for example WRT="x y z")
endif
OUT ?= out/$(call scene_name,$(SCENE))/fit
OUT := $(OUT)
work := $(OUT)/fits
trace := $(BUILD)/bin/loom-trace
derive := $(BUILD)/bin/loom-derive
bin := $(BUILD)/bin/loom-transient
fit := $(BUILD)/bin/loom-fit
merge := $(BUILD)/bin/loom-merge
draw := $(BUILD)/bin/loom-frames
threads = $(if $(THREADS), --threads $(THREADS))

fit: $(OUT)/fit.h5 $(OUT)/loss.svg $(OUT)/start/strip.png $(OUT)/fitted/strip.png $(OUT)/measured/strip.png
	@echo $<

# What reaches a result. What is fitted starts from its value in DEFINES.
fixed := $(filter-out $(foreach w,$(WRT),$(w)=%),$(DEFINES))
at_start = $(call quote,$(SCENE))$(call defines,-D,$(DEFINES))$(sensor)
at_values = $(call quote,$(SCENE))$(call defines,-D,$(fixed))$(sensor) "$$@"
trace_parameters = --sampler independent --primitives --media$(if $(TRACE), $(TRACE)) --spp $(SPP) --passes 2
derive_parameters = $(call defines,--wrt,$(WRT))$(if $(EFFORT), --effort $(EFFORT))$(if $(DERIVE), $(DERIVE))
bin_parameters = $(strip $(if $(UNIT),--unit $(UNIT)) $(if $(BINS)$(START)$(WIDTH)$(PULSE)$(LENGTH),$(if $(BINS),--bins $(BINS)) $(if $(START),--start $(START)) \
	$(if $(WIDTH),--width $(WIDTH)) $(if $(PULSE),--pulse $(PULSE)) $(if $(LENGTH),--pulse-length $(LENGTH)),--like $(call quote,$(MEASURED))) $(TRANSIENT))
fit_parameters = $(strip $(if $(METHOD),--method $(METHOD)) $(if $(LOSS),--loss $(subst _,-,$(LOSS))) $(call defines,--lower,$(LOWER)) \
	$(call defines,--upper,$(UPPER)) $(call defines,--scale,$(SCALE)) $(FIT))$(if $(SEED), --seed $(SEED))
$(eval $(call stamp,$(work)/scene.stamp,--scene $(call quote,$(SCENE))$(call defines,-D,$(DEFINES))$(sensor)))
$(eval $(call stamp,$(work)/measured.stamp,$(call quote,$(MEASURED))))
$(eval $(call parameter,$(work)/fit.parameters,$(at_start) $(trace_parameters) $(derive_parameters) $(bin_parameters) $(fit_parameters)))

# $(call evaluated,N,BEFORE): evaluation N, at the values of evaluation BEFORE; none: at the start. Numbers of its own.
seed_of = $(shell echo $$(($(or $(SEED),0) + 1000003 * $(1))))
define evaluated
$(work)/fit-$(1).h5: $(if $(2),$(work)/fit-$(2).h5) $(work)/scene.stamp $(work)/measured.stamp $(work)/fit.parameters $(trace) $(derive) $(bin) $(fit)
	$(if $(2),set --; while IFS= read -r v; do set -- "$$$$@" -D "$$$$v"; done <$(work)/fit-$(2).values; ,set -- ; )\
	$(LAUNCH) $(trace) $$(if $(2),$$(at_values),$$(at_start)) $$(trace_parameters) --seed $$(call seed_of,$(1)) -o $(work)/graph-%.h5$$(threads) && \
	for i in 0 1; do \
		$(LAUNCH) $(derive) $$(if $(2),$$(at_values),$$(at_start)) $(work)/graph-$$$$i.h5 $$(derive_parameters) --seed $$$$(($$(call seed_of,$(1)) + i)) \
			-o $(work)/derivative-$$$$i.h5$$(threads) && \
		$(LAUNCH) $(bin) $(work)/graph-$$$$i.h5 --derivative $(work)/derivative-$$$$i.h5 $$(bin_parameters) -o $(work)/cube-$$$$i.h5$$(threads) || exit; \
	done
	$(LAUNCH) $(merge) $(work)/cube-0.h5 $(work)/cube-1.h5 -o $(work)/evaluated-$(1).h5
	$(LAUNCH) $(fit) $$(call quote,$(MEASURED)) --cube $(work)/cube-0.h5 $(work)/cube-1.h5$(if $(2), --state $(work)/fit-$(2).h5) $$(fit_parameters) \
		--max-evaluations $(MAX_EVALUATIONS) --values $(work)/fit-$(1).values -o $$@
	$$(if $$(filter-out 0,$$(KEEP)),,rm -f $(work)/graph-?.h5 $(work)/derivative-?.h5 $(work)/cube-?.h5)$(if $(filter-out 1,$(2)),; rm -f $(work)/evaluated-$(2).h5*)
endef
before :=
$(foreach n,$(shell seq $(MAX_EVALUATIONS)),$(eval $(call evaluated,$(n),$(before)))$(eval before := $(n)))

$(OUT)/fit.h5: FORCE
	@n=1; while $(MAKE) --no-print-directory -f pipelines/fit.mk $(work)/fit-$$n.h5 && ! $(fit) --done --max-evaluations $(MAX_EVALUATIONS) --state $(work)/fit-$$n.h5; do \
		n=$$((n + 1)); [ $$n -le $(MAX_EVALUATIONS) ] || exit 1; done; \
	$(fit) --done --max-evaluations $(MAX_EVALUATIONS) --state $(work)/fit-$$n.h5 && { cmp -s $(work)/fit-$$n.h5 $@ || { cp $(work)/evaluated-$$n.h5 $(OUT)/fitted.h5 && cp $(work)/fit-$$n.h5.cost.json $@.cost.json && cp $(work)/fit-$$n.h5 $@.made && mv $@.made $@; }; }

truth = $(call defines,--truth,$(TRUTH))
$(eval $(call parameter,$(work)/charts.parameters,$(truth)))
$(OUT)/loss.svg: $(OUT)/fit.h5 $(work)/charts.parameters
	$(LAUNCH) $(fit) --state $<$(truth) --charts $@

# Pictures of the cubes at the start, at the last evaluation, and as measured; of another program's file, none.
$(OUT)/start/strip.png $(OUT)/fitted/strip.png: $(OUT)/%/strip.png: $(OUT)/fit.h5 $(draw)
	@mkdir -p $(@D)
	$(LAUNCH) $(draw) $(if $(filter start,$*),$(work)/evaluated-1.h5,$(OUT)/fitted.h5) -o $@
$(OUT)/measured/strip.png: $(work)/measured.stamp $(draw)
	@mkdir -p $(@D)
	if $(inspect) --quiet --json $(call quote,$(MEASURED)) | grep -q '"filetype": "transient_cube"'; then \
		$(LAUNCH) $(draw) $(call quote,$(MEASURED)) -o $@; else : >$@; fi
