# Cost of a residual from a graph of the old scene (loom-residual --old-graph) against the share of paths that the edit
# touches: OUT/runs.tsv, two rows per edit, OUT/cost.md and OUT/cost.svg, PNG beside it.
#
#   for each edit the graph's residual and the full correlated one, in turn (A B A B ...), REPLICATES times; of each the least
#   CPU seconds, reading the scenes not counted, but reading the graph is
#   touched  part of the pairs of paths that are traced again;  ratio  CPU time over that of the full residual
#
# The edits go from specks to half of a room: scenes/edits.xml, and where ../shared is, living-room-2; what changes there is
# written into OUT/scenes.
## make chart-edit-cost ROWS="movers-1 movers-16"
## Also OUT (out/chart-edit-cost)

.DELETE_ON_ERROR:
.NOTPARALLEL:
.PHONY: chart-edit-cost
.DEFAULT_GOAL := chart-edit-cost
include pipelines/variables.mk

# SPP=  ## samples per pixel of the graphs (16)
# SIZE=  ## longer side of the images, px (256)
# REPLICATES=  ## runs of each, of which the fastest counts (3)
# ROWS=  ## edits to run (all)
# DOCS=  ## folder whose edits.md receives the table (none)
BUILD ?= build
SPP ?= 16
SIZE ?= 256
REPLICATES ?= 3
OUT ?= out/chart-edit-cost
include pipelines/words.mk
trace := $(BUILD)/bin/loom-trace
residual := $(BUILD)/bin/loom-residual
chart := $(BUILD)/bin/loom-chart

# scene|row|values of both|values of NEW, + between them; of a shared scene the sed that makes NEW of it is in `rewrite`.
speck := x=0.3+y=-0.97+z=0.7+size=0.03
edits := \
	box|speck|$(speck)|across=10 \
	box|pebble|x=0.3+y=-0.9+z=0.6+size=0.1|across=10 \
	box|box|-|across=10 \
	box|turned|-|turn=20 \
	box|blue|-|tall=blue \
	box|floor|-|floor=blue \
	box|half|-|floor=blue+tall=blue+short=blue \
	living-room-2|apples|-|- \
	living-room-2|cup|-|- \
	living-room-2|carpet|-|- \
	living-room-2|armchair|-|- \
	living-room-2|armchairs|-|-
shared := $(wildcard ../shared/scenes/living-room-2/scene_v3.xml)
here = $(or $(shared),$(filter box,$(call field,1,$(1))))
needs := ../shared/scenes/living-room-2
include pipelines/rows.mk

# Shapes by their mesh, for they have no id.
move_mesh = $(call move,models\/Mesh($(1))[.]obj,$(2))
rewrite.apples := $(call move_mesh,076|108|080|166,x="0.03" z="-0.02")
rewrite.cup := $(call move_mesh,003|004|061,x="-0.15" z="-0.1")
rewrite.carpet := $(call move_mesh,008,x="0.2")
rewrite.armchair := $(call move_mesh,167|091|145|160,x="0.35" z="0.3")
rewrite.armchairs := $(call move_mesh,167|091|145|160|010|082|086,x="0.2" z="0.2")
$(OUT)/scenes/living-room-2-%.xml: FORCE
	@mkdir -p $(@D)
	@sed -E '$(rewrite.$*); $(call elsewhere,$(dir $(shared)),$(@D))' $(shared) $(update)

file.box := scenes/edits.xml
file.living-room-2 := $(OUT)/scenes/living-room-2-old.xml
size.box := resx=$(SIZE) resy=$(SIZE)
size.living-room-2 := resx=$(SIZE) resy=$(shell echo $$(($(SIZE) * 9 / 16)))
old = $(file.$(call field,1,$(1)))
new = $(if $(rewrite.$(1)),$(OUT)/scenes/living-room-2-$(1).xml,$(call old,$(1)))
words_of = $(patsubst %,$(2) '%',$(subst +, ,$(1)))
both = $(call words_of,$(size.$(call field,1,$(1))) $(call field,3,$(1)),-D)
# Edits of one scene share its graph.
graph = $(OUT)/graph/$(shell printf '%s' '$(call old,$(1)) $(call both,$(1)) $(SPP)' | cksum | cut -d' ' -f1).h5
# $(call old_stamp,ROW), $(call new_stamp,ROW): what the scenes are; one that is written here is looked at again once it is.
old_stamp = $(patsubst %.h5,%.stamp,$(call graph,$(1)))
new_stamp = $(OUT)/$(1).stamp
define scene_stamp
$(2): $(filter $(OUT)/%,$(3))
$(call stamp,$(2),--scene $(3) $(call both,$(1)) $(4))
endef
define graph_rule
$(call scene_stamp,$(1),$(call old_stamp,$(1)),$(call old,$(1)))
$(call graph,$(1)): $(call old_stamp,$(1)) $(trace)
	@mkdir -p $$(@D)
	$(trace) --quiet $(call old,$(1)) $(call both,$(1)) --spp $(SPP) --seed 1 --misses -o $$@
