# Passes of samples of one scene, for pipelines that include this: OUT/FOLDER/pass-I.KIND, traced in batches.
#
# in:   SCENE SPP PASSES BATCH OUT SEED THREADS DEFINES TRACE LAUNCH BUILD
#       folder  of the passes within OUT;  kind  h5 or exr;  made  ending of what says that a pass is there
# out:  OUT, work, numbers, last (of the passes), the rules of the passes, scene_prerequisite, scene_parameters,
#       common_parameters, threads, and what words.mk has

include pipelines/words.mk
BATCH := $(strip $(BATCH))
ifneq ($(shell printf '%s\n' $(call quote,$(SPP)) $(call quote,$(PASSES)) $(call quote,$(BATCH)) | \
		grep -cxE '[1-9][0-9]{0,8}'),3)
$(error SPP=$(SPP) PASSES=$(PASSES) BATCH=$(BATCH): must be whole numbers from 1)
endif
ifeq ($(shell test -f $(call quote,$(SCENE)) && echo there),)
$(error SCENE=$(SCENE): no such file)
endif

OUT := $(or $(strip $(OUT)),out/$(call scene_name,$(SCENE)))
ifneq ($(words $(OUT)),1)
$(error OUT=$(OUT): make cannot handle blanks in the names of what it makes)
endif

trace := $(BUILD)/bin/loom-trace
work := $(OUT)/$(folder)
numbers := $(shell seq 0 $$(($(PASSES) - 1)))
last := $(lastword $(numbers))
scene_prerequisite := $(subst $(space),\$(space),$(SCENE))

# What reaches the result, and what only says how fast.
scene_parameters = $(call quote,$(SCENE))$(if $(DEFINES), $(foreach d,$(DEFINES),-D $(call quote,$(d))))
common_parameters = $(scene_parameters)$(if $(TRACE), $(TRACE))
trace_parameters = $(common_parameters) --spp $(SPP)$(if $(SEED), --seed $(SEED))
threads = $(if $(THREADS), --threads $(THREADS))

$(eval $(call parameter,$(work)/trace.parameters,$(trace_parameters)))
# Passes are traced in batches of BATCH, so that a scene is not read for each. Those that are there already make a
# batch of their own: more passes add to them.
define batch
$(foreach i,$(1),$(work)/pass-$(i).$(kind)) &: $(scene_prerequisite) $(work)/trace.parameters $(trace)
	$(LAUNCH) $(trace) $(trace_parameters) --first-sample $(shell echo $$(($(firstword $(1)) * $(SPP)))) --passes $(words $(1))$(threads) \
		--depfile $(work)/from-$(firstword $(1)).d -o $(work)/pass-%.$(kind)
endef
# 0,1,2,3 4,5: comma-separated passes of each batch
batches := $(shell i=0; was=; for i in $(numbers); do \
	is=$$([ -e '$(work)'/pass-$$i.$(made) ] && echo there || echo missing); \
	if [ $$i = 0 ]; then printf '%s' $$i; \
	elif [ $$((i % $(BATCH))) = 0 ] || { [ $$is = missing ] && [ $$was = there ]; }; then printf ' %s' $$i; \
	else printf ',%s' $$i; is=$$was; fi; was=$$is; done)
comma := ,
$(foreach b,$(batches),$(eval $(call batch,$(subst $(comma),$(space),$(b)))))

# Files that the scene includes: meshes, textures, other scene files.
-include $(wildcard $(work)/from-*.d)
