## make demo SCENE=scenes/cornell-box.xml OUT=out/demo
#
# What `make` alone ends with: OUT/index.html, one page of what Pathloom does, made here within two minutes on two cores.
#
#   image      SCENE by path tracing, by path graphs, and denoised, of equally many samples
#   edit       a moved box: old image, difference, new image
#   transient  light on its way through a room
#   chart      error against cost of path tracing and path graphs

.DELETE_ON_ERROR:
.PHONY: demo
.DEFAULT_GOAL := demo
include pipelines/variables.mk

SCENE ?= scenes/cornell-box.xml  ## scene file of the images and the chart, Mitsuba XML
# SPP=  ## samples per pixel of each of the four passes of the image (4)
# DEFINES=  ## values of the scene's parameters: DEFINES="resx=320 resy=180"
# THREADS=  ## threads of a stage (all); no result depends on it
# OUT=  ## folder of the results (out/demo)
BUILD ?= build
SCENE := $(strip $(SCENE))
SPP ?= 4
OUT ?= out/demo
OUT := $(OUT)
include pipelines/words.mk
ifeq ($(call exists,$(SCENE)),)
$(error SCENE=$(SCENE): no such file)
endif

page := $(BUILD)/bin/loom-report
# The parts, one after the other since the page tells their times: goal and variables of each, for make and for the page.
.NOTPARALLEL:
parts := raw image edit $(if $(shell command -v gnuplot),transient chart,without-gnuplot)
without-gnuplot:
	@echo 'demo: no gnuplot (Debian: apt install gnuplot-nox), so the page has no transient and no chart' >&2
scene_variables = SCENE=$(call typed,$(SCENE))$(if $(DEFINES), DEFINES=$(call typed,$(DEFINES)))
raw = image $(scene_variables) METHOD=pt SPP=$(shell echo $$((4 * $(SPP))))
image = image $(scene_variables) SPP=$(SPP) DENOISE=1
edit = edit OLD=scenes/edits.xml DEFINES='x=-0.78 size=0.2 turn=0' NEW_DEFINES=across=100
transient = transient SCENE=scenes/flash.xml$(if $(DEFINES), DEFINES=) BINS=75 WIDTH=0.12 SPP=48 K=32
chart = chart $(scene_variables) METHODS='pt pathgraph' SPPS='4 16 64' REPLICATES=1 REFERENCE_SPP=1024
.PHONY: without-gnuplot raw image edit transient chart
raw image edit transient chart:
	@echo 'make' $(call quote,$($@)) >&2
	@$(MAKE) --no-print-directory -s -f Makefile BUILD=$(BUILD) $($@) OUT=$(OUT)/$@ BASE=$(OUT)/$@/old >/dev/null

# $(call figure,PART,FIGURE,OUTPUTS): a row of the page, whose heading, text and caption stand in variables; none where there is no
# figure.
figure = [ ! -e $(OUT)/$(1)/$(2) ] || printf '%s\t%s\t%s\t%s\t%s\t%s\n' $(call quote,$($(1)_heading)) $(call quote,$($(1)_text)) $(OUT)/$(1)/$(2) \
	$(call quote,$($(1)/$(2))) $(call quote,$(patsubst %,$(OUT)/$(1)/%,$(3))) $(call quote,$(subst $(tab),$(space),make $($(1))))
raw_heading := A clean image
image_heading := $(raw_heading)
raw_text := The same number of samples per pixel, by path tracing and by path graphs, whose neighbouring vertices share their light. Denoising comes last.
image_text := $(raw_text)
raw/image.png := Path tracing
image/image.png := Path graph
image/clean.png := Path graph, denoised
edit_heading := An edit
edit_text := A box moves. The old image is kept, and paths are traced only for the difference that the move makes (red brighter, blue darker).
edit/old.png := Old image
edit/residual.png := Difference
edit/new.png := New image: old plus difference
transient_heading := Light over time
transient_text := A flash, binned over the optical path length; first hits share the light of their neighbours. The paths are stored, so that another window or pulse needs no new ray.
transient/strip.png := Frames under their optical path lengths
chart_heading := Speed against accuracy
chart_text := Error against CPU time, down and to the left is better. The reference is path traced with 1024 samples per pixel.
chart/error-cost.svg := One point per number of samples

$(OUT)/index.html: $(parts) $(page)
	@$(BUILD)/bin/loom-inspect --quiet $(OUT)/edit/old/old.exr --png $(OUT)/edit/old.png
	@{ printf 'section\ttext\tfigure\tcaption\toutput\tcommand\n'; \
		$(call figure,raw,image.png,image.exr); \
		$(call figure,image,image.png,image.exr); \
		$(call figure,image,clean.png,clean.exr); \
		$(call figure,edit,old.png,old/old.exr); \
		$(call figure,edit,residual.png,residual.exr); \
		$(call figure,edit,new.png,new.exr); \
		$(call figure,transient,strip.png,cube.h5); \
		$(call figure,chart,error-cost.svg,reference/image.exr $(foreach m,pt pathgraph,$(foreach s,4 16 64,$m-$s-0/image.exr))); } >$(OUT)/tour.tsv
	@$(page) --quiet --tour $(OUT)/tour.tsv --title 'The first minute' -o $@

demo: $(OUT)/index.html
	@echo $<
