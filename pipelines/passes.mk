# Passes of samples of one scene, for pipelines that include this: OUT/FOLDER/pass-I.KIND, traced in batches.
#
# in:   SCENE SPP PASSES BATCH OUT SEED THREADS DEFINES SENSOR TRACE LAUNCH BUILD;  K CLUSTER where passes are clustered
#       folder  of the passes within OUT;  kind  h5 or exr;  made  ending of what says that a pass is there
# out:  OUT, work, numbers, last (of the passes), the rules of the passes, cluster_passes, scene_stamp, scene_parameters,
#       common_parameters, threads, and what words.mk has

include pipelines/words.mk
ifeq ($(call exists,$(SCENE)),)
$(error SCENE=$(SCENE): no such file)
endif

OUT ?= out/$(call scene_name,$(SCENE))
OUT := $(OUT)

trace := $(BUILD)/bin/loom-trace
work := $(OUT)/$(folder)
numbers := $(shell seq 0 $$(($(PASSES) - 1)))
last := $(lastword $(numbers))
scene_stamp := $(work)/scene.stamp

# What reaches the result, and what only says how fast.
scene_parameters = $(call quote,$(SCENE))$(call defines,-D,$(DEFINES))$(sensor)
common_parameters = $(scene_parameters)$(if $(TRACE), $(TRACE))
trace_parameters = $(common_parameters) --spp $(SPP)$(if $(SEED), --seed $(SEED))
threads = $(if $(THREADS), --threads $(THREADS))

$(eval $(call stamp,$(scene_stamp),--scene $(scene_parameters)))
$(eval $(call parameter,$(work)/trace.parameters,$(trace_parameters)))
# Passes are traced in batches of BATCH, so that a scene is not read for each. Those that are there already make a
# batch of their own: more passes add to them.
define batch
$(foreach i,$(1),$(work)/pass-$(i).$(kind)) &: $(scene_stamp) $(work)/trace.parameters $(trace)
	$(LAUNCH) $(trace) $(trace_parameters) --first-sample $(shell echo $$(($(firstword $(1)) * $(SPP)))) --passes $(words $(1))$(threads) \
		-o $(work)/pass-%.$(kind)
$(if $(filter-out $(kind),$(made)),$(call whole,$(1),$(made),$(kind)))
endef
# $(call whole,PASSES,MADE,FROM): all files of the batch with the ending FROM are up to date before one of MADE is made, whose recipe may
# remove its own. GNU make 4.3 makes several targets of one rule again when it meets the first that is old or missing.
whole = $(1:%=$(work)/pass-%.$(2)): | $(1:%=$(work)/pass-%.$(3))
# 0,1,2,3 4,5: comma-separated passes of each batch, which have the same files: what a killed make left stays.
batches := $(shell i=0; was=; for i in $(numbers); do \
	is=$$(for e in $(sort $(made) $(kind) clusters.h5); do [ ! -e $(call quote,$(work))/pass-$$i.$$e ] || printf ' %s' $$e; done); \
	if [ $$i = 0 ]; then printf '%s' $$i; \
	elif [ $$((i % $(BATCH))) = 0 ] || [ "$$is" != "$$was" ]; then printf ' %s' $$i; \
	else printf ',%s' $$i; fi; was=$$is; done)
$(foreach b,$(batches),$(eval $(call batch,$(subst $(comma),$(space),$(b)))))

# $(eval $(cluster_passes)): rules of OUT/FOLDER/pass-I.clusters.h5. Clusters of a batch are made by one process, which reads
# the scene once. Borders between clusters are drawn anew in each pass, so that they average out.
cluster := $(BUILD)/bin/loom-cluster
cluster_parameters = --scene $(scene_parameters) --k $(K)$(if $(CLUSTER), $(CLUSTER))
define clustered_batch
$(1:%=$(work)/pass-%.clusters.h5) &: $(1:%=$(work)/pass-%.h5) $(work)/cluster.parameters $(cluster)
	$(LAUNCH) $(cluster) $(1:%=$(work)/pass-%.h5) $(cluster_parameters) --seed $(firstword $(1)) -o $(work)/%.clusters.h5$(threads)
$(call whole,$(1),radiance.h5,clusters.h5)
endef
define cluster_passes
$(call parameter,$(work)/cluster.parameters,$(cluster_parameters))
$(foreach b,$(batches),$(eval $(call clustered_batch,$(subst $(comma),$(space),$(b)))))
endef
