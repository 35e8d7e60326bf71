# What `make help-NAME` prints: usage lines (## ...) and documented variables (VAR ?= default  ## meaning, or # VAR=  ## meaning) of
# the pipeline that target NAME of the Makefile runs, and of the pipelines that this one includes. in: target; Makefile
FILENAME == "Makefile" {
    if (index($0, target ":") == 1) on = 1
    else if (on && match($0, /pipelines\/[a-z-]+[.]mk/)) { ARGV[ARGC++] = substr($0, RSTART, RLENGTH); on = 0 }
    next
}
/^include pipelines\/[a-z-]+[.]mk$/ { ARGV[ARGC++] = $2 }
/^## / { print (/^## make / ? "Usage: " : "       ") substr($0, 4) }
/^(# *)?[A-Z_]+ *[?]?=.*  ## / {
    at = index($0, "  ## ")
    setting = substr($0, 1, at - 1)
    sub(/^# */, "", setting)
    sub(/ *[?]?= */, "=", setting)
    sub(/ +$/, "", setting)
    printf "  %-30s %s\n", setting, substr($0, at + 5)
}
