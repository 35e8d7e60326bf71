# Error of the residual of one edit against cost: path graphs, correlated and independent paths, with bias and variance.
#
#   a reference, correlated paths of REFERENCE_SPP pairs;  REPLICATES residuals of each method at each number of samples, each
#   with its own seed, in turn;  OUT/parts.tsv: their mean square error in the parts
#     variance = R / (R - 1) (mean over replicates of mse - mse of their mean),   bias2 = mse of their mean - variance / R
#   and OUT/error.svg (mse) and OUT/bias-variance.svg (bias2, variance) against CPU time, PNG beside them
#
# Graphs make four passes of a quarter of the samples: blend; plain: without it; unbiased: two levels.
## make chart-edit-graph OLD=scenes/edits.xml NEW_DEFINES="across=40"
## Also OLD, DEFINES, SEED and the like of make edit, and OUT (out/NAME/chart-edit-graph)

.DELETE_ON_ERROR:
.NOTPARALLEL:
.PHONY: chart-edit-graph
.DEFAULT_GOAL := chart-edit-graph
include pipelines/variables.mk

OLD ?= scenes/cornell-box.xml
# NEW=  ## scene after the edit, or give NEW_DEFINES
# METHODS=  ## methods to compare (correlated independent graph graph-plain graph-unbiased)
# SPPS=  ## pairs of paths per pixel of the points of a curve (4 16 64)
# REPLICATES=  ## residuals of each point, with their own seeds (6)
# REFERENCE_SPP=  ## pairs of paths per pixel of the reference (16384)
DEFINES ?= resx=96 resy=96
METHODS ?= correlated independent graph graph-plain graph-unbiased
SPPS ?= 4 16 64
REPLICATES ?= 6
REFERENCE_SPP ?= 16384
BUILD ?= build
NEW ?= $(OLD)
include pipelines/words.mk
name := $(call scene_name,$(NEW))
OUT ?= out/$(name)/chart-edit-graph
OUT := $(OUT)
compare := $(BUILD)/bin/loom-compare
chart := $(BUILD)/bin/loom-chart
merge := $(BUILD)/bin/loom-merge
replicates := $(shell seq 0 $$(($(REPLICATES) - 1)))
# method_samples_replicate, methods turning fastest
runs := $(foreach r,$(replicates),$(foreach s,$(SPPS),$(foreach m,$(METHODS),$(m)_$(s)_$(r))))
part = $(word $(1),$(subst _, ,$(2)))
seed = $(shell printf '%s' '$(subst -plain,,$(subst -unbiased,,$(1)))$(SEED)' | cksum | cut -d' ' -f1)
graph_settings = METHOD=graph PASSES=4 SPP=$(shell echo $$(($(2) / 4))) $(if $(findstring plain,$(1)),MERGE=--no-blend) $(if $(findstring unbiased,$(1)),UNBIASED=1)
# $(call residual,METHOD,SAMPLES,NAME): make of one residual, in the folder of its target
residual = $(MAKE) -s --no-print-directory -f pipelines/edit.mk OUT=$(@D) OLD=$(call quote,$(OLD)) NEW=$(call quote,$(NEW)) DEFINES=$(call quote,$(DEFINES)) \
	NEW_DEFINES=$(call quote,$(NEW_DEFINES)) BASE=$(OUT)/base BASE_SPP=2 SEED=$(call seed,$(3)) \
	$(if $(filter graph%,$(1)),$(call graph_settings,$(1),$(2)),METHOD=$(1) SPP=$(2)) $(@D)/residual.exr >/dev/null 2>&1

chart-edit-graph: $(OUT)/error.svg $(OUT)/bias-variance.svg
	@cat $(OUT)/parts.tsv
	@for c in $(^:.svg=.png); do echo $$c; done

residuals := $(runs:%=$(OUT)/%/residual.exr)
$(residuals): $(OUT)/%/residual.exr: FORCE
	@$(call residual,$(call part,1,$*),$(call part,2,$*),$*)
$(OUT)/reference/residual.exr: FORCE
	@$(call residual,correlated,$(REFERENCE_SPP),reference)

mse = $(compare) --quiet --tsv --cost --reference $(OUT)/reference/residual.exr
$(eval $(call parameter,$(OUT)/parts.parameters,$(runs) $(REFERENCE_SPP)))
$(OUT)/parts.tsv: $(residuals) $(OUT)/reference/residual.exr $(OUT)/parts.parameters $(compare) $(merge)
	@{ printf 'scene\tmethod\tsamples\tcpu_s\tmse\tvariance\tbias2\n'; \
	$(foreach m,$(METHODS),$(foreach s,$(SPPS), \
		$(merge) --quiet --no-blend $(replicates:%=$(OUT)/$(m)_$(s)_%/residual.exr) -o $(OUT)/mean.exr && \
		{ $(mse) $(replicates:%=$(OUT)/$(m)_$(s)_%/residual.exr) && $(mse) $(OUT)/mean.exr; } | awk -F'\t' -v OFS='\t' -v start='$(name)\t$(m)\t$(s)' \
			'/relmse_trimmed/ { for (i = 1; i <= NF; ++i) at[$$i] = i; ++tables; next } \
			tables == 1 { ++n; mse[n] = $$at["mse"]; cpu[n] = $$at["cpu_s"]; sum += mse[n]; next } \
			{ v = (sum / n - $$at["mse"]) * n / (n - 1); for (i = 1; i <= n; ++i) print start, cpu[i], mse[i], v, $$at["mse"] - v / n }' && )) :; } >$@

$(OUT)/error.svg: $(OUT)/parts.tsv $(chart)
	$(chart) $< -o $@ --x cpu_s --y mse >$(@:.svg=.txt)
	@cat $(@:.svg=.txt)
$(OUT)/bias-variance.svg: $(OUT)/parts.tsv $(chart)
	$(chart) $< -o $@ --kind parts >/dev/null
