# One row of table-edit: noise.tsv, costs.tsv, errors.tsv of loom-compare -> what each method costs and brings; own.tsv has what
# residuals cost whose parents do not count.
# Needs table, row, paper and curve: labels of correlated path tracing, by samples.

function mean(sum, n) { return n > 0 ? sum / n : nan }
# Relative variance of a mean of n values.
function spread(sum, square, n) { return n > 1 && sum != 0 ? n * (square / (sum * sum) - 1 / n) / (n - 1) : nan }
# Error of correlated path tracing that has cost c: a power of it between two points, 1 / c beyond.
function equal(error, c,    k) {
    if (n_curve == 1 || c <= cost[at[1]]) return error[at[1]] * cost[at[1]] / c
    if (c >= cost[at[n_curve]]) return error[at[n_curve]] * cost[at[n_curve]] / c
    for (k = 1; c > cost[at[k + 1]]; ++k);
    if (error[at[k]] <= 0 || error[at[k + 1]] <= 0 || cost[at[k]] >= cost[at[k + 1]]) return nan
    return error[at[k]] * exp(log(error[at[k + 1]] / error[at[k]]) * log(c / cost[at[k]]) / log(cost[at[k + 1]] / cost[at[k]]))
}
function nearest(c,    k, best) {
    best = at[1]
    for (k = 2; k <= n_curve; ++k) if (log(cost[at[k]] / c) ^ 2 < log(cost[best] / c) ^ 2) best = at[k]
    return best
}
function over(a, b) { return a > 0 && b > 0 ? a / b : nan }

BEGIN { FS = OFS = "\t"; nan = "nan"; n_curve = split(curve, at, " ") }
FNR == 1 { ++file; split("", column); for (i = 1; i <= NF; ++i) column[$i] = i; next }
file == 1 { noise_mse = $column["mse"] / 4; noise_relmse = $column["relmse"] / 4; next }
file == 2 { split($column["file"], path, "/residual.exr"); seconds[path[1]] += $column["render_s"]; next }
file == 3 {
    split($column["file"], path, "/residual.exr")
    if (!(path[1] in own)) { own[path[1]]; seconds[path[1]] = 0 }
    seconds[path[1]] += $column["cpu_s"] - $column["load_s"]
    next
}
{
    l = $column["method"]
    if (!(l in runs)) order[++labels] = l
    ++runs[l]
    e = $column["mse"] - noise_mse
    sum[l] += e; square[l] += e * e
    relmse[l] += $column["relmse"] - noise_relmse; trimmed[l] += $column["relmse_trimmed"] - noise_relmse; ssim[l] += $column["ssim"]
    split($column["file"], path, "/new.exr")
    c = seconds[path[1]]
    cost_sum[l] += c; cost_square[l] += c * c
}
END {
    print "table", "row", "method", "pairs", "replicates", "cost_s", "mse", "mse_se", "relmse", "ssim", "ratio", "ratio_se", "ratio_trimmed", "paper"
    for (k = 1; k <= labels; ++k) {
        l = order[k]; n = runs[l]
        cost[l] = mean(cost_sum[l], n); mse[l] = mean(sum[l], n); less_worst[l] = mean(trimmed[l], n)
        variance[l] = spread(sum[l], square[l], n); cost_variance[l] = spread(cost_sum[l], cost_square[l], n)
    }
    for (k = 1; k <= labels; ++k) {
        l = order[k]; n = runs[l]
        method = pairs = l
        sub(/-[0-9]+$/, "", method); sub(/.*-/, "", pairs)
        ratio = over(equal(mse, cost[l]), mse[l])
        other = nearest(cost[l])
        se = nan
        if (n > 1 && ratio != nan) se = method == "correlated" ? 0 : ratio * sqrt(variance[l] + cost_variance[l] + variance[other] + cost_variance[other])
        print table, row, method, pairs, n, cost[l], mse[l], (n > 1 ? sqrt(variance[l]) * mse[l] : nan), mean(relmse[l], n), mean(ssim[l], n), ratio, se, \
            over(equal(less_worst, cost[l]), less_worst[l]), paper
    }
}
