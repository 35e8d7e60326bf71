# Charts of path tracing, West et al. and path graphs on many scenes at small size: OUT/NAME/ as chart.mk leaves it,
# one after the other, and OUT/all.svg, error against cost of all of them, a panel per scene.
#
# References are REFERENCES/NAME_ref.exr where they are, else path traced. Small images drown in the time that reading
# a scene takes, so the cost is CPU time without it. What is made stays; a killed session goes on.
#
#   make chart-all                 everything
#   make chart-all DOCS=docs       and copies of the charts into docs/charts, for docs/charts.md
## make chart-all OUT=out/chart-all DOCS=docs
## Also METHODS, SPPS, REPLICATES, COST, ERROR as for make chart, and OUT (out/chart-all)

.DELETE_ON_ERROR:
.NOTPARALLEL:
.PHONY: chart-all
.DEFAULT_GOAL := chart-all
include pipelines/variables.mk

# SCENES=  ## scene files (the shared ones if present, else some of scenes/)
# REFERENCES=  ## folder of NAME_ref.exr and NAME_var.exr
# SIZE=  ## longer side of an image without such a reference, px (128)
# DOCS=  ## folder whose charts/ receives copies of the charts (none)
# METHODS SPPS REPLICATES COST ERROR: as of chart (pt west pathgraph; 1 4 16; 3; render_s; relmse)
BUILD ?= build
shared := $(sort $(wildcard $(foreach s,scene_v3 scene_glossy_v3 scene_area_v3,../shared/scenes/*/$(s).xml)))
own := $(addprefix scenes/,cornell-box.xml glossy-box.xml caustic.xml textured.xml)
SCENES ?= $(or $(shared),$(wildcard $(own)))
REFERENCES ?= ../shared/oracles/scenes
METHODS ?= pt west pathgraph
SPPS ?= 1 4 16
REPLICATES ?= 3
COST ?= render_s
ERROR ?= relmse
SIZE ?= 128
OUT ?= out/chart-all
include pipelines/words.mk

chart := $(BUILD)/bin/loom-chart
names := $(foreach s,$(SCENES),$(call row_name,$(s)))

# A scene by chart.mk, which knows what there is to do. All variables are named: none of this file's reaches it else.
define one
.PHONY: $(call row_name,$(1))
$(call row_name,$(1)):
	@echo '$(call row_name,$(1))' >&2
	@set -e; ref='$(REFERENCES)/$(call row_name,$(1))_ref.exr'; var='$(REFERENCES)/$(call row_name,$(1))_var.exr'; \
	if [ -f "$$$$ref" ]; then \
		size=$$$$($(inspect) --quiet --json "$$$$ref" | tr -d ' \n' | \
			sed -E 's/.*"dataWindow":"x0to([0-9]+),y0to([0-9]+)".*/\1 \2/' | awk '{ print "resx=" $$$$1 + 1, "resy=" $$$$2 + 1 }'); \
		[ -f "$$$$var" ] || var=; \
	else size='resx=$(SIZE) resy=$(SIZE)'; ref=; var=; fi; \
	$(MAKE) -s --no-print-directory -f pipelines/chart.mk BUILD=$(BUILD) SCENE='$(1)' NAME='$(call row_name,$(1))' OUT=$(OUT)/$(call row_name,$(1)) \
		METHODS='$(METHODS)' SPPS='$(SPPS)' REPLICATES=$(REPLICATES) COST=$(COST) ERROR=$(ERROR) \
		REFERENCE="$$$$ref" REFERENCE_VARIANCE="$$$$var" DEFINES="$$$$size" chart
endef
$(foreach s,$(SCENES),$(eval $(call one,$(s))))

# Only tables that have changed make the image of all of them anew.
tables := $(names:%=$(OUT)/%/errors.tsv)
$(tables): $(OUT)/%/errors.tsv: % ;
$(OUT)/all.svg: $(tables) $(chart)
	$(chart) $(tables) -o $@ --x $(COST) --y $(ERROR) >$(OUT)/all.txt

chart-all: $(OUT)/all.svg
	@cat $(OUT)/all.txt
ifneq ($(strip $(DOCS)),)
	@mkdir -p $(DOCS)/charts
	@cp $(OUT)/all.svg $(DOCS)/charts/all.svg
	@$(foreach n,$(names),for c in error-cost bias-variance stages convergence; do \
		! [ -e $(OUT)/$(n)/$$c.svg ] || cp $(OUT)/$(n)/$$c.svg $(DOCS)/charts/$(n)-$$c.svg; done;)
endif
	@echo $(OUT)/all.png
