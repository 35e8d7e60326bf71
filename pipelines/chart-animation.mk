# Error, cost and flicker of animations as a static image plus what moves, against path tracing of each frame, a row per animation:
# OUT/table.tsv and .md; error.svg, flicker.svg, gain.svg (by the number of frames), spectrum.svg (of the errors in time); strips of each in
# OUT/ROW/METHOD-SPP/strip.png and strip-denoised.png.
#
#   error     of a frame against one of REFERENCE_SPP samples, whose own noise is taken off; mean over COUNT frames
#   cost      CPU seconds of a frame, reading the scene not counted: of the frame alone, its static image (BASE_SPP samples) and
#             graphs being there; and with its share of theirs, for these frames, for 24 and for 240
#   times     of unbiased frames: error times cost of path tracing over that of the method, at the same number of samples; of
#             denoised ones, whose error falls otherwise: error over that of denoised path tracing of equal cost, by a power law
#             between the nearest two of PT_SPPS, beyond the last as 1 / cost at most
#   flicker   of loom-compare --sequence, and how much of the noise stands still where the scene does
#
# pt: path tracing of each frame; hybrid, auto: a static image of BASE_SPP samples, or as a pilot plans it; -d: denoised; given: hybrid
# with a static image of GIVEN_SPP samples, whose noise counts for little; single: hybrid with one graph for all frames in place of two;
# cache, grid: where the camera moves, a radiance cache of points, or a grid, in place of the static image.
#
#   make chart-animation                                    all rows
#   make chart-animation ROWS="ball cornell-lamp" SPPS=8
#   make chart-animation DOCS=docs                          and the tables into docs/animation.md
## make chart-animation ROWS="ball teapot-sky" SPPS="2 8"
## Also SEED and OUT (out/chart-animation)

.DELETE_ON_ERROR:
.NOTPARALLEL:
.PHONY: chart-animation
.DEFAULT_GOAL := chart-animation
include pipelines/variables.mk

# ROWS=  ## animations to run, by name (all)
# SPPS=  ## samples per pixel of the graphs, and of path tracing (8 32)
# PT_SPPS=  ## samples of path tracing (2 and SPPS)
# COUNT=  ## number of frames (8)
# SIZE=  ## longer side of a frame, px (128)
# BASE_SPP=  ## samples per pixel of the static image (1024)
# GIVEN_SPP=  ## samples per pixel of a static image that counts as given, where shapes move (4096)
# REFERENCE_SPP=  ## samples per pixel of the references (1024)
# DOCS=  ## folder whose animation.md receives the tables (none)
BUILD ?= build
SPPS ?= 8 32
COUNT ?= 8
SIZE ?= 128
BASE_SPP ?= 1024
GIVEN_SPP ?= 4096
REFERENCE_SPP ?= 1024
PT_SPPS ?= 2 $(filter-out 2,$(SPPS))
OUT ?= out/chart-animation
OUT := $(OUT)
shared := ../shared/scenes
include pipelines/words.mk
compare := $(BUILD)/bin/loom-compare
chart := $(BUILD)/bin/loom-chart

# kind|row|scene
edits := \
	shape|ball|scenes/animated/ball.xml \
	shape|cornell-ball|$(shared)/cornell-box/scene_v3.xml \
	shape|living-ball|$(shared)/living-room-2/scene_v3.xml \
	shape|staircase-ball|$(shared)/staircase/scene_v3.xml \
	light|cornell-lamp|$(shared)/cornell-box/scene_v3.xml \
	light|cornell-glow|$(shared)/cornell-box/scene_v3.xml \
	light|cornell-dimmed|$(shared)/cornell-box/scene_v3.xml \
	light|teapot-sky|$(shared)/teapot/scene_v3.xml \
	light|teapot-spin|$(shared)/teapot/scene_v3.xml \
	walk|cornell-walk|$(shared)/cornell-box/scene_v3.xml \
	walk|living-walk|$(shared)/living-room-2/scene_v3.xml \
	walk|staircase-walk|$(shared)/staircase/scene_v3.xml
here = $(wildcard $(call field,3,$(1)))
needs := $(shared)
include pipelines/rows.mk

