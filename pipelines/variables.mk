# The variables that may be set on the command line of make or in the environment, by kind. Every makefile of the project includes
# this first: a value is checked as it stands, before make expands it and before a shell reads it, by functions of make alone.
# The files that use a variable document it.

commands := LAUNCH
files := SCENE FRAMES OLD NEW OLD_IMAGE OLD_PICTURE REFERENCE REFERENCE_VARIANCE MEASURED PYTHON PEERS_PYTHON
folders := OUT BASE BUILD REFERENCES DOCS
scene_lists := SCENES
wholes := SPP CACHE_SPP CACHE_VIEWS GIVEN_SPP PASSES GRAPHS BATCH K ITERATIONS BINS JOBS MAX_EVALUATIONS REFERENCE_SPP IMAGE_SPP PICTURE_SPP PASS REPLICATES COUNT SIZE DEPTH IMAGE_SIZE PICTURE_SIZE LONGEST_SIDE
whole_lists := SPPS PT_SPPS
wholes_or_auto := BASE_SPP
wholes_from_0 := SEED BASE_SEED GRAPH_SEED THREADS
switches := KEEP DENOISE MAP UNBIASED DOPPLER
numbers := EXTRA CORRECT FPS START WIDTH LENGTH EXPOSURE EFFORT WAVELENGTH CHIRP
words := METHOD CACHE ABSENT GUIDING REFERENCE_METHOD SAMPLER DIRECT GRAPH UNIT PULSE CHOICES COST ERROR LOSS
word_lists := METHODS SAMPLERS ROWS NAME SENSOR MASK
option_lists := TRACE CLUSTER REFINE GATHER MERGE DERIVE TRANSIENT DRAW FIT
define_lists := DEFINES OLD_DEFINES NEW_DEFINES TRUTH LOWER UPPER SCALE
name_lists := WRT SPEED
kinds := commands files folders scene_lists wholes whole_lists wholes_or_auto wholes_from_0 switches numbers words word_lists option_lists define_lists name_lists

empty :=
space := $(empty) $(empty)
tab := $(empty)	$(empty)
comma := ,
hash := \#
open := (
close := )
define newline


endef
# $(call quote,TEXT): as one word of a shell.
quote = '$(subst ','\'',$(1))'
digits := 0 1 2 3 4 5 6 7 8 9
letters := a b c d e f g h i j k l m n o p q r s t u v w x y z A B C D E F G H I J K L M N O P Q R S T U V W X Y Z
# Characters that make or a shell interprets, in names of targets; those that a shell interprets in a word.
signs_of_make := $$ $(hash) % : ; = * ? [ ] ~ \ | & < > $(open) $(close) { } ! ' " `
signs_of_shell := $$ ; | & < > \ ' " `

# $(call without,CHARACTERS,TEXT), $(call any_of,CHARACTERS,TEXT): TEXT without them; those of them that are in it.
without = $(if $(1),$(call without,$(wordlist 2,$(words $(1)),$(1)),$(subst $(firstword $(1)),,$(2))),$(2))
any_of = $(strip $(foreach c,$(1),$(if $(findstring $c,$(2)),$c)))
# $(call spread,CHARACTERS,TEXT): a blank after each of them.
spread = $(if $(1),$(call spread,$(wordlist 2,$(words $(1)),$(1)),$(subst $(firstword $(1)),$(firstword $(1)) ,$(2))),$(2))
# $(call in_digits,ZERO,LIMIT,TEXT): TEXT when it is a whole number of fewer than LIMIT digits without leading zeros; ZERO: 0 may be.
in_digits = $(if $(or $(call without,$(digits),$(3)),$(word $(2),$(call spread,$(digits),$(3))),$(filter 0%,$(filter-out $(1),$(3)))),,$(3))
is_whole = $(call in_digits,,10,$(1))
is_whole_from_0 = $(call in_digits,0,19,$(1))

