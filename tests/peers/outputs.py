#!/usr/bin/env python3
"""Hashes of all that a fixed set of runs writes, to be compared before and after a change that must change nothing.

    outputs.py record FOLDER [--build build] >before.tsv      # makes the runs in FOLDER, about five minutes on two cores
    outputs.py compare before.tsv after.tsv                   # exit code 1 when any differs

One line per dataset of an HDF5 file and per channel of an image: run, file, name, type, shape, SHA-256 of the values.
Attributes, descriptions, provenance, hashes of files and costs are not compared: they are words and times. Needs h5py and mitsuba (`make peers`).
"""

import argparse
import hashlib
import pathlib
import subprocess
import sys

import h5py
import mitsuba
import numpy

mitsuba.set_variant("scalar_rgb")

SMALL = "resx=48 resy=40"


def scenes():
    """A graph and a path-traced image of every scene of the project's own."""
    for scene in sorted(pathlib.Path("scenes").glob("*.xml")):
        if scene.stem == "nlos":  # a capture has no image
            continue
        yield f"pt-{scene.stem}", ["image", f"SCENE={scene}", f"DEFINES={SMALL}", "METHOD=pt", "SPP=2"]
        yield f"graph-{scene.stem}", ["image", f"SCENE={scene}", f"DEFINES={SMALL}", "METHOD=graph", "SPP=2", "KEEP=1"]


def choices():
    """Path graphs with each choice of each stage."""
    cornell = ["image", "SCENE=scenes/cornell-box.xml", f"DEFINES={SMALL}", "METHOD=pathgraph", "SPP=2", "KEEP=1"]
    glossy = ["image", "SCENE=scenes/glossy-box.xml", f"DEFINES={SMALL}", "METHOD=pathgraph", "SPP=1", "KEEP=1", "SEED=3"]
    yield "pathgraph", cornell
    yield "pathgraph-glossy", glossy
    yield "pathgraph-textured", ["image", "SCENE=scenes/textured.xml", f"DEFINES={SMALL}", "METHOD=pathgraph", "SPP=1"]
    yield "pathgraph-mask", ["image", "SCENE=scenes/mask.xml", f"DEFINES={SMALL}", "METHOD=pathgraph", "SPP=1"]
    yield "pathgraph-slab", ["image", "SCENE=scenes/slab.xml", f"DEFINES={SMALL}", "METHOD=pathgraph", "SPP=1", "KEEP=1"]
    yield "west", [*cornell[:3], "METHOD=west", "SPP=2", "KEEP=1"]
    yield "centres", [*cornell, "CLUSTER=--method centres"]
    yield "points", [*glossy, "REFINE=--reuse points"]
    yield "own", [*cornell, "GATHER=--direct own --indirect own"]
    yield "subset", [*cornell, "GATHER=--direct own --indirect subset --members 4 --occlusion"]
    yield "direct", [*cornell, "DIRECT=8"]
    yield "no-blend", [*cornell, "MERGE=--no-blend"]
    yield "independent", [*cornell, "TRACE=--sampler independent --roulette throughput --misses"]
    yield "denoised", [*cornell, "DENOISE=1"]


def transients():
    flash = ["transient", "SCENE=scenes/flash.xml", f"DEFINES={SMALL} bins=64", "SPP=2", "PASSES=2"]
    yield "transient", flash
    yield "pulse", [*flash, "PULSE=gaussian", "LENGTH=0.2"]
    yield "gate", [*flash, "TRANSIENT=--gate 0.2 --unwarp"]
    yield "shared-in-time", [*flash, "K=16"]
    yield "nlos", ["transient", "SCENE=scenes/nlos.xml", "DEFINES=res=8 bins=64", "SPP=4"]
    yield "slab-in-time", ["transient", "SCENE=scenes/slab.xml", f"DEFINES={SMALL}", "BINS=32", "START=0", "WIDTH=0.5", "SPP=4"]