endef
$(foreach g,$(sort $(foreach w,$(ROWS),$(call graph,$(w)))),$(eval $(call graph_rule,$(firstword $(foreach w,$(ROWS),$(if $(filter $(g),$(call graph,$(w))),$(w)))))))

# $(call run,ROW,OPTIONS): CPU seconds, pairs, rays of one residual.
run = $(residual) --quiet $(call old,$(1)) $(call new,$(1)) $(call both,$(1)) $(call words_of,$(call field,4,$(1)),--new-define) $(2) -o $(OUT)/run.exr && \
	awk -F'[:,]' '/"cpu_s"/ { c = $$$$2 } /"load_s"/ { l = $$$$2 } /"samples"/ { s = $$$$2 } /"rays"/ { r = $$$$2 } END { print "$(1)", "$(3)", c - l, s, r }' $(OUT)/run.exr.cost.json
define row
$(call scene_stamp,$(1),$(call new_stamp,$(1)),$(call new,$(1)),$(call words_of,$(call field,4,$(1)),-D))
$(OUT)/$(1).runs: $(call old_stamp,$(1)) $(call new_stamp,$(1)) $(call graph,$(1)) $(residual) $(OUT)/cost.parameters
	@echo $(1) >&2
	@for i in $$$$(seq $(REPLICATES)); do $(call run,$(1),--method correlated --spp $(SPP),full) && $(call run,$(1),--old-graph $(call graph,$(1)),graph) || exit 1; done >$$@
endef
$(eval $(call parameter,$(OUT)/cost.parameters,$(SPP) $(SIZE) $(REPLICATES)))
$(foreach w,$(ROWS),$(eval $(call row,$(w))))

chart-edit-cost: $(OUT)/cost.svg $(OUT)/cost.md
ifneq ($(strip $(DOCS)),)
	@awk -v tables=$(OUT)/cost.md -v name=cost -f pipelines/insert-tables.awk $(DOCS)/edits.md >$(OUT)/page.md && cp $(OUT)/page.md $(DOCS)/edits.md
endif
	@cat $(OUT)/cost.md
	@echo $(OUT)/cost.png

$(eval $(call parameter,$(OUT)/rows.parameters,$(ROWS)))
$(OUT)/runs.tsv: $(ROWS:%=$(OUT)/%.runs) $(OUT)/rows.parameters
	@awk -v OFS='\t' -v scenes='$(foreach w,$(ROWS),$(w)=$(call field,1,$(w)))' \
		'function least(a, b) { return a == "" || b < a ? b : a } \
		BEGIN { n = split(scenes, list, " "); for (i = 1; i <= n; ++i) { split(list[i], p, "="); scene[p[1]] = p[2] } \
			print "scene", "edit", "method", "touched", "rays", "full_s", "graph_s", "ratio" } \
		{ if (!($$1 in seen)) { seen[$$1]; order[++rows] = $$1 } \
		  cpu[$$1, $$2] = least(cpu[$$1, $$2], $$3); pairs[$$1, $$2] = $$4; rays[$$1, $$2] = $$5 } \
		END { for (i = 1; i <= rows; ++i) { r = order[i]; f = r SUBSEP "full"; g = r SUBSEP "graph"; touched = pairs[g] / pairs[f]; \
			print scene[r], r, "old graph", touched, rays[g] / rays[f], cpu[f], cpu[g], cpu[g] / cpu[f]; \
			print scene[r], r, "touched", touched, rays[g] / rays[f], cpu[f], cpu[g], touched } }' $(filter %.runs,$^) >$@

$(OUT)/cost.svg: $(OUT)/runs.tsv $(chart)
	@$(chart) --quiet $< -o $@ --x touched --y ratio --no-front >/dev/null

$(OUT)/cost.md: $(OUT)/runs.tsv
	@awk -F'\t' 'NR == 1 { print "$(SPP) samples per pixel, longer side $(SIZE) px, the fastest of $(REPLICATES) runs in turn, scenes not counted.\n"; \
			print "| scene | edit | paths touched | rays | full, CPU s | from the graph | of it |\n|---|---|--:|--:|--:|--:|--:|" } \
		$$3 == "old graph" { printf "| %s | %s | %.3g %% | %.3g %% | %.3g | %.3g | %.3g %% |\n", $$1, $$2, 100 * $$4, 100 * $$5, $$6, $$7, 100 * $$8 }' $< >$@
