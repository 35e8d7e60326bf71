# Gain of each choice among path graphs' settings at equal time: OUT/SCENE/table.tsv, all scenes in OUT/table.tsv, printed.
#
#   make choices CHOICES=gathers   the gathers of loom-gather, of the same passes; not blended, but for the last rows
#   make choices CHOICES=pools     samples of a pass, and vertices of a cluster, at the same number of samples
#   make choices CHOICES=directs   further samples of direct light, of the same passes
#
#   gain     relMSE of path tracing (0.1 % worst pixels left out) given as much CPU time, over that of the choice; between
#            two numbers of samples path tracing is taken to follow a power of its cost
#   corr     correlation of the errors of neighbouring pixels
#
# Costs are those of whole chains, of which reading the scene is taken off. Scenes, references as in table.mk.
## make choices CHOICES=pools SCENES=scenes/cornell-box.xml
## Also REFERENCE_SPP as for make table, and OUT (out/CHOICES)

.DELETE_ON_ERROR:
.NOTPARALLEL:
.PHONY: choices
.DEFAULT_GOAL := choices
include pipelines/variables.mk

# CHOICES=  ## which choice to compare: gathers, pools or directs (gathers)
# SCENES=  ## scene files (five of the shared ones if present, else two of scenes/)
# REFERENCES=  ## folder of NAME_ref.exr and NAME_var.exr (../shared/oracles/scenes)
BUILD ?= build
CHOICES ?= gathers
shared := $(wildcard $(foreach s,cornell-box dining-room staircase classroom sponza,../shared/scenes/$(s)/scene_v3.xml))
SCENES ?= $(or $(shared),scenes/cornell-box.xml scenes/glossy-box.xml)
REFERENCES ?= ../shared/oracles/scenes
REFERENCE_SPP ?= 4096
OUT ?= out/$(CHOICES)
include pipelines/words.mk

# name|variables of still.mk
define gathers
own|MERGE=--no-blend GATHER="--direct own --indirect own"
cluster|MERGE=--no-blend
own, cluster|MERGE=--no-blend GATHER="--direct own"
own, subset 4|MERGE=--no-blend GATHER="--direct own --indirect subset"
own, 4 points|MERGE=--no-blend GATHER="--direct own --indirect subset --reuse points"
own, 4 with rays|MERGE=--no-blend GATHER="--direct own --indirect subset --occlusion"
own, subset 12|MERGE=--no-blend GATHER="--direct own --indirect subset --members 12"
own, 12 points|MERGE=--no-blend GATHER="--direct own --indirect subset --members 12 --reuse points"
own, 12 with rays|MERGE=--no-blend GATHER="--direct own --indirect subset --members 12 --occlusion"
both subset 4|MERGE=--no-blend GATHER="--direct subset --indirect subset"
both subset 12|MERGE=--no-blend GATHER="--direct subset --indirect subset --members 12"
blend|
blend 4 with rays|GATHER="--indirect subset --occlusion"
blend 12 with rays|GATHER="--indirect subset --members 12 --occlusion"
endef
define pools
1 spp, K 8|SPP=1 K=8 PASSES=16
1 spp, K 16|SPP=1 K=16 PASSES=16
2 spp, K 16|SPP=2 K=16 PASSES=8
2 spp, K 32|SPP=2 K=32 PASSES=8
4 spp, K 8|SPP=4 K=8 PASSES=4
4 spp, K 16|SPP=4 K=16 PASSES=4
4 spp, K 32|SPP=4 K=32 PASSES=4
4 spp, K 64|SPP=4 K=64 PASSES=4
endef
define directs
none|DIRECT=0
as many|DIRECT=16
4 times|DIRECT=64
16 times|DIRECT=256
as planned|DIRECT=auto
endef
ifeq ($(filter gathers pools directs,$(CHOICES)),)
$(error CHOICES=$(CHOICES): must be gathers, pools or directs)
endif

compare := $(BUILD)/bin/loom-compare
tables := $(foreach s,$(SCENES),$(OUT)/$(call row_name,$(s))/table.tsv)
$(shell mkdir -p $(OUT))
$(file >$(OUT)/choices.txt,$($(CHOICES)))

# still.mk with what it does not find in this make's variables.
image = $(MAKE) --no-print-directory -s -f pipelines/still.mk BUILD=$(BUILD) SCENE=$(scene) OUT=$(@D)/$(1) $(2) image >/dev/null 2>&1

