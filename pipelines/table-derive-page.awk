# table.tsv of table-derive -> a table in Markdown.

BEGIN {
    FS = "\t"
    print made ".\n\n| parameter | method | CPU ms | overhead | MSE | MSE × CPU s | times better | p |\n|---|---|--:|--:|--:|--:|--:|--:|"
}
NR == 1 { for (i = 1; i <= NF; ++i) column[$i] = i; next }
{
    l = $column["method"]
    is_step = l ~ /^step-/
    if (is_step) l = "difference, h = " substr(l, 6) " " $column["unit"] ($column["best"] ? " (best)" : "")
    else sub(/-/, " ", l)
    printf "| %s | %s | %.0f | %s | %.3g ± %.1g | %.3g | %.2f%s | %s |\n", $column["row"], l, 1000 * $column["cost_s"], \
        (is_step ? "" : sprintf("%.0f %%", 100 * $column["overhead"])), $column["mse"], $column["mse_se"], $column["product"], $column["ratio"], \
        ($column["ratio_se"] > 0 ? sprintf(" ± %.1g", $column["ratio_se"]) : ""), ($column["p"] ~ /nan/ ? "" : sprintf("%.2g", $column["p"]))
}
