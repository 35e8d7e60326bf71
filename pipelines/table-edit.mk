# Cost and error of residuals compared with correlated path tracing, a row per edit: OUT/table.tsv and .md.
#
#   Table 3a  1, 2, 4, 8, 16 movers                     scenes/movers.xml                                   [RP] Table 3
#   Table 3b  one mover, 40, 100, 160, 220 far          scenes/edits.xml
#   Table 2   white to blue, roughness, diffuse to metalscenes/edits.xml, glossy                            [RP] Table 2
#   stress    mover fills 60 % of the view; mover of a hundredth of the room; mover out of view, its shadow in view
#   scenes    an edit each of the shared scenes, where ../shared is; only what the edit changes is written, into
#             OUT/scenes; meshes and textures stay where they are
#
#   error     MSE of the new image, its old one being taken as converged: that of the residual against a reference.
#             The reference is the mean (a + b) / 2 of two residuals with their own seeds; its noise is taken out by
#             (x - a)(x - b) = (x - (a + b) / 2)^2 - (a - b)^2 / 4, whatever its samples say of themselves
#             The old image's weight is 1 (MASK=none): with another its noise would count
#   cost      CPU seconds of the whole chain of residual.exr, reading the scenes not counted; the old image is there, and with
#             GRAPH1 the old graph
#   ratio     error of correlated path tracing given the same time, over that of the method: correlated paths are
#             traced with each of SPPS, and between two of them their error follows a power of their cost (beyond the
#             first and last 1 / cost)
#
# Runs are timed one at a time, methods in turn (A B A B ...), as in chart.mk. What is made stays: a killed session goes
# on, more METHODS, ROWS or REPLICATES add to what there is.
#
#   make table-edit                                                   all rows
#   make table-edit ROWS="movers-1 blue" METHODS="dynamic graph+SPP4"
#   make table-edit DOCS=docs                                         and the tables into docs/edits.md
#   make edit-images                                                old, new and residual of each row, PNG
## make table-edit ROWS="movers-1 blue" METHODS="dynamic graph+SPP4"
## Also SEED and OUT (out/table-edit)

.DELETE_ON_ERROR:
.NOTPARALLEL:
.PHONY: table-edit edit-images
.DEFAULT_GOAL := table-edit
include pipelines/variables.mk

# ROWS=  ## edits to run, by name (all)
# METHODS=  ## methods, each a METHOD of make edit, with settings after +: graph+SPP4 (correlated auto)
# SPP=  ## pairs per pixel, if not set after + (32)
# SPPS=  ## pairs per pixel of correlated path tracing, for its error at equal time (8 32 128)
# REPLICATES=  ## residuals of each, with their own seeds (3)
# SIZE=  ## longer side of an image, px (128)
# BASE_SPP=  ## samples per pixel of the old image (256)
# REFERENCE_SPP=  ## pairs per pixel of each half of a reference (512)
# REFERENCE_METHOD=  ## method of the reference (correlated)
# IMAGE_SIZE=  ## make edit-images: longer side, px (320)
# IMAGE_SPP=  ## make edit-images: samples per pixel of the old image and pairs of the residual (64)
# DOCS=  ## folder whose edits.md receives the tables (none)
BUILD ?= build
METHODS ?= correlated auto
SPP ?= 32
SPPS ?= 8 32 128
REPLICATES ?= 3
SIZE ?= 128
BASE_SPP ?= 256
REFERENCE_SPP ?= 512
REFERENCE_METHOD ?= correlated
IMAGE_SIZE ?= $(or $(PICTURE_SIZE),320)
IMAGE_SPP ?= $(or $(PICTURE_SPP),64)
OUT ?= out/table-edit
shared := ../shared/scenes

include pipelines/words.mk
ifneq ($(shell printf '%s\n' $(METHODS) $(REFERENCE_METHOD) | grep -cvxE '[a-z]+([+][A-Z_]+[0-9]{1,8})*'),0)
$(error METHODS=$(METHODS): each must be a METHOD, with settings after +, such as SPP4)
endif