# What becomes of the scenes, by sed.
default = s,<scene version="3.0.0">,&<default name="$(1)" value="$(2)"/>,
added = s,</scene>,$(1)&,
sphere = <shape type="sphere"><float name="radius" value="$(1)"/><transform name="to_world"><translate $(2)/></transform>$(3)</shape>
here_xyz := x="$$bx" y="$$by" z="$$bz"
diffuse = <bsdf type="diffuse"><rgb name="reflectance" value="$(1)"/></bsdf>
glossy := <bsdf type="roughplastic"><string name="distribution" value="ggx"/><float name="alpha" value="0.1"/><rgb name="diffuse_reflectance" value="0.6 0.1 0.08"/></bsdf>
ball = $(call default,bx,0);$(call default,by,9);$(call default,bz,0);$(call added,$(1))
rewrite.ball := s,x,x,
rewrite.cornell-ball := $(call ball,$(call sphere,0.22,$(here_xyz),$(call diffuse,0.7 0.5 0.2)))
rewrite.living-ball := $(call ball,$(call sphere,0.22,$(here_xyz),$(glossy)))
rewrite.staircase-ball := $(call ball,$(call sphere,0.2,$(here_xyz),$(call diffuse,0.15 0.3 0.65)))
rewrite.cornell-lamp := $(call default,place,0);$(call move,id="Light",x="$$place")
rewrite.cornell-glow := $(call default,place,0);$(call added,$(call sphere,0.06,x="$$place" y="1.3" z="0.5",$(call diffuse,0)<emitter type="area"><rgb name="radiance" value="20 25 30"/></emitter>))
rewrite.cornell-dimmed := $(call default,light,17);s/(name="radiance" value=")17, 12, 4"/\1$$light"/
rewrite.teapot-sky := $(call default,turn,0);/<emitter type="envmap"/$(comma)/<\/emitter>/s,</transform>,<rotate y="1" angle="$$turn"/>&,
rewrite.teapot-spin := $(rewrite.teapot-sky)
# The camera walks: two numbers of its matrix are parameters.
walked := $(call default,cx,0);$(call default,cz,0);/<sensor/$(comma)/<\/sensor>/s,<matrix value="(([^ ]+ ){3})[^ ]+ (([^ ]+ ){7})[^ ]+,<matrix value="\1$$cx \3$$cz,
rewrite.cornell-walk := $(rewrite.cornell-ball);$(walked)
rewrite.living-walk := $(rewrite.living-ball);$(walked)
rewrite.staircase-walk := $(rewrite.staircase-ball);$(walked)

scenes := $(ROWS:%=$(OUT)/%/scene.xml)
tables := $(ROWS:%=$(OUT)/%/frames.tsv)
$(scenes): $(OUT)/%/scene.xml: FORCE
	@mkdir -p $(@D)
	@sed -E $(call quote,$(rewrite.$*); $(call elsewhere,$(dir $(call field,3,$*)),$(@D))) $(call field,3,$*) $(update)
$(tables): $(OUT)/%/frames.tsv: FORCE
	@mkdir -p $(@D)
	@awk -v row=$* -v n=$(COUNT) -f pipelines/chart-animation.awk $(update)

# $(call animation,ROW,SETTINGS)
animation = $(MAKE) --no-print-directory -f pipelines/animation.mk BUILD=$(BUILD) SCENE=$(OUT)/$(1)/scene.xml FRAMES=$(OUT)/$(1)/frames.tsv \
	DEFINES=$(call quote,$(call size_of,$(call field,3,$(1)),$(SIZE))) OUT=$(@D) $(2) >/dev/null
# Runs of a row, METHOD-SPP: auto has its own static image, whose samples a pilot chooses.
# Where the camera moves there is a cache in its place.
runs_of = $(PT_SPPS:%=pt-%) $(if $(filter walk,$(call field,1,$(1))),$(foreach s,$(SPPS),cache-$(s) grid-$(s)),\
	$(foreach s,$(SPPS),hybrid-$(s) $(if $(filter shape,$(call field,1,$(1))),given-$(s)) auto-$(s)) single-$(firstword $(SPPS)))
marks_of = $(foreach r,$(call runs_of,$(1)),$(OUT)/$(1)/$(r)/strip-denoised.png)
marks := $(foreach w,$(ROWS),$(call marks_of,$(w)))
part = $(word $(1),$(subst -, ,$(notdir $(2))))
row_of = $(patsubst %/,%,$(dir $(1)))
settings.pt := METHOD=pt
settings.hybrid := METHOD=hybrid BASE_SPP=$(BASE_SPP)
settings.given := METHOD=hybrid BASE_SPP=$(GIVEN_SPP)
settings.single := METHOD=hybrid BASE_SPP=$(BASE_SPP) GRAPHS=1
settings.auto := METHOD=hybrid BASE_SPP=auto
settings.cache := CACHE=points CACHE_VIEWS=4 CACHE_SPP=16
settings.grid := CACHE=grid CACHE_VIEWS=4 CACHE_SPP=16
settings_of = $(settings.$(call part,1,$(1))) SPP=$(call part,2,$(1)) $(if $(SEED),SEED=$(SEED))
.SECONDEXPANSION:
$(marks): $(OUT)/%/strip-denoised.png: $(OUT)/$$(call row_of,$$*)/scene.xml $(OUT)/$$(call row_of,$$*)/frames.tsv FORCE
	@$(call animation,$(call row_of,$*),$(call settings_of,$*) DENOISE=1)
	@mv $(@D)/strip.png $@
	@$(call animation,$(call row_of,$*),$(call settings_of,$*))
# The variance of independent samples is what they say, that of Sobol points is less.
references := $(ROWS:%=$(OUT)/%/reference/strip.png)
$(references): $(OUT)/%/reference/strip.png: $(OUT)/%/scene.xml $(OUT)/%/frames.tsv FORCE
	@$(call animation,$*,METHOD=pt SPP=$(REFERENCE_SPP) SEED=77 TRACE=$(call quote,--sampler independent))

# Lines of the table for each row: errors by frame, costs by frame, flicker; gains by the number of frames; spectra.
frames := $(shell seq -f %04g 0 $$(($(COUNT) - 1)))
# $(call inputs,ROW,NUMBER): LABEL=FILE of all runs, their frames as they are and denoised. pt-8 is pt-d-8 when it is denoised.
inputs = $(foreach l,$(call runs_of,$(1)),$(l)=$(l)/images/frame-$(2).exr $(subst -,-d-,$(l))=$(l)/denoised/frame-$(2).exr)
$(eval $(call parameter,$(OUT)/table.parameters,$(ROWS) $(SPPS) $(PT_SPPS) $(COUNT) $(SIZE) $(BASE_SPP) $(GIVEN_SPP) $(REFERENCE_SPP)))
measured := $(ROWS:%=$(OUT)/%/measured.tsv)
$(measured): $(OUT)/%/measured.tsv: $(OUT)/%/reference/strip.png $$(call marks_of,$$*) $(OUT)/table.parameters $(compare) pipelines/chart-animation-row.awk
	@cd $(@D) && { $(foreach n,$(frames),$(abspath $(compare)) --quiet --tsv $(call inputs,$*,$(n)) -r reference/images/frame-$(n).exr;) \
		$(abspath $(compare)) --quiet --by-frame $(foreach n,$(frames),$(call inputs,$*,$(n))); \
		$(abspath $(compare)) --quiet --sequence --tsv $(call inputs,$*,%) -r reference/images/frame-%.exr; \
		$(abspath $(compare)) --quiet --spectrum $(call inputs,$*,%) -r reference/images/frame-%.exr; } \
		| awk -v row=$* -v kind=$(call field,1,$*) -v gains=gains.tsv -v spectra=spectra.tsv -f $(abspath pipelines/chart-animation-row.awk) >$(@F)
# $(call joined,FILE): FILE of all rows as one table.
joined = awk 'FNR > 1 || NR == 1' $(ROWS:%=$(OUT)/%/$(1)) >$@
$(OUT)/table.tsv: $(measured)
	@$(call joined,measured.tsv)
$(OUT)/gains.tsv: $(measured)
	@$(call joined,gains.tsv)
$(OUT)/spectra.tsv: $(measured)
	@$(call joined,spectra.tsv)
$(OUT)/table.md: $(OUT)/table.tsv pipelines/chart-animation-page.awk
	@awk -f pipelines/chart-animation-page.awk $< >$@
# Errors below the noise of the references have no place on a log axis.
$(OUT)/chart.tsv: $(OUT)/table.tsv
	@awk -F '\t' 'NR == 1 { for (i = 1; i <= NF; ++i) at[$$i] = i } NR == 1 || ($$at["method"] !~ /^single/ && $$at["relmse"] > 0 && $$at["flicker"] > 0 && $$at["frame_s"] > 0)' $< >$@
$(OUT)/error.svg: $(OUT)/chart.tsv $(chart)
	@$(chart) --quiet $< -o $@ --x frame_s --y relmse >$(@:.svg=.txt)
$(OUT)/flicker.svg: $(OUT)/chart.tsv $(chart)
	@$(chart) --quiet $< -o $@ --x frame_s --y flicker >$(@:.svg=.txt)
$(OUT)/gain.svg: $(OUT)/gains.tsv $(chart)
	@$(chart) --quiet $< -o $@ --x frames --y gain --no-front >$(@:.svg=.txt)
$(OUT)/spectrum.svg: $(OUT)/spectra.tsv $(chart)
	@$(chart) --quiet $< -o $@ --kind spectrum

charts := $(patsubst %,$(OUT)/%.svg,error flicker gain spectrum)
chart-animation: $(OUT)/table.md $(charts) $(references)
ifneq ($(DOCS),)
	@awk -v tables=$(OUT)/table.md -f pipelines/insert-tables.awk $(DOCS)/animation.md >$(OUT)/page.md && cp $(OUT)/page.md $(DOCS)/animation.md
	@mkdir -p $(DOCS)/animation && cp $(charts) $(DOCS)/animation/
endif
	@cat $(OUT)/table.md >&2
	@for f in $^; do case $$f in *.svg|*.md) echo $$f;; esac; done
