# Cost and error of path graphs on many scenes, one row each: OUT/table.tsv, printed as a table.
#
#   cost    CPU seconds per sample of every pixel and stage, at the scene's own size, reading the scene not counted, of
#           four passes of four samples as make image takes them (a process reuses the memory of its passes);
#           the samples of direct light that the blend took at small size included, as many as pay there (direct_spp);
#           their sum over that of path tracing is the cost ratio
#   error   relMSE at small size after 1 sample and after 16, plain and without the 0.1 % worst pixels, against
#           REFERENCES/NAME_ref.exr where it is, else a path-traced reference
#   equal   path tracing given as many samples as take the time of those 16: its error over that of path graphs; errors
#           are means over REPLICATES images with their own random numbers, se the standard error of the plain gain:
#           a few bright pixels decide the error of one image
#
# Rows are made one at a time, so that their costs do not disturb each other; what is made stays.
## make table SCENES="scenes/cornell-box.xml scenes/glossy-box.xml"
## Also OUT (out/table)

.DELETE_ON_ERROR:
.NOTPARALLEL:
.PHONY: table
.DEFAULT_GOAL := table
include pipelines/variables.mk

# SCENES=  ## scene files (the shared ones if present, else some of scenes/)
# REFERENCES=  ## folder of NAME_ref.exr and NAME_var.exr (../shared/oracles/scenes)
# REPLICATES=  ## images over which errors are averaged (1)
# REFERENCE_SPP=  ## samples per pixel of a path-traced reference (4096)
BUILD ?= build
shared := $(wildcard ../shared/scenes/*/scene_v3.xml ../shared/scenes/*/scene_glossy_v3.xml ../shared/scenes/*/scene_area_v3.xml)
SCENES ?= $(or $(shared),scenes/cornell-box.xml scenes/glossy-box.xml)
REFERENCES ?= ../shared/oracles/scenes
REFERENCE_SPP ?= 4096
REPLICATES ?= 1
include pipelines/words.mk
seeds := $(shell seq 0 $$(($(REPLICATES) - 1)))
OUT ?= out/table

compare := $(BUILD)/bin/loom-compare
rows := $(foreach s,$(SCENES),$(OUT)/$(call row_name,$(s))/row.tsv)

# $(call image,FOLDER,VARIABLES)
image = $(MAKE) --no-print-directory -s -f pipelines/still.mk BUILD=$(BUILD) SCENE=$(scene) OUT=$(@D)/$(1) $(2) image >/dev/null
# $(call seconds,FOLDER,STAGE): CPU seconds per sample
seconds = $$($(compare) --quiet --tsv --cost $(@D)/$(1)/image.exr | awk -F'\t' '$$6 ~ /^$(2)$$/ { s += $$9 } END { print s + 0 }')

define row
$(call scene_row,$(OUT)/$(call row_name,$(1))/row.tsv,$(1))
$(OUT)/$(call row_name,$(1))/row.tsv: pipelines/table.mk pipelines/still.mk $(wildcard $(BUILD)/bin/loom-*)
	@mkdir -p $$(@D)
	@echo '$(call row_name,$(1))' >&2
	@$$(call image,load,METHOD=pt SPP=1 DEFINES="resx=16 resy=16")
	@$$(call image,cost-pt,METHOD=pt SPP=4)
	@$$(call image,cost-pathgraph,METHOD=pathgraph SPP=4 PASSES=4 DIRECT=0)
	@$$(call image,cost-direct,METHOD=pt SPP=16 TRACE="--max-depth 2")
	@set -e; ref='$(REFERENCES)/$(call row_name,$(1))_ref.exr'; var='$(REFERENCES)/$(call row_name,$(1))_var.exr'; \
	load=$$(call seconds,load,loom-trace); \
	plain=$$(call seconds,cost-pt,loom-trace); trace=$$(call seconds,cost-pathgraph,loom-trace); \
	cluster=$$(call seconds,cost-pathgraph,loom-cluster); refine=$$(call seconds,cost-pathgraph,loom-refine); \
	gather=$$(call seconds,cost-pathgraph,loom-gather); merge=$$(call seconds,cost-pathgraph,loom-merge); direct=$$(call seconds,cost-direct,loom-trace); \
	if [ -f "$$$$ref" ]; then \
		size=$$$$($(BUILD)/bin/loom-inspect --quiet --json "$$$$ref" | tr -d ' \n' | \
			sed -E 's/.*"dataWindow":"x0to([0-9]+),y0to([0-9]+)".*/\1 \2/' | awk '{ print "resx=" $$$$1 + 1, "resy=" $$$$2 + 1 }'); \
	else \
		size='resx=256 resy=256'; ref=$$(@D)/reference/image.exr; var=; \
		$$(call image,reference,METHOD=pt SPP=64 PASSES=$$$$(($(REFERENCE_SPP) / 64)) SEED=77 DEFINES="$$$$size"); \
	fi; \
	for s in $(seeds); do \
		$$(call image,pt-1-$$$$s,METHOD=pt SPP=1 SEED=$$$$s DEFINES="$$$$size"); \
		$$(call image,pathgraph-1-$$$$s,METHOD=pathgraph SPP=1 PASSES=1 SEED=$$$$s DEFINES="$$$$size"); \
		$$(call image,pt-16-$$$$s,METHOD=pt SPP=16 SEED=$$$$s DEFINES="$$$$size"); \
		$$(call image,pathgraph-16-$$$$s,METHOD=pathgraph SPP=4 PASSES=4 SEED=$$$$s DEFINES="$$$$size"); \
	done; \
	n=$$$$(cat $(seeds:%=$$(@D)/pathgraph-16-%/pathgraph/direct.samples) | awk '{ n += $$$$1 } END { print n / NR }'); \
	ratio=$$$$(awk "BEGIN { print (($$$$trace - $$$$load + $$$$cluster + $$$$refine + $$$$gather + $$$$merge) / 16 + ($$$$direct - $$$$load) / 16 * $$$$n / 16) / (($$$$plain - $$$$load) / 4) }"); \
	equal=$$$$(awk "BEGIN { print int(16 * $$$$ratio + 0.5) }"); \
	for s in $(seeds); do $$(call image,pt-equal-$$$$s,METHOD=pt SPP=$$$$equal SEED=$$$$s DEFINES="$$$$size"); done; \
	$(compare) --quiet --tsv --reference "$$$$ref" $$$${var:+$$$$([ -f "$$$$var" ] && echo --reference-variance "$$$$var")} \
		$$(foreach p,pt-1 pathgraph-1 pt-16 pathgraph-16 pt-equal,$$(foreach s,$(seeds),$$(p)=$$(@D)/$$(p)-$$(s)/image.exr)) >$$(@D)/errors.tsv; \
	awk -F'\t' -v OFS='\t' -v scene='$(call row_name,$(1))' -v load="$$$$load" -v plain="$$$$plain" -v trace="$$$$trace" \
		-v cluster="$$$$cluster" -v refine="$$$$refine" -v gather="$$$$gather" -v merge="$$$$merge" -v direct="$$$$direct" -v n="$$$$n" -v R=$(REPLICATES) -v ratio="$$$$ratio" -v equal="$$$$equal" \
		'NR == 1 { for (i = 1; i <= NF; ++i) at[$$$$i] = i; next } \
		{ net = $$$$at["relmse_net"]; e[$$$$2] += net / R; e2[$$$$2] += net * net / R; \
		  t[$$$$2] += ($$$$at["relmse_trimmed"] - $$$$at["reference_noise"]) / R; c[$$$$2] += $$$$at["corr_right"] / R } \
		function var_mean(m) { return R > 1 && e2[m] > e[m] * e[m] ? (e2[m] / (e[m] * e[m]) - 1) / (R - 1) : 0 } \
		END { print "scene", "pt_s", "trace_s", "cluster_s", "refine_s", "gather_s", "merge_s", "direct_spp", "direct_s", "cost_ratio", "pt_1", "pathgraph_1", \
			"gain_1_trimmed", "pt_16", "pathgraph_16", "gain_16_trimmed", "equal_spp", "equal_gain", "equal_gain_se", "equal_gain_trimmed", "corr_right"; \
		print scene, (plain - load) / 4, (trace - load) / 16, cluster / 16, refine / 16, gather / 16, merge / 16, n, (direct - load) / 16 * n / 16, ratio, e["pt-1"], \
			e["pathgraph-1"], t["pt-1"] / t["pathgraph-1"], e["pt-16"], e["pathgraph-16"], t["pt-16"] / t["pathgraph-16"], equal, \
			e["pt-equal"] / e["pathgraph-16"], \
			e["pt-equal"] / e["pathgraph-16"] * sqrt(var_mean("pt-equal") + var_mean("pathgraph-16")), t["pt-equal"] / t["pathgraph-16"], c["pathgraph-16"] }' $$(@D)/errors.tsv >$$@
endef
$(foreach s,$(SCENES),$(eval $(call row,$(s))))

$(OUT)/table.tsv: $(rows)
	@awk 'NR == 1 || FNR > 1' $^ >$@

table: $(OUT)/table.tsv
	@awk -F'\t' 'NR == 1 { n = split($$0, head); for (i = 1; i <= n; ++i) printf i == 1 ? "%-20s" : "%13s", head[i]; print ""; next } \
		{ printf "%-20s", $$1; for (i = 2; i <= n; ++i) printf "%13.4g", $$i; print ""; ++rows; \
		  for (i = 2; i <= n; ++i) { if ($$i > 0) logs[i] += log($$i); else bad[i] = 1 } } \
		END { printf "%-20s", "geometric mean"; for (i = 2; i <= n; ++i) if (bad[i]) printf "%13s", "-"; else printf "%13.4g", exp(logs[i] / rows); \
		      print "" }' $<
	@echo $<
