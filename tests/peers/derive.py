#!/usr/bin/env python3
"""Mitsuba 3's derivatives of a steady image beside ours, on the same scene and parameter.

Optional: run by `make peers-derive`; nothing else needs it. Left in a folder:

  derive.tsv    a row per program: mean of the derivative and its standard error, MSE against a reference image, CPU seconds, their product

Mitsuba: `direct_projective` (depth 2) or `prb_projective`, forward mode, silhouettes sampled by its defaults but for --guiding. Ours: loom-trace,
loom-derive, and the sum of its rows over all times. All programs run on one thread, several times with their own seeds. Mitsuba's time
is that of a render after kernels have been compiled; ours is whole processes, the scene's reading taken off. `mse` is against the reference, `mse_within` from the spread between runs, and `product` is mse_within x cpu_s.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("scene", help="with a parameter that moves --shape along x")
parser.add_argument("--wrt", default="theta", help="name of that parameter")
parser.add_argument("--shape", default="occluder", help="id of the shape that it moves")
parser.add_argument("--reference", help="derivative image (EXR); else the mean of all runs of the other program")
parser.add_argument("--bin", default="build/bin", help="folder of our programs")
parser.add_argument("--out", required=True, metavar="FOLDER")
parser.add_argument("--spp", type=int, default=16)
parser.add_argument("--depth", type=int, default=2)
parser.add_argument("--guiding", default="octree", choices=("octree", "grid", "none"), help="of Mitsuba's silhouette samples")
parser.add_argument("--runs", type=int, default=4)
args = parser.parse_args()

try:
    import drjit as dr
    import mitsuba as mi
    mi.set_variant("llvm_ad_rgb")
    import h5py
    import numpy as np
except ImportError as reason:
    print(f"left out: {reason}", file=sys.stderr)
    sys.exit(0)

dr.set_thread_count(1)
scene = mi.load_file(args.scene, **{args.wrt: "0"})
height, width = (int(side) for side in scene.sensors()[0].film().size()[::-1])
parameters = mi.traverse(scene)
key = f"{args.shape}.vertex_positions"
by_vertices = key in parameters
if not by_vertices:
    key = f"{args.shape}.to_world"
start = mi.Float(parameters[key]) if by_vertices else mi.Transform4f(parameters[key])


def theirs(integrator, spp, seed):
    theta = mi.Float(0)
    dr.enable_grad(theta)
    if by_vertices:
        points = dr.unravel(mi.Point3f, start)
        points.x += theta
        parameters[key] = dr.ravel(points)
    else:
        parameters[key] = mi.Transform4f().translate([theta, 0, 0]) @ start
    parameters.update()
    dr.eval()
    begin = time.process_time()
    dr.forward(theta, dr.ADFlag.ClearEdges)
    image = mi.render(scene, parameters, integrator=integrator, spp=spp, seed=seed)
    derivative = np.array(dr.forward_to(image))
    return derivative[..., :3].astype(float), time.process_time() - begin


def ours(spp, seed):
    with tempfile.TemporaryDirectory() as folder:
        graph, derivative = os.path.join(folder, "graph.h5"), os.path.join(folder, "derivative.h5")
        common = ["--quiet", "--threads", "1"]
        commands = ([os.path.join(args.bin, "loom-trace"), args.scene, "--primitives", "--media", "--sampler", "independent", "--seed", str(seed),
                     "--spp", str(spp), "--max-depth", str(args.depth), "-o", graph, *common],
                    [os.path.join(args.bin, "loom-derive"), args.scene, graph, "--wrt", args.wrt, "--seed", str(seed), "-o", derivative, *common])
        seconds = 0
        for command, file in zip(commands, (graph, derivative)):
            subprocess.run(command, check=True)
            cost = json.load(open(file + ".cost.json"))
            seconds += cost["cpu_s"] - cost["load_s"]
        with h5py.File(graph) as g, h5py.File(derivative) as d:
            n = width * height
            image = np.zeros((n, 3))
            first, vertex = g["paths/first_vertex"][:].astype(np.int64), g["light_edges/vertex"][:]
            pixels = lambda edges: (np.searchsorted(first, vertex[edges], side="right") - 1) % n
            points = d["light_points"] if "light_points" in d else {"edge": np.zeros(0, int), "dL": None}
            for rows, values, weight in ((pixels(d["interior/edge"][:]), d["interior/dL"], 1 / spp),
                                         (pixels(points["edge"][:]), points["dL"], 1 / spp), (d["seen/path"][:] % n, d["seen/dLe"], 1 / spp),
                                         (d["boundary/pixel"][:], d["boundary/dL"], 1)):
                if len(rows):
                    for c in range(3):
                        image[:, c] += weight * np.bincount(rows, values[:, 0, c].astype(float), n)
            return image.reshape(height, width, 3), seconds


name = "direct_projective" if args.depth == 2 else "prb_projective"
programs = {"loom-derive": ours}
found = {"loom-derive": [ours(args.spp, 1 + k) for k in range(args.runs)]}
try:
    integrator = mi.load_dict({"type": name, "guiding": args.guiding} | ({} if args.depth == 2 else {"max_depth": args.depth}))
    theirs(integrator, args.spp, 1000)  # compiles
    found[f"mitsuba {name}"] = [theirs(integrator, args.spp, k) for k in range(args.runs)]
except Exception as reason:  # plugins refuse scenes in many ways
    print(f"left out: {name}: {str(reason).splitlines()[0]}", file=sys.stderr)

if args.reference:
    bitmap = mi.Bitmap(args.reference).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32)
    references = {program: np.array(bitmap, dtype=float) for program in found}
else:
    references = {program: np.mean([image for other, runs in found.items() if other != program or len(found) == 1 for image, _ in runs], axis=0)
                  for program in found}

os.makedirs(args.out, exist_ok=True)
columns = ["program", "spp", "runs", "mean", "se", "mse", "mse_within", "cpu_s", "product"]
with open(os.path.join(args.out, "derive.tsv.partial"), "w") as table:
    print(*columns, sep="\t", file=table)
    print(os.path.basename(args.scene), ":", *columns)
    for program, runs in found.items():
        images = np.array([image for image, _ in runs])
        means = images.mean(axis=(1, 2, 3))
        mse = np.mean((images - references[program]) ** 2)
        within = np.mean(images.var(axis=0, ddof=1))
        seconds = np.mean([cost for _, cost in runs])
        row = [program, args.spp, len(runs), f"{means.mean():.6g}", f"{means.std(ddof=1) / len(runs) ** 0.5:.2g}", f"{mse:.4g}", f"{within:.4g}",
               f"{seconds:.4g}", f"{within * seconds:.4g}"]
        print(*row, sep="\t", file=table)
        print(*row, sep="  ")
os.rename(table.name, os.path.join(args.out, "derive.tsv"))
