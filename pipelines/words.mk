# What pipelines say things with.

empty :=
space := $(empty) $(empty)
# $(call quote,TEXT): as one word of a shell.
quote = '$(subst ','\'',$(1))'

# $(call scene_name,FILE): scenes/veach-ajar/scene_v3.xml is called veach-ajar-v3, scenes/mirror.xml mirror.
scene_name = $(shell realpath -s $(call quote,$(1)) | sed -E \
	's/[.]xml$$//; s,.*/([^/]+)/scene_?([^/]*)$$,\1-\2,; s,-$$,,; s,.*/,,' | tr -c 'A-Za-z0-9._+\n-' _)

# $(call parameter,FILE,VALUE): FILE holds VALUE and is written anew only when VALUE is another one.
equal = $(and $(findstring x$(1)x,x$(2)x),$(findstring x$(2)x,x$(1)x))
define parameter
$(1): $(if $(call equal,$(file <$(1)),$(2)),,FORCE)
	@mkdir -p $$(@D) && printf '%s\n' $(call quote,$(2)) >$$@
endef