define table
$(call scene_row,$(OUT)/$(call row_name,$(1))/table.tsv,$(1))
$(OUT)/$(call row_name,$(1))/table.tsv: pipelines/choices.mk pipelines/still.mk $(wildcard $(BUILD)/bin/loom-*)
	@mkdir -p $$(@D)
	@echo '$(call row_name,$(1))' >&2
	@set -e; ref='$(REFERENCES)/$(call row_name,$(1))_ref.exr'; var='$(REFERENCES)/$(call row_name,$(1))_var.exr'; size='resx=256 resy=256'; \
	if [ -f "$$$$ref" ]; then \
		size=$$$$($(BUILD)/bin/loom-inspect --quiet --json "$$$$ref" | tr -d ' \n' | \
			sed -E 's/.*"dataWindow":"x0to([0-9]+),y0to([0-9]+)".*/\1 \2/' | awk '{ print "resx=" $$$$1 + 1, "resy=" $$$$2 + 1 }'); \
	else \
		ref=$$(@D)/reference/image.exr; var=; \
		$$(call image,reference,METHOD=pt SPP=64 PASSES=$$$$(($(REFERENCE_SPP) / 64)) SEED=77 DEFINES="$$$$size"); \
	fi; \
	given="--reference $$$$ref"; [ ! -f "$$$$var" ] || given="$$$$given --reference-variance $$$$var"; \
	$$(call image,load,METHOD=pt SPP=1 DEFINES="resx=16 resy=16"); \
	for n in 16 64 256; do $$(call image,pt-$$$$n,METHOD=pt SPP=$$$$n DEFINES="$$$$size"); done; \
	load=$$$$($(compare) --quiet --tsv --cost $$(@D)/load/image.exr | awk -F'\t' '$$$$6 == "loom-trace" { print $$$$9 }'); \
	$(compare) --quiet --tsv --cost $$$$given $$(foreach n,16 64 256,pt-$$n=$$(@D)/pt-$$n/image.exr) >$$(@D)/errors.tsv; \
	while IFS='|' read -r way variables; do \
		eval "$$(call image,passes,METHOD=pathgraph KEEP=1 DIRECT=0 DEFINES=\"$$$$size\" $$$$variables)"; \
		$(compare) --quiet --tsv --cost $$$$given "$$$$way=$$(@D)/passes/image.exr" | tail -n +2 >>$$(@D)/errors.tsv; \
		cp $$(@D)/passes/image.png "$$(@D)/$$$$way.png"; \
	done <$(OUT)/choices.txt; \
	rm -rf $$(@D)/passes; \
	awk -F'\t' -v OFS='\t' -v load="$$$$load" -v scene='$(call row_name,$(1))' \
		'FNR == 1 { for (i = 1; i <= NF; ++i) at[$$$$i] = i; next } \
		{ e = $$$$at["relmse_trimmed"] - $$$$at["reference_noise"]; cost = $$$$at["cpu_s"] - load } \
		$$$$2 ~ /^pt-/ { ++n; x[n] = log(cost); y[n] = log(e); next } \
		!head++ { print "scene", "choice", "cpu_s", "relmse_trimmed", "gain", "corr_right", "corr_down" } \
		{ if ($$$$2 ~ /with rays/) cost -= 4 * load; \
		  k = log(cost) < x[2] ? 1 : 2; pt = exp(y[k] + (y[k + 1] - y[k]) * (log(cost) - x[k]) / (x[k + 1] - x[k])); \
		  print scene, $$$$2, cost, e, pt / e, $$$$at["corr_right"], $$$$at["corr_down"] }' $$(@D)/errors.tsv >$$@
endef
$(foreach s,$(SCENES),$(eval $(call table,$(s))))

$(OUT)/table.tsv: $(tables)
	@awk 'NR == 1 || FNR > 1' $^ >$@

choices: $(OUT)/table.tsv
	@awk -F'\t' 'NR == 1 { next } !($$1 in seen) { seen[$$1] = ++n; scene[n] = $$1 } !($$2 in way) { way[$$2] = ++m; name[m] = $$2 } \
		{ gain[$$1, $$2] = $$5; corr[$$1, $$2] = $$6; cost[$$1, $$2] = $$3 } \
		END { printf "%-18s", "gain | corr"; for (s = 1; s <= n; ++s) printf "%17s", scene[s]; printf "%17s\n", "geometric mean"; \
		  for (w = 1; w <= m; ++w) { printf "%-18s", name[w]; logs = 0; sum = 0; \
		    for (s = 1; s <= n; ++s) { printf "%9.2f | %5.2f", gain[scene[s], name[w]], corr[scene[s], name[w]]; \
		      logs += log(gain[scene[s], name[w]]); sum += corr[scene[s], name[w]] } \
		    printf "%9.2f | %5.2f\n", exp(logs / n), sum / n } }' $<
	@echo $<