compare := $(BUILD)/bin/loom-compare
merge := $(BUILD)/bin/loom-merge
residual := $(BUILD)/bin/loom-residual

# table|row|times better in the paper|OLD|NEW|values of both|values of NEW; - for none, + between values
box := scenes/edits.xml
glossy := floor=tile+tall=metal
slide := x=-0.78+y=-0.8+z=0.45+size=0.2+turn=0
near := eye=0.32,0.42,0.92+target=0.32,0.1,-0.4+x=0.32+y=0.1+z=-0.35+size=0.25+turn=10
tiny := x=-0.3+y=-0.3+z=0.45+size=0.03+turn=0
unseen := eye=0,0.1,1.9+target=0,-0.7,-0.3+x=0.05+y=0.6+z=0.15+size=0.12
edits := \
	3a|movers-1|5.1|scenes/movers.xml|-|-|m1=1 \
	3a|movers-2|2.8|scenes/movers.xml|-|-|m1=1+m2=1 \
	3a|movers-4|1.4|scenes/movers.xml|-|-|m1=1+m2=1+m3=1+m4=1 \
	3a|movers-8|1.1|scenes/movers.xml|-|-|m1=1+m2=1+m3=1+m4=1+m5=1+m6=1+m7=1+m8=1 \
	3a|movers-16|-|scenes/movers.xml|-|-|m1=1+m2=1+m3=1+m4=1+m5=1+m6=1+m7=1+m8=1+m9=1+m10=1+m11=1+m12=1+m13=1+m14=1+m15=1+m16=1 \
	3b|across-40|4.4|$(box)|-|$(slide)|across=40 \
	3b|across-100|4.2|$(box)|-|$(slide)|across=100 \
	3b|across-160|5.2|$(box)|-|$(slide)|across=160 \
	3b|across-220|5.0|$(box)|-|$(slide)|across=220 \
	2|blue|8.5|$(box)|-|$(glossy)|short=blue \
	2|rougher|7.6|$(box)|-|$(glossy)+short=brushed|alpha=0.5 \
	2|metal|16.2|$(box)|-|$(glossy)|short=metal \
	stress|near|-|$(box)|-|$(near)|across=10 \
	stress|tiny|-|$(box)|-|$(tiny)|across=10 \
	stress|unseen|-|$(box)|-|$(unseen)|across=20 \
	scenes|cornell-box|-|$(shared)/cornell-box/scene_v3.xml|$(OUT)/scenes/cornell-box-new.xml|-|- \
	scenes|glossy-cornell|-|$(shared)/cornell-box/scene_glossy_v3.xml|$(OUT)/scenes/glossy-cornell-new.xml|-|- \
	scenes|staircase|-|$(shared)/staircase/scene_v3.xml|$(OUT)/scenes/staircase-new.xml|-|- \
	scenes|dining-room|-|$(shared)/dining-room/scene_v3.xml|$(OUT)/scenes/dining-room-new.xml|-|- \
	scenes|living-room-2|-|$(shared)/living-room-2/scene_v3.xml|$(OUT)/scenes/living-room-2-new.xml|-|- \
	scenes|sponza|-|$(OUT)/scenes/sponza-old.xml|$(OUT)/scenes/sponza-new.xml|-|-

# Where a shared scene lies, if not in a folder of its name.
folder.glossy-cornell := cornell-box
here = $(or $(filter-out scenes,$(call field,1,$(1))),$(wildcard $(shared)/$(or $(folder.$(1)),$(1))/scene_v3.xml))
needs := $(shared)
include pipelines/rows.mk

