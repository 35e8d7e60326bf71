# Measurements of one animation -> a line per method and number of samples. Reads tables of loom-compare one after the other: errors of
# frames, costs by stage, flicker. Needs row and kind.

BEGIN { FS = OFS = "\t" }
$1 == "scene" || $1 == "method" { split("", at); for (i = 1; i <= NF; ++i) at[$i] = i; next }
"relmse_net" in at {
    l = $at["method"]
    if (!(l in frames)) order[++n] = l
    ++frames[l]; noise = $at["reference_noise"]
    relmse[l] += $at["relmse"] - noise; trimmed[l] += $at["relmse_trimmed"] - noise
    mse[l] += $at["mse"]
    next
}
"render_s" in at {
    # Of loom-trace each frame names its static image and graph, which are made once.
    l = $at["method"]; s = $at["render_s"] > 0 ? $at["render_s"] : 0
    if ($at["stage"] == "loom-residual" || l ~ /^pt-/) own[l] += s
    else { traced[l] += s; if (s > base[l]) base[l] = s }
    next
}
"flicker" in at {
    if ($at["flicker"] == "nan") next
    l = $at["method"]; ++pairs[l]; flicker[l] += $at["flicker"]
    if ($at["frozen_still"] != "nan") { ++stills[l]; frozen[l] += $at["frozen_still"] }
}
END {
    print "kind", "scene", "method", "samples", "frames", "relmse", "relmse_trimmed", "mse", "frame_s", "base_s", "flicker", "frozen_still", "gain", "gain_mse", "gain_all", "gain_240"
    for (i = 1; i <= n; ++i) {
        l = order[i]; f = frames[l]; split(l, name, "-"); pt = "pt-" name[2]
        # Where auto became path tracing all is the frames' own.
        if (own[l] == 0) { own[l] = traced[l]; base[l] = 0 }
        cost = own[l] / f; of_pt = own[pt] / frames[pt]
        all = cost + base[l] / f; long = cost + base[l] / 240
        print kind, row, name[1], name[2], f, relmse[l] / f, trimmed[l] / f, mse[l] / f, cost, base[l] + 0, flicker[l] / pairs[l], \
            stills[l] ? frozen[l] / stills[l] : "nan", over(relmse[pt] * of_pt, relmse[l] * cost), over(mse[pt] * of_pt, mse[l] * cost), \
            over(relmse[pt] * of_pt, relmse[l] * all), over(relmse[pt] * of_pt, relmse[l] * long)
    }
}
function over(a, b) { return a > 0 && b > 0 ? a / b : "nan" }
