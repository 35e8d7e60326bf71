#!/usr/bin/env python3
"""Paths per second of loom-trace beside Mitsuba 3, on the same scene file, depth, samples and threads.

Optional: run by `make peers`; nothing else needs it. The programs take turns, so that a machine that slows
down slows all of them; the fastest of the rounds counts, since other jobs can only make a run longer. A
run at few samples is subtracted from one at many: what is left is tracing, without loading the scene,
compiling kernels or starting a process.
"""

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("scene", nargs="?", default="scenes/cornell-box.xml")
parser.add_argument("--trace", default="build/bin/loom-trace", help="program of ours")
parser.add_argument("--spp", type=int, default=16, help="samples per pixel of the long run")
parser.add_argument("--threads", type=int, default=os.cpu_count())
parser.add_argument("--rounds", type=int, default=3)
parser.add_argument("-D", "--define", action="append", default=[], metavar="NAME=VALUE")
args = parser.parse_args()
short_spp, long_spp = 1, 1 + args.spp

# The same rule and depth of roulette on both sides: by throughput, from depth 5, Mitsuba's default.
roulette = ["--roulette", "throughput"]
defines = [word for define in args.define for word in ("-D", define)]
names = dict(define.split("=", 1) for define in args.define)


def ours(ending):
    def run(spp):
        with tempfile.TemporaryDirectory() as folder:
            command = [args.trace, args.scene, "-o", os.path.join(folder, "x" + ending), "--spp", str(spp),
                       "--threads", str(args.threads), "--quiet", *roulette, *defines]
            start = time.perf_counter()
            subprocess.run(command, check=True)
            return time.perf_counter() - start
    return run


def mitsuba(variant):
    """The run in a process of its own: two variants in one process share one pool of threads."""
    script = """
import sys, time, numpy as np, mitsuba as mi, drjit as dr
variant, scene, threads, names = sys.argv[1], sys.argv[2], int(sys.argv[3]), dict(a.split("=", 1) for a in sys.argv[4:])
mi.set_variant(variant)
dr.set_thread_count(threads)
scene = mi.load_file(scene, **names)
print("size", *scene.sensors()[0].film().size(), flush=True)
for line in sys.stdin:
    start = time.perf_counter()
    np.array(mi.render(scene, spp=int(line), seed=1))
    print("time", time.perf_counter() - start, flush=True)
"""
    process = subprocess.Popen([sys.executable, "-c", script, variant, args.scene, str(args.threads), *args.define],
                               stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)

    def read(word):
        for line in process.stdout:
            if line.startswith(word + " "):
                return [float(value) for value in line.split()[1:]]
        raise RuntimeError(f"{variant} does not run here")

    size = read("size")

    def run(spp):
        process.stdin.write(f"{spp}\n")
        process.stdin.flush()
        return read("time")[0]

    run(short_spp), run(long_spp)  # kernels are compiled once per number of samples
    return run, int(size[0] * size[1])


programs = {"loom-trace graph": ours(".h5"), "loom-trace image": ours(".exr")}
n_pixels = 0
for variant in ("scalar_rgb", "llvm_ad_rgb"):
    try:
        programs[f"mitsuba {variant}"], n_pixels = mitsuba(variant)
    except (RuntimeError, BrokenPipeError) as reason:
        print(f"left out: {reason}", file=sys.stderr)
if not n_pixels:
    sys.exit("no variant of Mitsuba runs here")

fastest = {}
for _ in range(args.rounds):
    for name, run in programs.items():
        for spp in (short_spp, long_spp):
            seconds = run(spp)
            fastest[name, spp] = min(seconds, fastest.get((name, spp), seconds))

n_paths = n_pixels * args.spp
rates = {name: n_paths / max(fastest[name, long_spp] - fastest[name, short_spp], 1e-9) / 1e6 for name in programs}
print(f"{args.scene}: {n_pixels} pixels x {args.spp} samples, {args.threads} threads, best of {args.rounds} rounds")
peers = [name for name in programs if name.startswith("mitsuba")]
print(f"{'':24}{'Mpaths/s':>10}" + "".join(f"{'/ ' + re.sub('mitsuba ', '', peer):>16}" for peer in peers))
for name, rate in rates.items():
    print(f"{name:24}{rate:10.3f}" + "".join(f"{rate / rates[peer]:16.2f}" for peer in peers))
