# Speed against accuracy of methods on one scene: charts in OUT, each as SVG and PNG with its data and commands.
#
#   error-cost     error against cost, a curve per method;      stages       CPU time by stage
#   bias-variance  the parts of that error against cost;        convergence  change by step of the refinement
#
#   a reference, path traced once with many samples (or REFERENCE=file)
#   REPLICATES images of each method at each number of samples, by still.mk, each with its own seed
#   loom-compare: errors.tsv, costs.tsv;   loom-chart: the charts, tables beside them
#
# Runs are timed one at a time, methods in turn (A B A B ...), so that a slow spell of the machine affects all of
# them; the first run of a session is preceded by one of each method that does not count. What is made stays:
# a killed session goes on, more METHODS, SPPS or REPLICATES add images to those there are.
## make chart SCENE=scenes/cornell-box.xml METHODS="pt west pathgraph" SPPS="1 4 16" REPLICATES=3
## Also SCENE, DEFINES, SEED, THREADS, TRACE, LAUNCH as for make image, and OUT (out/NAME/chart)

.DELETE_ON_ERROR:
.NOTPARALLEL:
.PHONY: chart
.DEFAULT_GOAL := chart
include pipelines/variables.mk

SCENE ?= scenes/cornell-box.xml
# METHODS=  ## methods to compare, the first with all others (pt graph); each a METHOD of make image, with settings: pathgraph+K8+ITERATIONS2
# SPPS=  ## samples per pixel of the points of a curve (1 4 16)
# REPLICATES=  ## images of each point, with their own seeds (3)
# PASS=  ## largest number of samples per pixel in a pass of methods with a graph (4)
# NAME=  ## name of the scene in tables and charts (that of its file)
# REFERENCE=  ## reference image (path traced)
# REFERENCE_SPP=  ## samples per pixel of a path-traced reference, a multiple of 64 (1024)
# REFERENCE_VARIANCE=  ## image of the reference's variance (its VarMean layer)
# COST=  ## column of the cost: cpu_s, wall_s, rays, or render_s: cpu_s without reading the scene, for small images of large scenes (cpu_s)
# ERROR=  ## column of the error: relmse, relmse_trimmed, relmse_net, mse, mse_net, mape (relmse)
BUILD ?= build
METHODS ?= pt graph
SPPS ?= 1 4 16
REPLICATES ?= 3
PASS ?= 4
REFERENCE_SPP ?= 1024
COST ?= cpu_s
ERROR ?= relmse

include pipelines/words.mk
missing := $(foreach v,SCENE REFERENCE REFERENCE_VARIANCE,$(if $($(v)),$(if $(call exists,$($(v))),,$(v)=$($(v)))))
ifneq ($(strip $(missing)),)
$(error $(strip $(missing)): no such file)
endif
name := $(or $(NAME),$(call scene_name,$(SCENE)))
OUT ?= out/$(subst $(space),_,$(name))/chart
OUT := $(OUT)

compare := $(BUILD)/bin/loom-compare
chart := $(BUILD)/bin/loom-chart
reference := $(if $(REFERENCE),$(call quote,$(REFERENCE)),$(OUT)/reference/image.exr)
reference_made := $(if $(REFERENCE),$(OUT)/given.stamp,$(reference))
reference_pass := $(shell [ $(REFERENCE_SPP) -lt 64 ] && echo $(REFERENCE_SPP) || echo 64)
reference_passes := $(shell echo $$(($(REFERENCE_SPP) / $(reference_pass))))
ifneq ($(shell echo $$(($(REFERENCE_SPP) % $(reference_pass)))),0)
$(error REFERENCE_SPP=$(REFERENCE_SPP): must be below 64 or a multiple of it)
endif

# Names of runs, method-samples-replicate, in the order in which they are made: methods turn fastest.
runs := $(foreach r,$(shell seq 0 $$(($(REPLICATES) - 1))),$(foreach s,$(SPPS),$(foreach m,$(METHODS),$(m)-$(s)-$(r))))
images := $(runs:%=$(OUT)/%/image.exr)
part = $(word $(1),$(subst -, ,$(2)))

