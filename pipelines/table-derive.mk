# Derivatives by loom-derive compared with differences of scenes, at equal CPU time, a row per parameter: OUT/table.tsv and .md.
#
#   scenes/shadow-mover.xml   a slab, the light, the floor and the camera move
#   scenes/tower.xml          a tower turns                                        [TR] Figures 4 and 5
#   egg                       the right light and its case, in height, of [TR] Figures 4 and 5, where ../shared is;
#                             not by default
#
#   error     MSE of the derivative over all pixels, bins and channels: noise and bias. The reference is the mean (a + b) / 2 of two
#             long runs of loom-derive; its noise is taken out by (x - a)(x - b) = (x - (a + b) / 2)^2 - (a - b)^2 / 4
#   cost      CPU seconds of trace, derive and bin on one thread, reading the scene not counted
#   difference  (f(h) - f(-h)) / (2 h) of two cubes traced with the same random numbers (loom-merge --quotient), for each of four h
#   ratio     error x cost of differences at their best h, over that of the method. The best h is chosen by the measured errors,
#             and it depends on the samples: with more of them noise falls and bias stays
#   overhead  cost over that of trace and bin without derivative, - 1
#   p         of loom-compare: whether the mean of all differences at the smallest h agrees with the reference
#
# METHODS are auto (the default of loom-derive), or an option and its value: direct-lights, direct-vertices, attach-surface,
# attach-ray, light-points-N; or widen-N: what moves between bins is averaged over N bins (loom-transient --widen), biased like a
# difference. Runs are timed one at a time, methods in turn. What is made stays: more METHODS, ROWS or REPLICATES add to it.
#
#   make table-derive                              all rows but egg, about four minutes
#   make table-derive ROWS=occluder_x METHODS="auto direct-lights direct-vertices"
#   make table-derive DOCS=docs                    and the table into docs/derivatives.md
## make table-derive ROWS="occluder_x turn" METHODS="auto attach-surface"
## Also SEED, EFFORT (of loom-derive) and OUT (out/table-derive)

.DELETE_ON_ERROR:
.NOTPARALLEL:
.PHONY: table-derive
.DEFAULT_GOAL := table-derive
include pipelines/variables.mk

# ROWS=  ## parameters to run, by name (all but egg)
# METHODS=  ## auto, OPTION-VALUE of loom-derive (direct-lights attach-surface), or widen-BINS (auto)
# SPP=  ## samples per pixel of each run (256)
# REPLICATES=  ## runs of each method, with their own seeds (6)
# PASSES=  ## runs of SPP samples in each half of a reference (4)
# SIZE=  ## side of an image, px (32)
# DOCS=  ## folder whose derivatives.md receives the table (none)
BUILD ?= build
ROWS ?= occluder_x light_x floor_z camera_x turn
METHODS ?= auto
SPP ?= 256
REPLICATES ?= 6
PASSES ?= 4
SIZE ?= 32
OUT ?= out/table-derive
OUT := $(OUT)
egg := ../shared/scenes/egg/scene_v3.xml

include pipelines/words.mk
ifneq ($(shell printf '%s\n' $(METHODS) | grep -cvxE 'auto|(direct|attach)-[a-z]+|light-points-[0-9]+|widen-[0-9]+(\.[0-9]+)?'),0)
$(error METHODS=$(METHODS): each must be auto, direct-VALUE, attach-VALUE or light-points-N, as options of loom-derive, or widen-BINS)
endif

# scenes|row|scene|parameter|its unit|values of h|length of a bin and of the pulse|further values
shadow := scenes/shadow-mover.xml
edits := \
	own|occluder_x|$(shadow)|occluder_x|m|0.1+0.03+0.01+0.003|0.1|bins=80 \
	own|light_x|$(shadow)|light_x|m|0.3+0.1+0.03+0.01|0.1|bins=80 \
	own|floor_z|$(shadow)|floor_z|m|0.03+0.01+0.003+0.001|0.1|bins=80 \
	own|camera_x|$(shadow)|camera_x|m|0.1+0.03+0.01+0.003|0.1|bins=80 \
	own|turn|scenes/tower.xml|turn|degree|10+3+1+0.3|0.1|bins=80 \
	egg|egg|$(egg)|theta|m|30+10+3+1|71.95019|bins=84