def edits():
    """Each kind of edit by each method."""
    kinds = {
        "lamp": ["OLD=scenes/cornell-box.xml", "NEW_DEFINES=light=20,10,5"],
        "moved": ["OLD=scenes/edits.xml", "NEW_DEFINES=across=0.4"],
        "rougher": ["OLD=scenes/edits.xml", f"DEFINES={SMALL} floor=tile tall=brushed", "NEW_DEFINES=alpha=0.3"],
        "movers": ["OLD=scenes/movers.xml", "NEW_DEFINES=m1=1 m2=1"],
    }
    for kind, words in kinds.items():
        run = ["edit", f"DEFINES={SMALL}", *words, "SPP=16", "BASE_SPP=4"]
        for method in ("auto", "correlated", "independent", "dynamic"):
            yield f"edit-{kind}-{method}", [*run, f"METHOD={method}"]
        yield f"edit-{kind}-graph", [*run, "METHOD=graph", "SPP=2"]
        yield f"edit-{kind}-old-graph", [*run, "GRAPH=1"]
    yield "edit-techniques", ["edit-techniques", f"DEFINES={SMALL}", *kinds["moved"], "SPP=4"]


def values(file):
    if file.suffix == ".h5":
        found = []
        with h5py.File(file) as h5:
            h5.visititems(lambda name, node: found.append((name, node[()])) if isinstance(node, h5py.Dataset) else None)
        for name, value in found:
            if not name.startswith("provenance") and not name.endswith("/hash"):  # of whole files, commands included
                yield name, numpy.asarray(value)
    else:
        bitmap = mitsuba.Bitmap(str(file))
        names = [channel.name for channel in bitmap.struct_()]
        pixels = numpy.array(bitmap, ndmin=3)
        for i, name in enumerate(names):
            yield name, numpy.ascontiguousarray(pixels[..., i])


def record(args):
    folder = pathlib.Path(args.folder).resolve()
    if folder.exists():
        sys.exit(f"{folder}: exists; the runs must start from nothing")
    for part in (scenes, choices, transients, edits):
        for name, run in part():
            out = folder / name
            words = {word.split("=", 1)[0]: word for word in run[1:]}  # the last of a name counts, as make has it
            command = ["make", "-s", run[0], *words.values(), f"OUT={out}", f"BUILD={args.build}"]
            if run[0].startswith("edit"):
                command.append(f"BASE={out}/base")
            made = subprocess.run(command, capture_output=True, text=True)
            if made.returncode != 0:
                print(name, "-", "-", "-", "-", f"exit code {made.returncode}", sep="\t")
                print(f"{name}: {made.stderr.strip().splitlines()[-1:]}", file=sys.stderr)
            for file in sorted(out.rglob("*")):
                if file.suffix in (".h5", ".exr") and file.stat().st_size > 0:  # empty: none of these samples pay
                    for dataset, value in values(file):
                        digest = hashlib.sha256(value.tobytes()).hexdigest()[:32]
                        print(name, file.relative_to(out), dataset, value.dtype, "x".join(map(str, value.shape)), digest, sep="\t")
            sys.stdout.flush()


def compare(args):
    def read(file):
        return {tuple(line.split("\t")[:3]): line.rstrip("\n").split("\t")[3:] for line in open(file)}

    before, after = read(args.before), read(args.after)
    differing = [key for key in sorted(before.keys() | after.keys()) if before.get(key) != after.get(key)]
    for key in differing:
        print(*key, before.get(key, ["missing"])[-1], after.get(key, ["missing"])[-1], sep="\t")
    print(f"{len(before)} before, {len(after)} after, {len(differing)} differ", file=sys.stderr)
    return 1 if differing else 0


parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
commands = parser.add_subparsers(required=True)
recording = commands.add_parser("record")
recording.add_argument("folder")
recording.add_argument("--build", default="build")
recording.set_defaults(do=record)
comparing = commands.add_parser("compare")
comparing.add_argument("before")
comparing.add_argument("after")
comparing.set_defaults(do=compare)
args = parser.parse_args()
sys.exit(args.do(args))