# $(call seed,NAME): own and lasting, whatever else is made beside it.
seed = $(shell printf '%s' '$(1) $(SEED)' | cksum | cut -d' ' -f1)

# pathgraph+K8+PASS1 -> method pathgraph, settings K=8; PASS is handled here.
method = $(firstword $(subst +, ,$(1)))
settings = $(shell echo '$(wordlist 2,99,$(subst +, ,$(1)))' | sed -E 's/([A-Z]+)([0-9]+)/\1=\2/g')
pass = $(or $(patsubst PASS=%,%,$(filter PASS=%,$(call settings,$(1)))),$(PASS))
ifneq ($(shell printf '%s\n' $(METHODS) | grep -cvxE '[a-z]+([+](K|ITERATIONS|PASS|DIRECT)[0-9]{1,8})*'),0)
$(error METHODS=$(METHODS): each must be a METHOD, with settings after +: K, ITERATIONS, PASS, DIRECT with a number)
endif

# $(call still,METHOD,SAMPLES,SEED,FOLDER): samples in passes of at most PASS, but for path tracing in one.
pass_spp = $(shell [ '$(call method,$(1))' = pt ] || [ $(2) -lt $(call pass,$(1)) ] && echo $(2) || echo $(call pass,$(1)))
passes = $(shell echo $$(($(2) / $(call pass_spp,$(1),$(2)))))
still = $(MAKE) -s --no-print-directory -f pipelines/still.mk -j1 METHOD=$(call method,$(1)) SPP=$(call pass_spp,$(1),$(2)) \
	PASSES=$(call passes,$(1),$(2)) SEED=$(3) OUT=$(4) KEEP= $(filter-out PASS=%,$(call settings,$(1)))
$(foreach m,$(METHODS),$(foreach s,$(SPPS),$(if $(shell [ $(s) -lt $(call pass,$(m)) ] || [ $$(($(s) % $(call pass,$(m)))) = 0 ] || echo no),$(error \
	SPPS: $(s) is no multiple of PASS=$(call pass,$(m)) of $(m)))))

# Bias and variance are told apart by replicates; only the refinement has steps.
charts := $(patsubst %,$(OUT)/%.svg,stages $(if $(filter-out 1,$(REPLICATES)),bias-variance) $(if $(filter pathgraph pathgraph+%,$(METHODS)),convergence))
chart: $(OUT)/error-cost.svg $(charts)
	@rm -rf $(OUT)/.warm-up*
	@for c in $(^:.svg=.png); do [ ! -e $$c ] || echo $$c; done

# still.mk knows whether there is something to do; an image that it leaves alone keeps its time stamp.
# Graphs are large: they go once the image is there, and their costs stay.
session := $(shell echo $$PPID)
$(images): $(OUT)/%/image.exr: FORCE
	@$(call still,$(call part,1,$*),$(call part,2,$*),$(call seed,$*),$(@D)) -q $@ || { \
		$(MAKE) -s --no-print-directory -f pipelines/chart.mk OUT=$(OUT) $(OUT)/.warm-up-$(session) && \
		$(call still,$(call part,1,$*),$(call part,2,$*),$(call seed,$*),$(@D)) image >/dev/null; }
	@set -- $(@D)/*/*.radiance.h5; [ ! -e "$$1" ] || $(inspect) --quiet --iterations "$$1" >$(@D)/iterations.tsv
	@rm -f $(@D)/*/*.h5

$(OUT)/.warm-up-%:
	@$(foreach m,$(METHODS),$(call still,$(m),$(firstword $(SPPS)),0,$@.partial/$(m)) image >/dev/null &&) rm -rf $@.partial
	@touch $@