# What becomes of the shared scenes, by sed: objects are found by id, mesh or material, for most shapes have no id.
rewrite.cornell-box-new := $(call move,id="ShortBox",x="-0.15" z="0.1")
rewrite.glossy-cornell-new := $(rewrite.cornell-box-new)
rewrite.staircase-new := $(call move,<ref id="(WoodChair|ChairSeat)",x="-0.35" z="0.25")
rewrite.dining-room-new := $(call move,Mesh003[.]obj,x="1.2" z="0.6")
rewrite.living-room-2-new := $(call move,Mesh(167|091|145|160)[.]obj,x="0.35" z="0.3")
# Cubes that are not in the shared file, for nothing in sponza could be moved.
guest = <shape type="cube"><transform name="to_world"><scale value="$(1)"/><rotate y="1" angle="$(2)"/><translate $(3)/></transform><bsdf type="diffuse"><rgb name="reflectance" value="$(4)"/></bsdf></shape>
guests = s,</scene>,$(call guest,0.8,20,$(1),0.6 0.15 0.1)$(call guest,0.6,50,$(2),0.1 0.3 0.6)$(call guest,0.5,70,$(3),0.6 0.5 0.1)&,
rewrite.sponza-old := $(call guests,x="9" y="1" z="1.5",x="11" y="2.5" z="-1",x="8.5" y="4" z="-2.5")
rewrite.sponza-new := $(call guests,x="9.6" y="1" z="0.9",x="11.8" y="3.1" z="-1",x="9.3" y="3.4" z="-2")

# The scene with other objects in it, its files named from where it lies. Written anew only when it is another one.
source = $(shared)/$(or $(folder.$(1)),$(1))
written := $(sort $(foreach w,$(ROWS),$(filter $(OUT)/scenes/%,$(call field,4,$(w)) $(call field,5,$(w)))))
$(written): $(OUT)/scenes/%.xml: FORCE
	@mkdir -p $(@D)
	@sed -E '$(rewrite.$*); $(call elsewhere,$(call source,$(call edited,$*)),$(@D))' $(call original,$*) $(update)
edited = $(patsubst %-new,%,$(patsubst %-old,%,$(1)))
original = $(call source,$(call edited,$(1)))/$(if $(filter glossy%,$(1)),scene_glossy_v3.xml,scene_v3.xml)

# $(call size,ROW,LONGER SIDE): resx and resy, shaped as the scene has them.
file_of = $(if $(filter $(OUT)/scenes/%,$(call field,4,$(1))),$(call original,$(basename $(notdir $(call field,4,$(1))))),$(call field,4,$(1)))
size = $(call size_of,$(call file_of,$(1)),$(2))

# Names of runs, ROW/METHOD-PAIRS-REPLICATE, in the order in which they are made: methods turn fastest.
pairs = $(or $(patsubst SPP%,%,$(filter SPP%,$(subst +, ,$(1)))),$(SPP))
label = $(subst $(space),+,$(filter-out SPP%,$(subst +, ,$(1))))-$(pairs)
curve := $(SPPS:%=correlated-%)
labels := $(curve) $(filter-out $(curve),$(foreach m,$(METHODS),$(call label,$(m))))
runs_of = $(foreach r,$(shell seq 0 $$(($(REPLICATES) - 1))),$(foreach l,$(labels),$(1)/$(l)-$(r)))
reference_label := reference-$(REFERENCE_SPP)
references := $(foreach w,$(ROWS),$(w)/$(reference_label)-0 $(w)/$(reference_label)-1)
runs := $(foreach w,$(ROWS),$(call runs_of,$(w))) $(references)

