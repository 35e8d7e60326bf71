# table.tsv of table-edit -> tables in Markdown.

function shown(x, format) { return x ~ /nan/ ? "" : sprintf(format, x) }
BEGIN {
    FS = "\t"
    title["3a"] = "Number of movers (Table 3a)"; title["3b"] = "Displacement of a mover (Table 3b)"
    title["2"] = "Materials (Table 2)"; title["stress"] = "Hard cases"; title["scenes"] = "Shared scenes"
    print made "."
}
NR == 1 { for (i = 1; i <= NF; ++i) column[$i] = i; next }
$column["table"] != table {
    table = $column["table"]
    printf "\n### %s\n\n| edit | method | pairs | CPU s | MSE × 10⁵ | SSIM | times better | 0.1 %% trimmed | paper |\n|---|---|--:|--:|--:|--:|--:|--:|--:|\n", title[table]
}
{
    printf "| %s | %s | %d | %.3g | %.3g", $column["row"], $column["method"], $column["pairs"], $column["cost_s"], 1e5 * $column["mse"]
    printf "%s | %.4f | ", ($column["mse_se"] ~ /nan/ ? "" : sprintf(" ± %.1g", 1e5 * $column["mse_se"])), $column["ssim"]
    printf "%s%s | %s | %s |\n", shown($column["ratio"], "%.2f"), ($column["ratio_se"] > 0 ? sprintf(" ± %.1g", $column["ratio_se"]) : ""), \
        shown($column["ratio_trimmed"], "%.2f"), shown($column["paper"], "%.1f")
}
