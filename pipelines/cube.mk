# Cube of the path graphs of all passes, and its images, for pipelines that include this after passes.mk.
#
#   bin the paths of all graphs together (loom-transient);  with KEEP=0 bin each graph by itself, remove it, and merge
#   the cubes;  draw strip.png and, beside it, what loom-frames writes
#
# in:   what passes.mk has;  keep  empty: each graph goes once it is binned
#       beside  ending of the file that goes with each graph, flag  option of loom-transient that reads it; or none
#       drawn   further options of loom-frames
# out:  targets OUT/cube.h5 and OUT/strip.png, graphs, companions

# BINS=  ## number of bins (the film's, else 300)
# START=  ## start of the first bin, in UNIT (the film's, else the first arrival of light)
# WIDTH=  ## width of a bin, in UNIT (the film's, else 99.9 % of the light is in the window)
# UNIT=  ## unit of START, WIDTH, LENGTH and the images: opl (units of the scene) or ns (opl)
# PULSE=  ## delta, box, gaussian, expgauss, table, sine or square (the film's)
# LENGTH=  ## box: length of the pulse; gaussian: its standard deviation, in UNIT
# TRANSIENT=  ## further options of loom-transient: TRANSIENT="--unwarp --group-index 1.5=1.53"
DRAW ?= --png  ## further options of loom-frames: DRAW="--png --exr --row 40 --pixel 30:60 --exposure 1"

bin := $(BUILD)/bin/loom-transient
merge := $(BUILD)/bin/loom-merge
draw := $(BUILD)/bin/loom-frames
graphs := $(numbers:%=$(work)/pass-%.h5)
companions := $(if $(beside),$(numbers:%=$(work)/pass-%.$(beside)))

.PHONY: cube
cube: $(OUT)/cube.h5 # without images
	@echo $<

cube_parameters = $(strip $(if $(UNIT),--unit $(UNIT)) $(if $(BINS),--bins $(BINS)) $(if $(START),--start $(START)) \
	$(if $(WIDTH),--width $(WIDTH)) $(if $(PULSE),--pulse $(PULSE)) $(if $(LENGTH),--pulse-length $(LENGTH)) $(TRANSIENT))
# Files that options name: the table of a pulse.
option_files := $(wildcard $(subst =, ,$(TRANSIENT)))
cube_parameter_files := $(work)/cube.parameters $(if $(option_files),$(work)/cube.stamp)
$(eval $(call parameter,$(work)/cube.parameters,$(cube_parameters)))
$(if $(option_files),$(eval $(call stamp,$(work)/cube.stamp,$(option_files))))
ifneq ($(keep),)
# Secondary: companions may go, as a chart's do, and are made again where another cube is wanted.
.SECONDARY: $(graphs) $(companions)

$(OUT)/cube.h5: $(graphs) $(companions) $(cube_parameter_files) $(OUT)/passes.parameters $(bin)
	$(LAUNCH) $(bin) $(graphs)$(if $(companions), $(flag) $(companions)) $(cube_parameters) -o $@$(threads)
else
cubes := $(graphs:.h5=.cube.h5)
# Secondary: that a graph is gone does not make it be traced again.
.SECONDARY: $(graphs) $(companions) $(cubes)
$(cubes): %.cube.h5: %.h5 $(if $(beside),%.$(beside)) $(cube_parameter_files) $(bin)
	$(LAUNCH) $(bin) $<$(if $(beside), $(flag) $*.$(beside)) $(cube_parameters) -o $@$(threads)
	rm -f $<$(if $(beside), $*.$(beside))

$(OUT)/cube.h5: $(cubes) $(OUT)/passes.parameters $(merge)
	$(LAUNCH) $(merge) $(cubes) -o $@
endif

$(eval $(call parameter,$(OUT)/frames.parameters,$(strip $(drawn) $(DRAW))))
$(OUT)/strip.png: $(OUT)/cube.h5 $(OUT)/frames.parameters $(draw)
	$(LAUNCH) $(draw) $< -o $@ --movie $(OUT)/movie.mp4$(if $(drawn), $(drawn)) $(DRAW)
