# Tables of edits. in: edits, a row per word, its fields between |, the second of which names it, - for an empty one; ROWS,
# the requested names (all); $(call here,NAME), empty where what it needs is missing; needs, what that is
# out: ROWS, those that can be done, in that order; $(call field,N,NAME)
field = $(filter-out -,$(word $(1),$(subst |, ,$(line.$(2)))))
$(foreach e,$(edits),$(eval line.$(word 2,$(subst |, ,$(e))) := $(e)))
names := $(foreach e,$(edits),$(word 2,$(subst |, ,$(e))))
unknown := $(filter-out $(names),$(ROWS))
ifneq ($(unknown),)
$(error ROWS: $(unknown): unknown; the rows are $(names))
endif
wanted := $(or $(strip $(ROWS)),$(names))
ROWS := $(foreach w,$(wanted),$(if $(call here,$(w)),$(w)))
missing := $(filter-out $(ROWS),$(wanted))
ifneq ($(missing),)
$(info left out, because there is no $(needs): $(missing))
endif
ifeq ($(ROWS),)
$(error ROWS: no row is left to run)
endif

# $(call move,SHAPE,BY): sed that moves the shapes whose text matches.
move = /<shape/{:whole;/<\/shape>/!{N;bwhole;};/$(1)/s,</transform>,<translate $(2)/>&,;}
# $(call elsewhere,FROM,TO): sed that names the files of a scene in folder FROM as they are named from folder TO.
elsewhere = s,(name="filename" value=")([^/]),\1$(shell realpath -m --relative-to=$(2) $(1))/\2,g
# $(call size_of,FILE,LONGER SIDE): resx and resy, shaped as a scene file has them.
size_of = $(shell sed -nE 's/.*<default name="(resx|resy)" value="([0-9]+)".*/\1 \2/p' $(1) | awk -v n=$(2) \
	'{ v[$$1] = $$2; if ($$2 > most) most = $$2 } END { for (k in v) printf "%s=%d ", k, v[k] * n / most + 0.5 }')
# Recipe: what the shell writes to its output becomes the target, which is written anew only when it is another one.
update = >$@.made && if cmp -s $@.made $@; then rm $@.made; else mv $@.made $@; fi