ifeq ($(REFERENCE),)
$(OUT)/reference/image.exr: FORCE
	@$(MAKE) -s --no-print-directory -f pipelines/still.mk METHOD=pt SPP=$(reference_pass) PASSES=$(reference_passes) \
		SEED=$(call seed,reference) OUT=$(@D) KEEP= image >/dev/null
endif

$(eval $(call parameter,$(OUT)/compare.parameters,$(runs) $(REFERENCE) $(REFERENCE_VARIANCE)))
$(eval $(call parameter,$(OUT)/chart.parameters,$(COST) $(ERROR)))

# What make peers left: images of other renderers, by name as ours.
peers := $(filter-out $(runs:%=$(OUT)/peers/%/image.exr),$(wildcard $(OUT)/peers/*/image.exr))
labelled = $(foreach r,$(runs),$(call part,1,$(r))=$(OUT)/$(r)/image.exr) \
	$(foreach p,$(peers),$(call quote,$(call part,1,$(notdir $(patsubst %/,%,$(dir $(p)))))=$(p)))
variance = $(if $(REFERENCE_VARIANCE),--reference-variance $(call quote,$(REFERENCE_VARIANCE)))
# Images that are not made here: by their contents.
given_files := $(foreach p,$(peers),$(call quote,$(p))) $(foreach v,REFERENCE REFERENCE_VARIANCE,$(if $($(v)),$(call quote,$($(v)))))
given_stamp := $(if $(strip $(given_files)),$(OUT)/given.stamp)
$(if $(given_stamp),$(eval $(call stamp,$(given_stamp),$(given_files))))
$(OUT)/errors.tsv: $(images) $(given_stamp) $(reference_made) $(OUT)/compare.parameters $(compare)
	$(compare) $(labelled) --reference $(reference) $(variance) --scene $(call quote,$(name)) --cost --tsv >$@

$(OUT)/costs.tsv: $(images) $(given_stamp) $(OUT)/compare.parameters $(compare)
	$(compare) $(labelled) --scene $(call quote,$(name)) --cost --tsv >$@

$(OUT)/error-cost.svg: $(OUT)/errors.tsv $(OUT)/chart.parameters $(chart)
	$(chart) $< -o $@ --x $(COST) --y $(ERROR) >$(OUT)/error-cost.txt
	@cat $(OUT)/error-cost.txt

$(OUT)/stages.svg: $(OUT)/costs.tsv $(OUT)/chart.parameters $(chart)
	$(chart) $< --kind stages -o $@ --x $(or $(filter %_s,$(COST)),cpu_s)

$(OUT)/bias-variance.svg: $(OUT)/errors.tsv $(OUT)/chart.parameters $(chart)
	$(chart) $< --kind parts -o $@ --x $(COST)

# The last pass of each image of the most samples. A log axis has no place for 0, and numbers of 32 bits have none
# for changes of less than 1e-8.
refined := $(foreach r,$(runs),$(if $(and $(filter pathgraph pathgraph+%,$(call part,1,$(r))),$(filter $(lastword $(SPPS)),$(call part,2,$(r)))),$(r)))
$(OUT)/iterations.tsv: $(refined:%=$(OUT)/%/image.exr) $(OUT)/compare.parameters
	@{ printf 'scene\tmethod\titeration\tresidual\timage_change\n'; \
	$(foreach r,$(refined),awk -v OFS='\t' 'FNR > 1 { print "$(name)", "$(call part,1,$(r))", $$1, $$2 < 1e-8 ? 1e-8 : $$2, $$3 }' $(OUT)/$(r)/iterations.tsv;) } >$@

$(OUT)/convergence.svg: $(OUT)/iterations.tsv $(chart)
	@if [ $$(wc -l <$<) -gt 1 ]; then $(chart) $< -o $@ --x iteration --y residual --linear-x >$(OUT)/convergence.txt; \
	else echo 'no light is refined: paths end after their first vertex' >&2; \
		printf '%s\n' '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 800 60"><text x="20" y="36">No light is refined: paths end after their first vertex.</text></svg>' >$@; \
	fi
