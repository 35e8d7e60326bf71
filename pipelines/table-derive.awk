# One row of table-derive: noise.tsv, check.tsv, plain.tsv, errors.tsv of loom-compare -> error and cost of each method and of differences.
# Needs row, unit: of the parameter.

function mean(sum, n) { return n > 0 ? sum / n : nan }
# Relative variance of a mean of n values.
function spread(sum, square, n) { return n > 1 && sum != 0 ? n * (square / (sum * sum) - 1 / n) / (n - 1) : nan }

BEGIN { FS = OFS = "\t"; nan = "nan" }
FNR == 1 { ++file; split("", column); for (i = 1; i <= NF; ++i) column[$i] = i; next }
file == 1 { noise = $column["mse"] / 4; next }
file == 2 { agreement = $column["p_bins"]; next }
file == 3 { if (!($column["file"] in plain)) ++n_plain; plain[$column["file"]]; plain_cost += $column["render_s"]; next }
{
    l = $column["method"]
    if (!(l in n)) order[++labels] = l
    ++n[l]
    e = $column["mse"] - noise
    sum[l] += e; square[l] += e * e
    cost[l] += $column["render_s"]; cost_square[l] += $column["render_s"] ^ 2
    last = l
}
END {
    print "row", "unit", "method", "replicates", "cost_s", "overhead", "mse", "mse_se", "product", "ratio", "ratio_se", "best", "p"
    plain_cost = mean(plain_cost, n_plain)
    for (k = 1; k <= labels; ++k) {
        l = order[k]
        product[l] = mean(sum[l], n[l]) * mean(cost[l], n[l])
        variance[l] = spread(sum[l], square[l], n[l]) + spread(cost[l], cost_square[l], n[l])
        if (l ~ /^step-/ && (best == "" || product[l] < product[best])) best = l
    }
    for (k = 1; k <= labels; ++k) {
        l = order[k]
        ratio = product[l] > 0 ? product[best] / product[l] : nan
        print row, unit, l, n[l], mean(cost[l], n[l]), mean(cost[l], n[l]) / plain_cost - 1, mean(sum[l], n[l]), \
            sqrt(spread(sum[l], square[l], n[l])) * mean(sum[l], n[l]), product[l], ratio, \
            (l == best ? 0 : ratio * sqrt(variance[l] + variance[best])), l == best, (l == last ? agreement : nan)
    }
}
