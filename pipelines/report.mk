# One page on methods and one scene: OUT/report.html, which needs no network and opens from disk.
#
#   all that chart.mk makes; then loom-report puts the images of the most samples, the charts and the tables
#   into a page, with the results of `make peers` in OUT, if there are any.
#
# With FRAMES the page of an animation, with all that animation.mk makes.
## make report SCENE=scenes/cornell-box.xml METHODS="pt west pathgraph"
## make report SCENE=scenes/animated/ball.xml FRAMES=scenes/animated/ball.tsv

.PHONY: report
include pipelines/variables.mk

ifneq ($(FRAMES),)
report:
	@$(MAKE) --no-print-directory -f pipelines/animation.mk report
else

# LONGEST_SIDE=  ## longest side of the images in the page, px; larger ones are reduced (512)
METHODS ?= pt west pathgraph
export METHODS

include pipelines/chart.mk
.DEFAULT_GOAL := report

page := $(BUILD)/bin/loom-report
LONGEST_SIDE ?= 512
shown = $(OUT)/$(1)-$(lastword $(SPPS))-0/image.exr
again = make report SCENE=$(call typed,$(SCENE)) METHODS=$(call typed,$(METHODS)) SPPS=$(call typed,$(SPPS)) REPLICATES=$(REPLICATES)$(if \
	$(DEFINES), DEFINES=$(call typed,$(DEFINES)))$(if $(REFERENCE), REFERENCE=$(call typed,$(REFERENCE)))

$(eval $(call parameter,$(OUT)/report.parameters,$(LONGEST_SIDE) $(again)))
$(OUT)/report.html: $(foreach m,$(METHODS),$(call shown,$(m))) $(reference_made) $(OUT)/errors.tsv \
		$(OUT)/error-cost.svg $(charts) $(OUT)/report.parameters $(wildcard $(OUT)/peers.tsv) $(page)
	$(page) $(foreach m,$(METHODS),$(m)=$(call shown,$(m))) --reference $(reference) --errors $(OUT)/errors.tsv \
		--equal-cost $(OUT)/error-cost.equal-cost.tsv --equal-error $(OUT)/error-cost.equal-error.tsv \
		--chart $(OUT)/error-cost.svg $(charts) $(if $(wildcard $(OUT)/peers.tsv),--peers $(OUT)/peers.tsv) \
		--title $(call quote,$(name)) --made-by $(call quote,$(again)) --longest-side $(LONGEST_SIDE) -o $@

report: $(OUT)/report.html
	@rm -rf $(OUT)/.warm-up*
	@echo $<
endif
