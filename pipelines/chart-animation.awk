# Frames of a row of chart-animation: a table of $parameters. Needs row and n, the number of frames; u runs from 0 to 1.

function wave(u) { u = sin(1.5 * atan2(0, -1) * u); return u < 0 ? -u : u }
function line(values) { printf "%d\t%s\n", t, values }
BEGIN {
    names["ball"] = "x\ty"; names["cornell-lamp"] = "place"; names["cornell-glow"] = "place"; names["cornell-dimmed"] = "light"
    names["teapot-sky"] = "turn"; names["teapot-spin"] = "turn"
    names["cornell-walk"] = names["living-walk"] = names["staircase-walk"] = "bx\tby\tbz\tcx\tcz"
    print "frame\t" (row in names ? names[row] : "bx\tby\tbz")
    for (t = 0; t < n; ++t) {
        u = n > 1 ? t / (n - 1) : 0
        if (row == "ball") line(sprintf("%.4f\t%.4f", -0.62 + 1.24 * u, 0.22 + 0.45 * wave(u)))
        if (row == "cornell-ball") line(sprintf("%.4f\t%.4f\t0.55", -0.62 + 1.24 * u, 0.85 + 0.45 * wave(u)))
        if (row == "living-ball") line(sprintf("%.4f\t%.4f\t3.2", 1.6 - 2 * u, 0.75 + 0.5 * wave(u)))
        if (row == "staircase-ball") line(sprintf("%.4f\t%.4f\t%.4f", 0.1 + 0.21 * u, 0.25 + 0.8 * wave(u), -2.4 + 2.45 * u))
        if (row == "cornell-walk") line(sprintf("%.4f\t%.4f\t0.55\t%.5f\t%.5f", -0.62 + 1.24 * u, 0.85 + 0.45 * wave(u), -0.3 + 0.6 * u, 6.8 - 0.8 * u))
        if (row == "living-walk") line(sprintf("%.4f\t%.4f\t3.2\t%.5f\t%.5f", 1.6 - 2 * u, 0.75 + 0.5 * wave(u), 2.25009 - 1.35009 * u, 6.17872 - 1.17872 * u))
        if (row == "staircase-walk") line(sprintf("%.4f\t%.4f\t%.4f\t%.5f\t%.5f", 0.1 + 0.21 * u, 0.25 + 0.8 * wave(u), -2.4 + 2.45 * u, 0.0324209 - 0.3 * u, 4.88197 - 0.7 * u))
        if (row == "cornell-lamp") line(sprintf("%.4f", -0.35 + 0.7 * u))
        if (row == "cornell-glow") line(sprintf("%.4f", -0.6 + 1.2 * u))
        if (row == "cornell-dimmed") line(sprintf("%.4g, %.4g, %.4g", 17 * (1 - 0.7 * u), 12 * (1 - 0.7 * u), 4 * (1 - 0.7 * u)))
        if (row == "teapot-sky") line(sprintf("%.4f", t))
        if (row == "teapot-spin") line(sprintf("%.4f", 45 * t))
    }
}