here = $(if $(filter egg,$(1)),$(wildcard $(egg)),here)
needs := $(egg)
include pipelines/rows.mk

bin := $(BUILD)/bin
compare := $(bin)/loom-compare
merge := $(bin)/loom-merge
programs := $(addprefix $(bin)/loom-,trace derive transient merge)

# $(call seed,NAME): own and lasting, whatever else is made beside it.
seed = $(shell printf '%s' '$(1) $(SEED)' | cksum | cut -d' ' -f1)
scene = $(call field,3,$(1))
wrt = $(call field,4,$(1))
values = $(foreach v,resx=$(SIZE) resy=$(SIZE) bin_width=$(call field,7,$(1)) width=$(call field,7,$(1)) $(subst +, ,$(call field,8,$(1))),\
	$(if $(shell grep -o '<default name="$(firstword $(subst =, ,$(v)))"' $(call scene,$(1))),-D $(v)))
trace = $(bin)/loom-trace --quiet --threads 1 $(call scene,$(1)) $(values.$(1)) --sampler independent --spp $(SPP) --seed $(2)
bins = $(bin)/loom-transient --quiet --threads 1 --pulse box --pulse-length $(call field,7,$(1))
option = $(if $(filter auto widen-%,$(1)),,$(if $(filter light-points-%,$(1)),--light-points $(1:light-points-%=%),--$(subst -, ,$(1))))
# $(call widen,ROW,METHOD)
widen = $(if $(filter widen-%,$(2)),--widen $(shell awk 'BEGIN {print $(call field,7,$(1)) * $(2:widen-%=%)}'))

# Cubes of one replicate. Graphs go once they are binned, their costs stay.
$(foreach w,$(ROWS),$(eval values.$(w) := $(call values,$(w))))

# $(call derived,ROW,METHOD,NAME)
define derived
$(OUT)/$(1)/$(3)/cube.h5: $(call scene,$(1)) $(OUT)/$(1)/run.parameters $(programs)
	@mkdir -p $$(@D) && echo '$(1)/$(3)' >&2
	@$(call trace,$(1),$(call seed,$(1)/$(3))) --primitives --media -o $$(@D)/graph.h5
	@$(bin)/loom-derive --quiet --threads 1 $(call scene,$(1)) $$(@D)/graph.h5 $(values.$(1)) --wrt $(call wrt,$(1)) \
		--seed $(call seed,$(1)/$(3) boundary) $(if $(EFFORT),--effort $(EFFORT)) $(call option,$(2)) -o $$(@D)/derivative.h5
	@$(call bins,$(1)) $$(@D)/graph.h5 -o $$(@D)/plain.h5
	@$(call bins,$(1)) $$(@D)/graph.h5 --derivative $$(@D)/derivative.h5 $(call widen,$(1),$(2)) -o $$@
	@rm -f $$(@D)/graph.h5 $$(@D)/derivative.h5
