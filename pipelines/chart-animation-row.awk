# Measurements of one animation -> a line per method and number of samples. Reads tables of loom-compare one after the other: errors of
# frames, costs of frames, flicker, spectrum. Needs row and kind, and names of two files: gains, for lines of a method's gain by the
# number of frames, and spectra.

BEGIN {
    FS = OFS = "\t"
    print "scene", "method", "frequency", "power" >spectra
    print "scene", "method", "frames", "gain" >gains
}
$1 == "scene" || $1 == "method" { split("", at); for (i = 1; i <= NF; ++i) at[$i] = i; next }
{ l = $at["method"] }
"relmse_net" in at {
    if (!(l in frames)) order[++n] = l
    ++frames[l]; noise = $at["reference_noise"]
    relmse[l] += $at["relmse"] - noise; trimmed[l] += $at["relmse_trimmed"] - noise
    mse[l] += $at["mse_net"]
}
"shared_s" in at { own[l] += $at["render_s"]; base[l] = $at["shared_s"] }
"flicker" in at {
    if ($at["flicker"] == "nan") next
    ++pairs[l]; flicker[l] += $at["flicker"]
    if ($at["frozen_still"] != "nan") { ++stills[l]; frozen[l] += $at["frozen_still"] }
}
# Of the most samples; of one graph there is a table.
"power" in at { if (l !~ /^single/ && $at["power"] > 0) power[l] = power[l] $at["frequency"] OFS $at["power"] "\n" }
END {
    print "kind", "scene", "method", "samples", "frames", "relmse", "relmse_trimmed", "mse", "frame_s", "base_s", "flicker", "frozen_still", "gain", "gain_mse", \
        "gain_all", "gain_24", "gain_240", "gain_plain"
    for (i = 1; i <= n; ++i) {
        l = order[i]; f = frames[l]
        if (match(l, /^pt-d-/) && relmse[l] > 0) add_point(own[l] / f, relmse[l] / f)
        if (samples_of(l) + 0 > most) most = samples_of(l) + 0
    }
    for (i = 1; i <= n; ++i) {
        l = order[i]; f = frames[l]; cost = own[l] / f
        print kind, row, method_of(l), samples_of(l), f, relmse[l] / f, trimmed[l] / f, mse[l] / f, cost, base[l] + 0, \
            pairs[l] ? flicker[l] / pairs[l] : "nan", stills[l] ? frozen[l] / stills[l] : "nan", gain(l, cost, relmse), \
            is_denoised(l) ? "nan" : gain(l, cost, mse), gain(l, cost + base[l] / f, relmse), gain(l, cost + base[l] / 24, relmse), \
            gain(l, cost + base[l] / 240, relmse), gain_plain(l, cost, relmse)
        if (l ~ /^(hybrid|cache)-/)
            for (k = split("1 2 4 8 16 24 48 96 240", counts, " "); k >= 1; --k) {
                g = gain(l, cost + base[l] / counts[k], relmse)
                if (g != "nan") curve[l] = row OFS method_of(l) " " samples_of(l) OFS counts[k] OFS g "\n" curve[l]
            }
        printf "%s", curve[l] >gains
        if (samples_of(l) == most)
            for (k = split(power[l], lines, "\n") - 1; k >= 1; --k) bands[l] = row OFS l OFS lines[k] "\n" bands[l]
        printf "%s", bands[l] >spectra
    }
}
function is_denoised(l) { return l ~ /-d-[0-9]+$/ }
function samples_of(l) { sub(/.*-/, "", l); return l }
function method_of(l) { sub(/-[0-9]+$/, "", l); return l }
function over(a, b) { return a > 0 && b > 0 ? a / b : "nan" }
# How many times better a frame of this cost is than path tracing.
function gain(l, cost, error,    pt) {
    if (is_denoised(l)) return over(denoised_pt(cost), error[l] / frames[l])
    return gain_plain(l, cost, error)
}
# The same over path tracing that is not denoised.
function gain_plain(l, cost, error,    pt) {
    pt = "pt-" samples_of(l)
    return pt in frames ? over(error[pt] / frames[pt] * own[pt] / frames[pt], error[l] / frames[l] * cost) : "nan"
}
# Points of denoised path tracing in the order of their costs.
function add_point(cost, error,    k) {
    for (k = n_points++; k > 0 && costs[k - 1] > cost; --k) { costs[k] = costs[k - 1]; errors[k] = errors[k - 1] }
    costs[k] = cost; errors[k] = error
}
# Its error at a cost, by the line through the two nearest points in the logarithms; of one point as 1 / cost. Beyond the last point it falls
# no faster than noise does, as 1 / cost: what a filter gains from more samples ends.
function denoised_pt(cost,    k, slope) {
    if (n_points == 0 || cost <= 0) return -1
    if (n_points == 1) return errors[0] * costs[0] / cost
    for (k = 0; k < n_points - 2 && costs[k + 1] < cost; ++k);
    slope = log(errors[k + 1] / errors[k]) / log(costs[k + 1] / costs[k])
    if (cost > costs[n_points - 1]) { k = n_points - 1; if (slope < -1) slope = -1 }
    return errors[k] * exp(slope * log(cost / costs[k]))
}
