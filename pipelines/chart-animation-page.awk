# table.tsv of chart-animation -> a table in Markdown.

BEGIN { FS = "\t" }
NR == 1 { for (i = 1; i <= NF; ++i) at[$i] = i; next }
function number(x) { return x == "nan" ? "" : x == 0 ? "0" : sprintf(x >= 100 ? "%.0f" : x < 0.001 ? "%.2g" : "%.3g", x) }
# Of errors below the noise of the references the share says nothing.
function share(x) { return x == "nan" || x < -0.2 || x > 1.2 ? "" : sprintf("%.2f", x) }
NR == 2 {
    print "| animation | method, samples | relMSE | trimmed | frame, CPU s | static image and graph | times better | by MSE | with all, these frames | with all, 240 | flicker | frozen where still |"
    print "|---|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|"
}
{
    pt = $at["method"] == "pt"
    printf "| %s | %s %s | %s | %s | %s | %s | %s | %s | %s | %s | %s | %s |\n", $at["scene"], $at["method"], $at["samples"], number($at["relmse"]), \
        number($at["relmse_trimmed"]), number($at["frame_s"]), pt ? "" : number($at["base_s"]), pt ? "" : number($at["gain"]), pt ? "" : number($at["gain_mse"]), \
        pt ? "" : number($at["gain_all"]), pt ? "" : number($at["gain_240"]), number($at["flicker"]), share($at["frozen_still"])
}
