#!/usr/bin/env python3
"""mitransient beside ours, on the same time-resolved scene, depth, roulette, samples and threads.

Optional: run by `make peers-transient`; nothing else needs it. Left in a folder:

  rates.tsv         paths per second: ours traced and binned (loom-trace, loom-transient), and mitransient's
  mitransient.h5    mean and var_mean [y, x, bin, channel] of several renderings, for loom-compare

Programs take turns, the fastest of the rounds counts, and a run at few samples is subtracted from one at many, as in
throughput.py. mitransient's lengths begin at the near plane: `start_opl` is later by near_clip.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as xml

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("scene")
parser.add_argument("--bin", default="build/bin", help="folder of our programs")
parser.add_argument("--out", required=True, metavar="FOLDER")
parser.add_argument("--spp", type=int, default=64)
parser.add_argument("--renderings", type=int, default=32, help="of mitransient's cube, each of --spp samples")
parser.add_argument("--threads", type=int, default=os.cpu_count())
parser.add_argument("--rounds", type=int, default=3)
parser.add_argument("-D", "--define", action="append", default=[], metavar="NAME=VALUE")
args = parser.parse_args()

try:
    import drjit as dr
    import mitsuba as mi
    mi.set_variant("llvm_ad_rgb")
    import h5py
    import mitransient  # registers its plugins
    import numpy as np
except ImportError as reason:
    print(f"left out: {reason}", file=sys.stderr)
    sys.exit(0)

defines = dict(define.split("=", 1) for define in args.define)
dr.set_thread_count(args.threads)
scene = mi.load_file(args.scene, **defines)
width, height = (int(side) for side in scene.sensors()[0].film().size())
film = scene.sensors()[0].film()
short_spp, long_spp = 1, 1 + args.spp


def theirs(spp, seed=0):
    start = time.perf_counter()
    cube = np.array(mi.render(scene, spp=spp, seed=seed)[1])  # waits
    return time.perf_counter() - start, cube


def ours(spp):
    with tempfile.TemporaryDirectory() as folder:
        graph, cube = os.path.join(folder, "graph.h5"), os.path.join(folder, "cube.h5")
        common = ["--quiet", "--threads", str(args.threads)]
        trace = [os.path.join(args.bin, "loom-trace"), args.scene, "-o", graph, "--spp", str(spp), "--roulette", "throughput", "--sampler", "independent", *common]
        for name, value in defines.items():
            trace += ["-D", f"{name}={value}"]
        seconds = []
        for command in (trace, [os.path.join(args.bin, "loom-transient"), graph, "-o", cube, *common]):
            start = time.perf_counter()
            subprocess.run(command, check=True)
            seconds.append(time.perf_counter() - start)
        return seconds


theirs(short_spp), theirs(long_spp)  # compiles
fastest = {}
for _ in range(args.rounds):
    for spp in (short_spp, long_spp):
        trace, binning = ours(spp)
        for name, seconds in (("loom-trace", trace), ("loom-trace and loom-transient", trace + binning), ("mitransient llvm_ad_rgb", theirs(spp)[0])):
            fastest[name, spp] = min(seconds, fastest.get((name, spp), seconds))

os.makedirs(args.out, exist_ok=True)
names = list(dict.fromkeys(name for name, _ in fastest))
rates = {name: width * height * args.spp / max(fastest[name, long_spp] - fastest[name, short_spp], 1e-9) / 1e6 for name in names}
with open(os.path.join(args.out, "rates.tsv.partial"), "w") as table:
    print("program", "threads", "spp", "Mpaths/s", "times mitransient", sep="\t", file=table)
    for name, rate in rates.items():
        print(name, args.threads, args.spp, f"{rate:.6g}", f"{rate / rates[names[-1]]:.6g}", sep="\t", file=table)
os.rename(table.name, os.path.join(args.out, "rates.tsv"))
print(f"{args.scene}: {width} x {height} pixels x {args.spp} samples, {args.threads} threads, best of {args.rounds} rounds")
for name, rate in rates.items():
    print(f"{name:32}{rate:10.3f} Mpaths/s {rate / rates[names[-1]]:8.2f}")

mean = squares = 0
for k in range(args.renderings):
    cube = theirs(args.spp, 1000 + k)[1].astype(np.float64)
    shift = (cube - mean) / (k + 1)
    squares = squares + shift * (cube - mean - shift) * (k + 1)
    mean = mean + shift
    squares = np.maximum(squares, 0)


def parameter(name, fallback):
    node = xml.parse(args.scene).find(f".//*[@name='{name}']")
    text = fallback if node is None else node.get("value")
    while text.startswith("$"):
        known = {d.get("name"): d.get("value") for d in xml.parse(args.scene).iter("default")} | defines
        text = known[text[1:]]
    return float(text)


with h5py.File(os.path.join(args.out, "mitransient.h5"), "w") as file:
    file["mean"] = mean.astype(np.float32)
    file["var_mean"] = (squares / (args.renderings - 1) / args.renderings).astype(np.float32)
    file.attrs["start_opl"] = parameter("start_opl", "0") + parameter("near_clip", "0.01")
    file.attrs["bin_width_opl"] = parameter("bin_width_opl", "0.003")
    file.attrs["spp"] = args.spp * args.renderings