# $(call wrong_KIND,TEXT): the fault of a value that is not empty.
one = $(if $(word 2,$(1)),,$(1))
not = $(if $(1),,$(2))
all = $(if $(strip $(foreach w,$(2),$(if $(call $(1),$w),,no))),,yes)
wrong_wholes = $(call not,$(and $(call one,$(1)),$(call is_whole,$(1))),must be a whole number from 1)
wrong_whole_lists = $(call not,$(call all,is_whole,$(1)),must be whole numbers from 1)
wrong_wholes_or_auto = $(if $(call one,$(filter auto,$(1))),,$(call wrong_wholes,$(1)))
wrong_wholes_from_0 = $(call not,$(and $(call one,$(1)),$(call is_whole_from_0,$(1))),must be a whole number from 0)
wrong_switches = $(call not,$(and $(call one,$(1)),$(filter 0 1,$(1))),must be 0 or 1)
wrong_numbers = $(if $(or $(word 2,$(1)),$(call without,$(digits) . e E + -,$(1))),must be a number)
wrong_words = $(if $(or $(word 2,$(1)),$(call without,$(letters) $(digits) _,$(1))),must be a word of letters$(comma) digits and _)
wrong_word_lists = $(if $(call without,$(letters) $(digits) + - . _,$(subst $(space),,$(1))),must be words of letters$(comma) digits and + - . _)
wrong_option_lists = $(if $(call without,$(letters) $(digits) + - . _ $(comma) : = / % @,$(subst $(space),,$(1))),must be options of letters$(comma) digits and + - . _ $(comma) : = / % @)
wrong_define_lists = $(or $(call not,$(call all,is_define,$(1)),must be NAME=VALUE for each parameter),$(call wrong_signs,$(signs_of_shell),$(1)))
is_define = $(findstring =,$(patsubst =%,,$(1)))
wrong_signs = $(if $(call any_of,$(1),$(2)),must not have $(firstword $(call any_of,$(1),$(2))) in it)
wrong_scene_lists = $(call wrong_signs,$(signs_of_make),$(1))
wrong_folders = $(or $(if $(word 2,$(1)),must not have blanks in it: make cannot handle them in the names of what it makes),$(if $(filter -%,$(1)),must not start with -),$(call wrong_signs,$(signs_of_make),$(1)))
# Names in a scene, which may have any character: their uses quote each.
wrong_name_lists = $(if $(filter -%,$(1)),names must not start with -)
wrong_files =

given = $(filter command environment,$(firstword $(origin $(1))))
refuse = $(error $(1)=$(value $(1)): $(2))
# A name that starts with - would be an option.
no_option = $(subst $(newline),,$(subst $(newline)-,./-,$(newline)$(1)))

# $(call check,KIND,NAME): refuses the value, or leaves it with blanks taken off; an empty one, but for texts, counts as not given.
define check
$(if $(findstring $$,$(value $(2))),$(call refuse,$(2),must not have $$ in it))
$(if $(findstring $(newline),$(value $(2))),$(call refuse,$(2),must not have a newline in it))
text := $(if $(filter files,$(1)),$$(value $(2)),$$(strip $$(value $(2))))
$$(if $$(text),$$(if $$(call wrong_$(1),$$(text)),$$(call refuse,$(2),$$(call wrong_$(1),$$(text)))))
ifneq ($$(or $$(text),$(filter option_lists define_lists,$(1))),)
override $(2) := $(if $(filter files,$(1)),$$(call no_option,$$(text)),$$(text))
else
override undefine $(2)
endif
endef
$(foreach k,$(filter-out commands,$(kinds)),$(foreach v,$($(k)),$(if $(call given,$(v)),$(eval $(call check,$(k),$(v))))))

# Other variables of the command line: for compilers and tests, or a typing error.
known := $(foreach k,$(kinds),$($(k))) CC CXX CPPFLAGS CFLAGS CXXFLAGS LDFLAGS CMAKE_% CCACHE_% CTEST_% GTEST_% LOOM_% DRJIT_%
$(foreach v,$(.VARIABLES),$(if $(filter command,$(firstword $(origin $(v)))),$(if $(filter $(known),$(v)),\
	$(if $(filter-out $(commands),$(v)),$(if $(findstring $$,$(value $(v))),$(call refuse,$(v),must not have $$ in it))),\
	$(call refuse,$(v),no variable of these makefiles; make help-image, help-edit ... list them))))
ifneq ($(findstring e,$(filter-out ---%,$(firstword -$(MAKEFLAGS)))),)
$(error make -e: variables of the environment would replace those of these makefiles)
endif
