#!/usr/bin/env python3
"""Mitsuba 3 beside ours, on the same scene file, depth, roulette, samples and threads.

Optional: run by `make peers`; nothing else needs it. Two things are left in a folder, for charts and reports:

  peers.tsv               paths per second of loom-trace and of each variant of Mitsuba
  peers/NAME/image.exr    with --images: images by Mitsuba at several numbers of samples, their cost beside them as
                          beside ours, so that loom-compare sets them beside each other: equal paths are not equal errors

Programs take turns, so that a machine that slows down slows all of them; the fastest of the rounds counts, since other
jobs can only make a run longer. For the rates a run at few samples is subtracted from one at many: what is left is
tracing, without loading the scene, compiling kernels or starting a process. Pictures are timed after kernels have been
compiled and without loading: compare them by `render_s`. Mitsuba filters pixels as the scene says, ours by a box;
files here are given a box.
"""

import argparse
import json
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
parser.add_argument("--out", metavar="FOLDER", help="where peers.tsv and peers/ go; else only text is printed")
parser.add_argument("--images", default="", metavar="SPPS", help='samples per pixel of images: "1 4 16"')
parser.add_argument("--replicates", type=int, default=3, help="images of each number of samples")
parser.add_argument("-D", "--define", action="append", default=[], metavar="NAME=VALUE")
args = parser.parse_args()
short_spp, long_spp = 1, 1 + args.spp

# The same rule and depth of roulette on both sides: by throughput, from depth 5, Mitsuba's default.
roulette = ["--roulette", "throughput"]
defines = [word for define in args.define for word in ("-D", define)]


def ours(ending):
    def run(spp):
        with tempfile.TemporaryDirectory() as folder:
            command = [args.trace, args.scene, "-o", os.path.join(folder, "x" + ending), "--spp", str(spp),
                       "--threads", str(args.threads), "--quiet", *roulette, *defines]
            start = time.perf_counter()
            subprocess.run(command, check=True)
            return time.perf_counter() - start
    return run


class Mitsuba:
    """A variant in a process of its own: two in one process share one pool of threads."""

    script = r"""
import json, os, re, sys, time, mitsuba as mi, drjit as dr
variant, path, threads, names = sys.argv[1], sys.argv[2], int(sys.argv[3]), dict(a.split("=", 1) for a in sys.argv[4:])
mi.set_variant(variant)
dr.set_thread_count(threads)
mi.Thread.thread().file_resolver().prepend(os.path.dirname(os.path.abspath(path)))
text = re.sub(r'<rfilter type="\w+"\s*/>', '<rfilter type="box"/>', open(path).read())
scene = mi.load_string(text, **names)
print("size", *scene.sensors()[0].film().size(), flush=True)
for line in sys.stdin:
    spp, seed, *output = json.loads(line)
    start, cpu = time.perf_counter(), time.process_time()
    bitmap = mi.Bitmap(mi.render(scene, spp=spp, seed=seed))  # waits for the picture
    print("time", time.perf_counter() - start, time.process_time() - cpu, flush=True)
    if output:
        bitmap = bitmap.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, False)
        bitmap.metadata()["samples"] = str(spp)
        bitmap.write(output[0])
    print("done", flush=True)
"""

    def __init__(self, variant):
        self.name = {"scalar_rgb": "mitsuba_scalar", "llvm_ad_rgb": "mitsuba_llvm"}[variant]
        self.variant = variant
        self.process = subprocess.Popen(
            [sys.executable, "-c", self.script, variant, args.scene, str(args.threads), *args.define],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        self.n_pixels = int(self.read("size")[0] * self.read_rest[1])
        self.render(short_spp), self.render(long_spp)  # kernels are compiled once per number of samples

    def read(self, word):
        for line in self.process.stdout:
            if line.startswith(word + " ") or line == word + "\n":
                self.read_rest = [float(value) for value in line.split()[1:]]
                return self.read_rest
        raise RuntimeError(f"{self.variant} does not run here")

    def render(self, spp, seed=1, output=None):
        """Wall and CPU seconds of a picture."""
        self.process.stdin.write(json.dumps([spp, seed] + ([output] if output else [])) + "\n")
        self.process.stdin.flush()
        seconds = self.read("time")
        self.read("done")
        return seconds

    def run(self, spp):
        return self.render(spp)[0]


programs = {"loom-trace graph": ours(".h5"), "loom-trace image": ours(".exr")}
peers = []
for variant in ("scalar_rgb", "llvm_ad_rgb"):
    try:
        peers.append(Mitsuba(variant))
        programs[f"mitsuba {variant}"] = peers[-1].run
    except (RuntimeError, BrokenPipeError) as reason:
        print(f"left out: {reason}", file=sys.stderr)
if not peers:
    sys.exit("no variant of Mitsuba runs here")

fastest = {}
for _ in range(args.rounds):
    for name, run in programs.items():
        for spp in (short_spp, long_spp):
            seconds = run(spp)
            fastest[name, spp] = min(seconds, fastest.get((name, spp), seconds))

n_paths = peers[0].n_pixels * args.spp
rates = {name: n_paths / max(fastest[name, long_spp] - fastest[name, short_spp], 1e-9) / 1e6 for name in programs}
print(f"{args.scene}: {peers[0].n_pixels} pixels x {args.spp} samples, {args.threads} threads, best of {args.rounds} rounds")
others = [name for name in programs if name.startswith("mitsuba")]
print(f"{'':24}{'Mpaths/s':>10}" + "".join(f"{'/ ' + re.sub('mitsuba ', '', other):>16}" for other in others))
for name, rate in rates.items():
    print(f"{name:24}{rate:10.3f}" + "".join(f"{rate / rates[other]:16.2f}" for other in others))

if args.out:
    os.makedirs(args.out, exist_ok=True)
    with open(os.path.join(args.out, "peers.tsv.partial"), "w") as table:
        columns = [re.sub("mitsuba ", "times ", other) for other in others]
        print("program", "threads", "spp", "Mpaths/s", *columns, sep="\t", file=table)
        for name, rate in rates.items():
            print(name, args.threads, args.spp, f"{rate:.6g}", *(f"{rate / rates[other]:.6g}" for other in others),
                  sep="\t", file=table)
    os.rename(table.name, os.path.join(args.out, "peers.tsv"))
    for replicate in range(args.replicates if args.images else 0):
        for spp in [int(word) for word in args.images.split()]:
            for peer in peers:
                folder = os.path.join(args.out, "peers", f"{peer.name}-{spp}-{replicate}")
                image = os.path.join(folder, "image.exr")
                if os.path.exists(image + ".cost.json"):
                    continue
                os.makedirs(folder, exist_ok=True)
                if replicate == 0:
                    peer.render(spp)  # compiles
                wall_s, cpu_s = peer.render(spp, 1000 + replicate, image)
                cost = {"stage": peer.name, "wall_s": wall_s, "cpu_s": cpu_s, "rays": 0,
                        "samples": peer.n_pixels * spp, "peak_memory_bytes": 0,
                        "bytes_written": os.path.getsize(image), "parents": [],
                        "sources": [os.path.basename(args.scene)],
                        "command": f"{peer.variant} {os.path.basename(args.scene)} --spp {spp} --seed {1000 + replicate}"}
                with open(image + ".cost.json.partial", "w") as file:
                    json.dump(cost, file, indent=1)
                os.rename(file.name, image + ".cost.json")
