# The radiance cache of animation.mk: what the frames share, from the cameras of CACHE_VIEWS frames, evenly spread.
#
#   trace a path graph of the static scene from each of them (CACHE_SPP samples);  cluster and refine each;  learn one cache
#
# in:   what animation.mk has
# out:  cache, made of OUT/cache/view-NNNN.h5, .clusters.h5 and .radiance.h5

cluster := $(BUILD)/bin/loom-cluster
refine := $(BUILD)/bin/loom-refine
learn := $(BUILD)/bin/loom-learn
cache_work := $(OUT)/cache
cache := $(cache_work)/cache.h5
# The first of the frames, and every so many-th number from it on.
view_first := $(call number,$(firstword $(names)))
view_end := $(shell expr $(lastword $(names)) + 1)
view_step := $(shell echo $$((($(view_end) - $(view_first) + $(CACHE_VIEWS) - 1) / $(CACHE_VIEWS))))
view_names := $(shell for n in $(names); do m=$$(expr $$n + 0); [ $$(((m - $(view_first)) % $(view_step))) != 0 ] || echo $$n; done)
view = $(view_names:%=$(cache_work)/view-%.$(1))
cache_k := $(shell awk 'BEGIN { k = int(16 * sqrt($(CACHE_SPP))); print (k > 128 ? 128 : k) }')
view_seeded := $(if $(SEED), --seed $(shell echo $$(($(SEED) + 2))))

# A view is made again when the static scene or the row of its frame changes.
$(eval $(call parameter,$(cache_work)/static.hash,$(static_hash)))
$(eval $(call parameter,$(cache_work)/views.parameters,$(foreach n,$(view_names),$(n):$(call hash_of,$(n)))$(sensor)$(if $(TRACE), $(TRACE)) --spp $(CACHE_SPP)$(view_seeded)))
$(call view,h5) &: $(cache_work)/static.hash $(cache_work)/views.parameters $(trace)
	@rm -f $(cache_work)/view-*
	$(LAUNCH) $(trace) $(static_parameters) --only $(view_first):$(view_end):$(view_step) --spp $(CACHE_SPP)$(view_seeded)$(threads) \
		-o $(cache_work)/view-%.h5
$(call view,clusters.h5) &: $(call view,h5) $(cluster)
	$(LAUNCH) $(cluster) $(call view,h5) --scene $(scene_parameters) --static $(call quote,$(FRAMES))$(absent) --k $(cache_k)$(threads) \
		-o $(cache_work)/%.clusters.h5
$(call view,radiance.h5): $(cache_work)/%.radiance.h5: $(cache_work)/%.h5 $(cache_work)/%.clusters.h5 $(refine) | $(call view,clusters.h5)
	$(LAUNCH) $(refine) $(cache_work)/$*.h5 $(cache_work)/$*.clusters.h5 -o $@$(threads)
$(eval $(call parameter,$(cache_work)/learn.parameters,$(CACHE)))
$(cache): $(call view,radiance.h5) $(cache_work)/learn.parameters $(learn)
	$(LAUNCH) $(learn) --method $(CACHE) $(call view,h5) $(call view,clusters.h5) $(call view,radiance.h5)$(threads) -o $@
