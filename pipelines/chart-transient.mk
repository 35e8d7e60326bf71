# Error against number of paths, and against cost, of the transient cubes of one scene: charts in OUT, each as SVG and PNG
# with its data and commands.
#
#   a reference cube, traced once with many samples and another seed; of Sobol points, whose error is far below what their
#   variance says, as loom-compare warns
#   REPLICATES cubes of each sampler at each number of samples, by transient.mk, each with its own seed, in turn;
#   SAMPLER+K has first hits share the light of clusters of K
#   loom-compare: errors.tsv;   loom-chart: error-samples, error-cost, with fitted slopes
#
# The error is the RMSE over all bins; of independent samples it falls as the root of their number, slope -0.5. What is
# made stays: more SAMPLERS, SPPS or REPLICATES add to it.
## make chart-transient SCENE=scenes/flash.xml SAMPLERS="independent sobol"
## Also the variables of make transient, and OUT (out/NAME/chart-transient)

.DELETE_ON_ERROR:
.NOTPARALLEL:
.PHONY: chart-transient
.DEFAULT_GOAL := chart-transient
include pipelines/variables.mk

SCENE ?= scenes/flash.xml
DEFINES ?= resx=32 resy=32
# SAMPLERS=  ## samplers of loom-trace to compare, the first with all others: sobol, independent, sobol+32 ... (independent sobol)
# SPPS=  ## samples per pixel of the points of a curve (4 16 64 256)
# REPLICATES=  ## cubes of each point, with their own seeds (3)
# REFERENCE_SPP=  ## samples per pixel of the reference, a multiple of 1024 (16384)
# ERROR=  ## column of the error: rmse, mse, relmse (rmse)
BUILD ?= build
SAMPLERS ?= independent sobol
SPPS ?= 4 16 64 256
REPLICATES ?= 3
REFERENCE_SPP ?= 16384
ERROR ?= rmse

include pipelines/words.mk
ifneq ($(shell printf '%s\n' $(call quote,$(SAMPLERS)) | tr ' ' '\n' | grep -cvxE '(sobol|independent)([+][1-9][0-9]{0,2})?'),0)
$(error SAMPLERS=$(SAMPLERS): must be of sobol, independent, sobol+K and independent+K)
endif
ifeq ($(call exists,$(SCENE)),)
$(error SCENE=$(SCENE): no such file)
endif
# A graph of more samples is traced in passes, each of which goes once it is binned.
pass := 1024
pass_spp = $(shell [ $(1) -lt $(pass) ] && echo $(1) || echo $(pass))
$(foreach s,$(SPPS) $(REFERENCE_SPP),$(if $(shell [ $(s) -lt $(pass) ] || [ $$(($(s) % $(pass))) = 0 ] || echo no),$(error \
	$(s) samples: must be below $(pass) or a multiple of it)))
name := $(call scene_name,$(SCENE))
OUT ?= out/$(name)/chart-transient
OUT := $(OUT)
compare := $(BUILD)/bin/loom-compare
chart := $(BUILD)/bin/loom-chart

# Names of runs, sampler-samples-replicate, in the order in which they are made: samplers turn fastest.
runs := $(foreach r,$(shell seq 0 $$(($(REPLICATES) - 1))),$(foreach s,$(SPPS),$(foreach m,$(SAMPLERS),$(m)-$(s)-$(r))))
cubes := $(runs:%=$(OUT)/%/cube.h5)
part = $(word $(1),$(subst -, ,$(2)))
# $(call seed,NAME): own and lasting, whatever else is made beside it.
seed = $(shell printf '%s' '$(1) $(SEED)' | cksum | cut -d' ' -f1)
# $(call cube,SAMPLER,SAMPLES,NAME): make of one cube, in the folder of its target
plus := +
sampler = $(firstword $(subst $(plus), ,$(1)))
k = $(word 2,$(subst $(plus), ,$(1)))
cube = $(MAKE) -s --no-print-directory -f pipelines/transient.mk -j1 DEFINES=$(call quote,$(DEFINES)) SAMPLER=$(call sampler,$(1)) K=$(call k,$(1)) \
	SPP=$(call pass_spp,$(2)) PASSES=$$(($(2) / $(call pass_spp,$(2)))) SEED=$(call seed,$(3)) KEEP=$(if $(call k,$(1)),1,0) OUT=$(@D) cube >/dev/null

chart-transient: $(OUT)/error-samples.svg $(OUT)/error-cost.svg
	@for c in $(^:.svg=.png); do echo $$c; done

# transient.mk knows whether there is something to do. The cubes of passes go once they are merged, their costs stay.
$(cubes): $(OUT)/%/cube.h5: FORCE
	@$(call cube,$(call part,1,$*),$(call part,2,$*),$*)
	@rm -f $(@D)/transient/*.h5
$(OUT)/reference/cube.h5: FORCE
	@$(call cube,sobol,$(REFERENCE_SPP),reference)
	@rm -f $(@D)/transient/*.h5

$(eval $(call parameter,$(OUT)/compare.parameters,$(runs) $(REFERENCE_SPP)))
$(OUT)/errors.tsv: $(cubes) $(OUT)/reference/cube.h5 $(OUT)/compare.parameters $(compare)
	$(compare) $(foreach r,$(runs),$(call part,1,$(r))=$(OUT)/$(r)/cube.h5) --reference $(OUT)/reference/cube.h5 --scene $(name) --cost --tsv >$@

$(eval $(call parameter,$(OUT)/chart.parameters,$(ERROR)))
$(OUT)/error-samples.svg $(OUT)/error-cost.svg: $(OUT)/error-%.svg: $(OUT)/errors.tsv $(OUT)/chart.parameters $(chart)
	$(chart) $< -o $@ --x $(if $(filter cost,$*),cpu_s,samples) --y $(ERROR) >$(@:.svg=.txt)
	@cat $(@:.svg=.txt)
