# Functions that the pipelines share.

.PHONY: FORCE

# $(call scene_name,FILE): scenes/veach-ajar/scene_v3.xml is called veach-ajar-v3, scenes/mirror.xml mirror.
scene_name = $(shell realpath -s $(call quote,$(1)) | sed -E \
	's/[.]xml$$//; s,.*/([^/]+)/scene_?([^/]*)$$,\1-\2,; s,-$$,,; s,.*/,,' | tr -c 'A-Za-z0-9._+\n-' _)
# $(call row_name,FILE): as scene_name, in tables of scenes of version 3: scenes/cornell-box/scene_glossy_v3.xml is called cornell-box_glossy.
row_name = $(shell printf '%s' $(call quote,$(1)) | sed -E 's/[.]xml$$//; s,.*/([^/]+)/scene(_[a-z]+)?_v3$$,\1\2,; s,.*/,,')
# $(call typed,TEXT): as it may be typed again: quotes only where they are needed.
typed = $(if $(or $(word 2,$(1)),$(call any_of,$(signs_of_make),$(1))),$(call quote,$(1)),$(1))
# $(call exists,FILE)
exists = $(shell test -f $(call quote,$(1)) && echo there)
# $(call defines,FLAG,VALUES): a blank and FLAG before each of NAME=VALUE ...
defines = $(if $(strip $(2)), $(foreach d,$(2),$(1) $(call quote,$(d))))
sensor = $(if $(SENSOR), --sensor $(call quote,$(SENSOR)))

# $(call parameter,FILE,VALUE): FILE holds VALUE and is written anew only when VALUE is another one.
# By sort, which drops equal words: findstring fails now and then on long texts (strstr of glibc 2.36 for AVX-512).
equal = $(filter 1,$(words $(sort $(call one_word,$(1)) $(call one_word,$(2)))))
one_word = x$(subst $(tab),\t,$(subst $(space),\s,$(1)))
define parameter
$(1): $(if $(call equal,$(file <$(1)),$(2)),,FORCE)
	@mkdir -p $$(@D) && printf '%s\n' $(call quote,$(2)) >$$@
endef

# Vertices of a cluster, of graphs of SPP samples.
default_k = $(shell awk 'BEGIN { k = int(16 * sqrt($(SPP))); print (k < 1 ? 1 : k > 128 ? 128 : k) }')

# $(call stamp,FILE,WHAT): FILE holds the content hashes of WHAT loom-inspect --stamp takes, and is written anew only when they are
# others, whatever the times: what depends on contents depends on FILE. Of a scene that is all files it names.
inspect := $(BUILD)/bin/loom-inspect
define stamp
$(1): $(if $(shell $(inspect) --quiet --stamp $(1) --check $(2) 2>/dev/null && echo same),,FORCE) | $(inspect)
	@mkdir -p $$(@D) && $(inspect) --quiet --stamp $$@ $(2)
endef

# $(call scene_row,FILE,SCENE): of a table with a row per scene, FILE is made of SCENE, `scene` of its recipe, and of the references
# for it in REFERENCES.
define scene_row
$(1): scene := $(2)
$(1): $(dir $(1))inputs.stamp
$(call stamp,$(dir $(1))inputs.stamp,--scene $(2) $(wildcard $(patsubst %,$(REFERENCES)/$(call row_name,$(2))_%.exr,ref var)))
endef

# Run alone on a tree that is not built yet.
$(patsubst stages/%/main.cpp,$(BUILD)/bin/loom-%,$(wildcard stages/*/main.cpp)) &:
	$(MAKE) --no-print-directory -f Makefile stages
