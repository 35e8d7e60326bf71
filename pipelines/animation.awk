# Words for animation.mk from what loom-inspect --frames prints, in the order of the frames' numbers:
#   static:HASH   frame:NUMBER:HASH, the number with four digits   batch:GRAPH:STATE:NUMBER,NUMBER...
# Frames of a batch take the same graph, number mod `graphs`, and either all are there with the same content (STATE is there) or none
# (missing): frames that have to be made do not make others be made again.
# in: graphs, batch;  OUT, and THERE with the numbers of the frames that are there, from the environment
function is_there(name, hash,    file, was) {
    file = ENVIRON["OUT"] "/images/frame-" name ".hash"
    was = ""
    if ((getline was <file) > 0) close(file)
    return was == hash && name in there
}
BEGIN { for (i = split(ENVIRON["THERE"], names_there, " "); i > 0; --i) there[names_there[i]] = 1 }
function flush(g) {
    if (n[g] > 0) printf " batch:%d:%s:%s", g, was_there[g] ? "there" : "missing", names[g]
    n[g] = 0
}
$1 == "static" { printf "static:%s", $2; next }
{
    name = sprintf("%04d", $1)
    g = $1 % graphs
    state = is_there(name, $2)
    if (n[g] >= batch || (n[g] > 0 && state != was_there[g])) flush(g)
    names[g] = n[g] > 0 ? names[g] "," name : name
    ++n[g]
    was_there[g] = state
    printf " frame:%s:%s", name, $2
}
END { for (g = 0; g < graphs; ++g) flush(g) }