# $(call part,N,RUN) of METHOD, PAIRS, REPLICATE.
part = $(word $(1),$(subst -, ,$(notdir $(2))))
row_of = $(patsubst %/,%,$(dir $(1)))
method_of = $(patsubst reference,$(REFERENCE_METHOD),$(call part,1,$(1)))
settings_of = $(shell echo '$(wordlist 2,99,$(subst +, ,$(method_of)))' | sed -E 's/([A-Z_]+)([0-9]+)/\1=\2/g')
# $(call seed,NAME): own and lasting, whatever else is made beside it.
seed = $(shell printf '%s' '$(1) $(SEED)' | cksum | cut -d' ' -f1)
# Edits of one scene share its image.
before = $(call field,4,$(1)) $(call field,6,$(1))
base = $(OUT)/base/$(shell printf '%s' '$(call before,$(1)) $(2)' | cksum | cut -d' ' -f1)
values = $(subst +, ,$(call field,$(1),$(2)))
# $(call edit,ROW,LONGER SIDE,METHOD,PAIRS,SEED,FOLDER,BASE_SPP,SETTINGS): all variables are named, none of this file's reaches it else.
edit = $(MAKE) -s --no-print-directory -f pipelines/edit.mk -j1 BUILD=$(BUILD) OLD='$(call field,4,$(1))' NEW='$(or $(call field,5,$(1)),$(call field,4,$(1)))' \
	DEFINES='$(call size,$(1),$(2))$(call values,6,$(1))' OLD_DEFINES= NEW_DEFINES='$(call values,7,$(1))' METHOD=$(3) SPP=$(4) SEED=$(5) \
	BASE=$(call base,$(1),$(2) $(7)) BASE_SPP=$(7) BASE_SEED=1 GRAPH_SEED=$(5) OUT=$(6) EXPOSURE= MASK=none $(8)
run = $(call edit,$(call row_of,$(1)),$(SIZE),$(firstword $(subst +, ,$(call method_of,$(1)))),$(call part,2,$(1)),$(call seed,$(1)),$(2),$(BASE_SPP),$(call settings_of,$(1)))

table-edit: $(OUT)/table.md
	@rm -rf $(OUT)/.warm-up*
ifneq ($(strip $(DOCS)),)
	@mkdir -p $(DOCS) && touch $(DOCS)/edits.md && awk -v tables=$(OUT)/table.md -f pipelines/insert-tables.awk $(DOCS)/edits.md >$(OUT)/page.md && cp $(OUT)/page.md $(DOCS)/edits.md
endif
	@cat $(OUT)/table.md
	@echo $(OUT)/table.tsv

# edit.mk knows whether there is something to do; an image that it leaves alone keeps its time stamp. The first run of
# a session is preceded by one of each method that does not count.
session := $(shell echo $$PPID)
sums := $(runs:%=$(OUT)/%/new.exr)
$(sums): $(OUT)/%/new.exr: $(written) FORCE
	@$(call run,$*,$(@D)) -q $@ || { \
		$(MAKE) -s --no-print-directory -f pipelines/table-edit.mk OUT=$(OUT) ROWS='$(ROWS)' $(OUT)/.warm-up-$(session) && \
		echo '$*' >&2 && $(call run,$*,$(@D)) $@ >/dev/null; }

warm = $(call run,$(firstword $(ROWS))/$(1)-0,$(OUT)/.warm-up/$(1))
$(OUT)/.warm-up-%:
	@$(foreach l,$(firstword $(labels)) $(filter-out $(curve),$(labels)),$(call warm,$(l)) $(OUT)/.warm-up/$(l)/new.exr >/dev/null &&) rm -rf $(OUT)/.warm-up
	@touch $@

$(eval $(call parameter,$(OUT)/table.parameters,$(labels) $(REPLICATES) $(REFERENCE_SPP)))
labelled = $(foreach r,$(call runs_of,$(1)),$(call part,1,$(r))-$(call part,2,$(r))=$(OUT)/$(r)/$(2).exr)
half = $(OUT)/$(1)/$(reference_label)-$(2)/new.exr
define row
$(OUT)/$(1)/reference.exr: $(call half,$(1),0) $(call half,$(1),1) $(merge) $(residual)
	@$(merge) --quiet $(foreach h,0 1,$(dir $(call half,$(1),$(h)))residual.exr) -o $$(@D)/reference-residual.exr
	@$(residual) --quiet $(call field,4,$(1)) $(call field,5,$(1)) $(addprefix -D ,$(call size,$(1),$(SIZE)) $(call values,6,$(1))) \
		$(addprefix --new-define ,$(call values,7,$(1))) --old $(call base,$(1),$(SIZE) $(BASE_SPP))/old.exr --residual $$(@D)/reference-residual.exr --new $$@