endef
# $(call difference,ROW,H,NAME)
define difference
$(OUT)/$(1)/$(3)/cube.h5: $(call scene,$(1)) $(OUT)/$(1)/run.parameters $(programs)
	@mkdir -p $$(@D) && echo '$(1)/$(3)' >&2
	@for side in low=-$(2) high=$(2); do $(call trace,$(1),$(call seed,$(1)/$(3))) -D $(call wrt,$(1))=$$$${side#*=} \
		-o $$(@D)/graph-$$$${side%=*}.h5 && $(call bins,$(1)) $$(@D)/graph-$$$${side%=*}.h5 -o $$(@D)/$$$${side%=*}.h5 || exit; done
	@$(merge) --quiet $$(@D)/high.h5 --minus $$(@D)/low.h5 --quotient $(call wrt,$(1))=-$(2):$(2) -o $$@
	@rm -f $$(@D)/graph-low.h5 $$(@D)/graph-high.h5
endef

steps = $(subst +, ,$(call field,6,$(1)))
replicates := $(shell seq 0 $$(($(REPLICATES) - 1)))
passes := $(shell seq 1 $(PASSES))
half = $(foreach p,$(passes),$(OUT)/$(1)/half-$(2)-$(p)/cube.h5)
runs_of = $(foreach r,$(replicates),$(foreach m,$(METHODS),$(OUT)/$(1)/$(m)-$(r)/cube.h5) $(foreach h,$(call steps,$(1)),$(OUT)/$(1)/step-$(h)-$(r)/cube.h5))
# Of the smallest h.
sides = $(foreach r,$(replicates),$(OUT)/$(1)/step-$(lastword $(call steps,$(1)))-$(r)/$(2).h5)
labelled = $(foreach r,$(replicates),$(foreach m,$(METHODS),$(m)=$(OUT)/$(1)/$(m)-$(r)/cube.h5) $(foreach h,$(call steps,$(1)),step-$(h)=$(OUT)/$(1)/step-$(h)-$(r)/cube.h5))

define row
$(eval $(call parameter,$(OUT)/$(1)/run.parameters,$(foreach n,3 4 7 8,$(call field,$(n),$(1))) $(SPP) $(SIZE) $(SEED) $(EFFORT)))
$(eval $(call parameter,$(OUT)/$(1)/row.parameters,$(METHODS) $(REPLICATES) $(PASSES)))
$(foreach r,$(replicates),$(foreach m,$(METHODS),$(eval $(call derived,$(1),$(m),$(m)-$(r))))$(foreach h,$(call steps,$(1)),$(eval $(call difference,$(1),$(h),step-$(h)-$(r)))))
$(foreach h,0 1,$(foreach p,$(passes),$(eval $(call derived,$(1),auto,half-$(h)-$(p)))))
$(OUT)/$(1)/row.tsv: $(call runs_of,$(1)) $(call half,$(1),0) $(call half,$(1),1) $(OUT)/$(1)/row.parameters $(compare) pipelines/table-derive.awk
	@$(foreach h,0 1,$(merge) --quiet $(call half,$(1),$(h)) -o $$(@D)/half-$(h).h5 &&) $(merge) --quiet $$(@D)/half-0.h5 $$(@D)/half-1.h5 -o $$(@D)/reference.h5
	@$(compare) --quiet --tsv --parameter $(call wrt,$(1)) half=$$(@D)/half-0.h5 --reference $$(@D)/half-1.h5 >$$(@D)/noise.tsv
	@$(compare) --quiet --tsv --parameter $(call wrt,$(1)) --cost $(call labelled,$(1)) --reference $$(@D)/reference.h5 >$$(@D)/errors.tsv
	@$(merge) --quiet $(call sides,$(1),high) --minus $(call sides,$(1),low) --quotient $(call wrt,$(1))=-$(lastword $(call steps,$(1))):$(lastword $(call steps,$(1))) -o $$(@D)/check.h5
	@$(compare) --quiet --tsv --parameter $(call wrt,$(1)) check=$$(@D)/check.h5 --reference $$(@D)/reference.h5 >$$(@D)/check.tsv
	@$(compare) --quiet --tsv --cost $(foreach r,$(replicates),$(OUT)/$(1)/$(firstword $(METHODS))-$(r)/plain.h5) >$$(@D)/plain.tsv
	@awk -v row='$(1)' -v unit='$(call field,5,$(1))' -f pipelines/table-derive.awk $$(@D)/noise.tsv $$(@D)/check.tsv $$(@D)/plain.tsv $$(@D)/errors.tsv >$$@
endef
$(foreach w,$(ROWS),$(eval $(call row,$(w))))

table-derive: $(OUT)/table.md
ifneq ($(strip $(DOCS)),)
	@mkdir -p $(DOCS) && touch $(DOCS)/derivatives.md && awk -v tables=$(OUT)/table.md -f pipelines/insert-tables.awk $(DOCS)/derivatives.md >$(OUT)/page.md && cp $(OUT)/page.md $(DOCS)/derivatives.md
endif
	@cat $(OUT)/table.md
	@echo $(OUT)/table.tsv

$(eval $(call parameter,$(OUT)/rows.parameters,$(ROWS)))
$(OUT)/table.tsv: $(ROWS:%=$(OUT)/%/row.tsv) $(OUT)/rows.parameters
	@awk 'NR == 1 || FNR > 1' $(filter %.tsv,$^) >$@

$(OUT)/table.md: $(OUT)/table.tsv pipelines/table-derive-page.awk
	@awk -v made="$(REPLICATES) runs of each, $(SIZE) x $(SIZE) px, $(SPP) samples per pixel, references of 2 x $(PASSES) runs" \
		-f pipelines/table-derive-page.awk $< >$@
