# table.tsv of chart-animation -> tables in Markdown: unbiased frames, denoised ones, one graph against two.

BEGIN { FS = "\t" }
NR == 1 { for (i = 1; i <= NF; ++i) at[$i] = i; next }
function number(x) { return x == "nan" ? "" : x == 0 ? "0" : sprintf(x >= 100 ? "%.0f" : x < 0.001 ? "%.2g" : "%.3g", x) }
# Of errors below the noise of the references the share says nothing.
function share(x) { return x == "nan" || x < -0.2 || x > 1.2 ? "" : sprintf("%.2f", x) }
function of_hybrid(name) { return method ~ /^pt/ ? "" : number($at[name]) }
function start(    e) { return sprintf("| %s | %s %s | %s | %s |", $at["scene"], method, $at["samples"], number($at["relmse"]), number($at["relmse_trimmed"])) }
{
    method = $at["method"]; key = $at["scene"] " " $at["samples"]
    end = sprintf(" %s | %s |\n", number($at["flicker"]), share($at["frozen_still"]))
    costs = sprintf(" %s | %s |", number($at["frame_s"]), of_hybrid("base_s"))
    if (method == "single" || method == "hybrid") graphs[key, method] = start() end
    if (method == "single") { single[++n_single] = key; next }
    if (method ~ /^single/) next
    if (method ~ /-d$/)
        denoised = denoised start() costs sprintf(" %s | %s | %s | %s | %s |", of_hybrid("gain"), of_hybrid("gain_all"), of_hybrid("gain_24"), of_hybrid("gain_240"), number($at["gain_plain"])) end
    else
        unbiased = unbiased start() costs sprintf(" %s | %s | %s | %s |", of_hybrid("gain"), of_hybrid("gain_mse"), of_hybrid("gain_all"), of_hybrid("gain_240")) end
}
END {
    print "| animation | method, samples | relMSE | trimmed | frame, CPU s | static image and graphs | times better | by MSE | with all, these frames | with all, 240 | flicker | frozen where still |"
    print "|---|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|"
    printf "%s", unbiased
    print "\n| animation, denoised | method, samples | relMSE | trimmed | frame, CPU s | static image and graphs | times better at equal cost | with all, these frames | with all, 24 | with all, 240 | than path tracing as it is | flicker | frozen where still |"
    print "|---|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|"
    printf "%s", denoised
    print "\n| animation | one graph (single), two (hybrid) | relMSE | trimmed | flicker | frozen where still |"
    print "|---|---|--:|--:|--:|--:|"
    for (i = 1; i <= n_single; ++i) printf "%s%s", graphs[single[i], "single"], graphs[single[i], "hybrid"]
}