$(OUT)/$(1)/row.tsv: $(patsubst %,$(OUT)/%/new.exr,$(call runs_of,$(1))) $(OUT)/$(1)/reference.exr $(OUT)/table.parameters $(compare) pipelines/table-edit.awk
	@$(compare) --quiet --tsv --reference $(OUT)/$(1)/reference.exr $(call labelled,$(1),new) >$$(@D)/errors.tsv
	@$(compare) --quiet --tsv reference=$(call half,$(1),0) --reference $(call half,$(1),1) >$$(@D)/noise.tsv
	@$(compare) --quiet --tsv --cost $(call labelled,$(1),residual) >$$(@D)/costs.tsv
	@printf 'file\tcpu_s\tload_s\n' >$$(@D)/own.tsv
	@$(foreach r,$(filter %,$(foreach r,$(call runs_of,$(1)),$(if $(findstring GRAPH,$(r)),$(r)))), \
		for cost in $(OUT)/$(r)/residual.exr.cost.json $$$$(ls $(OUT)/$(r)/noisy.exr.cost.json 2>/dev/null); do \
		printf '%s\t%s\t%s\n' $(OUT)/$(r)/residual.exr $$$$(sed -n 's/.*"cpu_s": *\([^,]*\),.*/\1/p; s/.*"load_s": *\([^,]*\),.*/\1/p' $$$$cost) >>$$(@D)/own.tsv; done;) :
	@awk -v table='$(call field,1,$(1))' -v row='$(1)' -v paper='$(or $(call field,3,$(1)),nan)' -v curve='$(curve)' \
		-f pipelines/table-edit.awk $$(@D)/noise.tsv $$(@D)/costs.tsv $$(@D)/own.tsv $$(@D)/errors.tsv >$$@
endef
$(foreach w,$(ROWS),$(eval $(call row,$(w))))

$(eval $(call parameter,$(OUT)/rows.parameters,$(ROWS)))
$(OUT)/table.tsv: $(ROWS:%=$(OUT)/%/row.tsv) $(OUT)/rows.parameters
	@awk 'NR == 1 || FNR > 1' $(filter %.tsv,$^) >$@

$(OUT)/table.md: $(OUT)/table.tsv pipelines/table-edit-page.awk
	@awk -v made="$(REPLICATES) residuals of each, longer side $(SIZE) px, references of 2 x $(REFERENCE_SPP) pairs ($(REFERENCE_METHOD))" \
		-f pipelines/table-edit-page.awk $< >$@

# Images to look at, by correlated paths.
shown_images := $(foreach w,$(ROWS),$(foreach p,old new residual,$(OUT)/images/$(w)-$(p).png))
edit-images: $(shown_images)
	@for p in $(shown_images); do echo $$p; done
image = $(call edit,$(1),$(IMAGE_SIZE),correlated,$(IMAGE_SPP),1,$(OUT)/images/$(1),$(IMAGE_SPP),)
image_base = $(call base,$(1),$(IMAGE_SIZE) $(IMAGE_SPP))
$(ROWS:%=$(OUT)/images/%/new.exr): $(OUT)/images/%/new.exr: $(written) FORCE
	@$(call image,$*) $@ >/dev/null
define shown
$(OUT)/images/$(1)-old.png: $(OUT)/images/$(1)/new.exr $(inspect)
	@$(inspect) --quiet $(call image_base,$(1))/old.exr --png $$@
$(OUT)/images/$(1)-new.png: $(OUT)/images/$(1)/new.exr $(inspect)
	@$(inspect) --quiet $$< --png $$@
$(OUT)/images/$(1)-residual.png: $(OUT)/images/$(1)/new.exr
	@cp $$(<D)/residual.png $$@
endef
$(foreach w,$(ROWS),$(eval $(call shown,$(w))))
