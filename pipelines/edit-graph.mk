# METHOD=graph of edit.mk: the residual as the difference of two path graphs on common clusters.
#
# Per pass: trace both scenes with the same random numbers, put the vertices of both graphs into the same clusters, let each
# graph share its light (refine) and gather its image; then merge the differences of the images. What the graphs have in
# common has the same noise and the same blur in both. The spread between passes is the variance, because no pass has its own.
#
# in:   what edit.mk has
# out:  found, a residual

graph_work := $(OUT)/graph
PASSES ?= 4
ITERATIONS ?= 6
UNBIASED ?= 0
K ?= $(default_k)
K := $(K)
ifeq ($(PASSES),1)
$(error PASSES=1: the variance of a difference of path graphs is the spread between passes; give at least 2)
endif
# A quarter of the passes correct the others, at least two, and those that are left are none or at least two.
corrected := $(shell n=$(PASSES); m=$$((n / 4)); [ $$m -ge 2 ] || m=2; [ $$((n - m)) != 1 ] || m=$$n; echo $$m)

cluster := $(BUILD)/bin/loom-cluster
refine := $(BUILD)/bin/loom-refine
gather := $(BUILD)/bin/loom-gather
merge := $(BUILD)/bin/loom-merge
numbers := $(shell seq 0 $$(($(PASSES) - 1)))
sides := old new
in_pass = $(foreach s,$(sides),$(numbers:%=$(graph_work)/$(s)-%.$(1)))
graphs := $(call in_pass,h5)
images := $(call in_pass,exr)

# Not the seed of OLD's image, whose noise would be in the residual too.
graph_seed := $(shell echo $$(($(or $(SEED),0) + 2000003)))
old_scene_parameters = $(call quote,$(OLD))$(call defines,-D,$(DEFINES) $(OLD_DEFINES))$(sensor)
new_scene_parameters = $(call quote,$(NEW))$(call defines,-D,$(DEFINES) $(NEW_DEFINES))$(sensor)
graph_parameters = --spp $(SPP) --seed $(graph_seed)

# All graphs of a scene are traced by one process, so that it is read once; each goes once its image is there.
.SECONDARY: $(graphs) $(call in_pass,clusters.h5) $(call in_pass,radiance.h5)
$(eval $(call parameter,$(graph_work)/trace.parameters,$(old_scene_parameters) $(new_scene_parameters) $(graph_parameters)))
define traced
$(numbers:%=$(graph_work)/$(1)-%.h5) &: $($(1)_stamp) $(graph_work)/trace.parameters $(trace)
	$(LAUNCH) $(trace) $($(1)_scene_parameters) $(graph_parameters) --passes $(PASSES)$(threads) \
		-o $(graph_work)/$(1)-%.h5
endef
$(foreach s,$(sides),$(eval $(call traced,$(s))))

cluster_parameters = --scene $(old_scene_parameters) --with-scene $(call quote,$(NEW))$(call defines,--with-define,$(DEFINES) $(NEW_DEFINES)) --k $(K)$(if $(CLUSTER), $(CLUSTER))
$(eval $(call parameter,$(graph_work)/cluster.parameters,$(cluster_parameters)))
# One process, which reads both scenes once.
$(call in_pass,clusters.h5) &: $(graphs) $(graph_work)/cluster.parameters $(cluster)
	$(LAUNCH) $(cluster) $(numbers:%=$(graph_work)/old-%.h5) --with $(numbers:%=$(graph_work)/new-%.h5) $(cluster_parameters) \
		-o $(graph_work)/%.clusters.h5 --with-output $(graph_work)/%.clusters.h5$(threads)

refine_parameters = --iterations $(ITERATIONS)$(if $(REFINE), $(REFINE))
$(eval $(call parameter,$(graph_work)/refine.parameters,$(refine_parameters)))
$(call in_pass,radiance.h5): $(graph_work)/%.radiance.h5: $(graph_work)/%.h5 $(graph_work)/%.clusters.h5 $(graph_work)/refine.parameters $(refine) | $(call in_pass,clusters.h5)
	$(LAUNCH) $(refine) $(filter %.h5,$^) $(refine_parameters) -o $@$(threads)

gather_parameters = --estimates$(if $(GATHER), $(GATHER))
$(eval $(call parameter,$(graph_work)/gather.parameters,$(gather_parameters)))
$(images): $(graph_work)/%.exr: $(graph_work)/%.h5 $(graph_work)/%.radiance.h5 $(if $(filter subset,$(GATHER)),$(graph_work)/%.clusters.h5) $(graph_work)/gather.parameters $(gather)
	$(LAUNCH) $(gather) $(filter %.h5,$^) $(gather_parameters) -o $@$(threads)

merge_parameters = $(if $(filter 1,$(UNBIASED)),--unbiased $(corrected),$(MERGE))
$(eval $(call parameter,$(graph_work)/merge.parameters,$(PASSES) $(merge_parameters)))
$(found): $(images) $(graph_work)/merge.parameters $(OUT)/edit.parameters $(merge)
	$(LAUNCH) $(merge) $(numbers:%=$(graph_work)/new-%.exr) $(numbers:%=--minus $(graph_work)/old-%.exr) $(merge_parameters) -o $@
	$(if $(filter-out 0,$(KEEP)),,rm -f $(graphs) $(call in_pass,clusters.h5) $(call in_pass,radiance.h5))
