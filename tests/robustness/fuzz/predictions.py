"""Predictions in every form that is read: grids in npy and npz, packed bits, and meshes."""

import os
import shutil
from pathlib import Path
from random import Random

import numpy as np

from fuzz.engine import Command, Damaged, Fuzzer
from fuzz.places import of_folder
from fuzz.releases import ON_RELEASE, PREDICTIONS, RELEASE, SCORE, WANTED, make_release

CHECK = ("check", PREDICTIONS, *ON_RELEASE)
SURFACE = ("score", PREDICTIONS, *ON_RELEASE, "--no-baselines", "--out", "scores")


def make(folder: Path) -> None:
    import trimesh

    first = folder / "npy"
    first.mkdir()
    make_release(first)
    box = trimesh.creation.box(bounds=[[0.1, 0.2, 0.3], [0.5, 0.4, 0.9]])
    grid = np.random.default_rng(0).random((8, 8, 8)).astype(np.float32)
    for kind in ("npz", "bits", "bool", "obj", "ply"):
        case = folder / kind
        case.mkdir()
        shutil.copytree(first / RELEASE, case / RELEASE, copy_function=os.link)
        for name, *_ in WANTED:
            path = case / PREDICTIONS / name / "000"
            path.parent.mkdir(parents=True)
            if kind == "npz":
                np.savez_compressed(path, grid)
            elif kind == "bits":
                np.save(path, np.packbits(np.zeros((256, 256, 256), bool), axis=-1))
            elif kind == "bool":
                np.save(path, grid > 0.5)
            else:
                box.export(path.with_suffix(f".{kind}"))


def whole(case: Path) -> list[Command]:
    return [Command(words, (0,)) for words in (CHECK, SCORE)]


def damage(draw: Random, case: Path) -> Damaged:
    story = of_folder(draw, case / PREDICTIONS, 0.15)
    return story, [
        Command(CHECK),
        *draw.choice(([], [], [Command(SCORE)], [Command(SCORE)], [Command(SURFACE)])),
    ]


PREDICTIONS_FUZZER = Fuzzer("predictions", make, whole, damage)
