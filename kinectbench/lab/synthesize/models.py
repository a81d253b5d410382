"""Settings of `synthesize`; find the models, draw some of them, and assign these to splits."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, JsonValue

from kinectbench.core import Category, Name, SettingsError, category_problem, name_problem
from kinectbench.core.types import Framing, Split
from kinectbench.lab.simulate.objects import PAPER_FURNITURE, check_family
from kinectbench.release.exchange.layouts import SYNSETS
from kinectbench.settings.base import Settings

Layout = Literal["release", "recgan"]
Categories = Annotated[tuple[Category, ...], Field(strict=False)]


class SynthesisSettings(Settings):
    """Settings of `synthesize`. The same settings and meshes give the same bytes."""

    name: Name = Field("synthetic", description="name of the benchmark")
    license: str = Field("unspecified", description="licence of the data, such as CC-BY-4.0")
    models: str | None = Field(None, description="folder of CAD meshes; default: parametric furniture")
    categories: Categories = Field((), description="only these; default: all there are")
    seed: int = Field(0, ge=0, le=10**9, description="draws each split's models, and noise")
    train: int = Field(220, ge=0, le=100_000, description="training models per category (paper)")
    validation: int = Field(12, ge=0, le=100_000, description="validation models per category (paper)")
    test: int = Field(40, ge=0, le=100_000, description="test models per category (paper)")
    sv_steps: int = Field(5, ge=1, le=10, description="angles of roll, of pitch and of yaw, same viewing")
    cv_steps: int = Field(6, ge=1, le=10, description="the same, cross viewing")
    up: Literal["y", "z"] | None = Field(
        None,
        description="axis that points up; default: y in mesh files (ShapeNet), z in parametric furniture",
    )
    most_views: int | None = Field(
        None, ge=1, description="of a model's same or cross views only so many, drawn; default: all (paper)"
    )
    solid: Literal["mesh", "seeable"] = Field(
        "mesh",
        description="what is inside: as the mesh has it; or seeable: also what no camera could see, "
        "as of recordings",
    )
    noise: Literal["none", "kinect"] = Field(
        "none", description="of the depth: none, as in the paper; or kinect: a Kinect v1's errors"
    )
    image_px: int = Field(320, ge=64, le=2048, description="width and height of the virtual depth image")
    max_faces: int = Field(1_000_000, ge=1, description="meshes with more are left out")
    min_containment: float = Field(0.85, ge=0, le=1, description="pairs below are refused")
    framing: Framing = Field("object", description="object: cube around the full shape; view: the view's")
    layout: Layout = Field("release", description="release, or recgan: the paper authors' files")

    @property
    def up_axis(self) -> Literal["y", "z"]:
        """The axis of the models that points up."""
        return self.up or ("z" if self.models is None else "y")

    def stored(self, without: set[str]) -> dict[str, JsonValue]:
        """Return the settings as JSON values, without some keys; `noise` is left out if it is "none"."""
        values = self.model_dump(mode="json", exclude=without)
        return {key: value for key, value in values.items() if (key, value) != ("noise", "none")}

    @property
    def wanted(self) -> dict[Split, int]:
        """The requested {split: models per category}, in the order in which splits are filled."""
        return {"train": self.train, "validation": self.validation, "test": self.test}


# Paths of a model's mesh in its folder, in ShapeNet v2 and v1.
MESHES = ("models/model_normalized.obj", "model_normalized.obj", "model.obj")
SUFFIXES = (".obj", ".ply", ".stl", ".off", ".glb")
# Room for the endings of recordings' names, `<model>-sv` and `<model>-cv`.
LONGEST_NAME = 77


@dataclass(frozen=True, order=True)
class Model:
    """A CAD mesh or a parametric object from which pairs are made.

    Attributes:
        category: the category, such as "chair".
        name: the model's name, unique among all models and valid as a file name.
        path: the mesh file; "" for a parametric model.
        seed: seed for the parametric family `category`; -1 for a file.
    """

    category: str
    name: str
    path: str = ""
    seed: int = -1

    @property
    def label(self) -> str:
        """The model's name in messages, `<category>/<name>`."""
        return f"{self.category}/{self.name}"


@dataclass(frozen=True, order=True)
class LeftOut:
    """A model, or a category, that cannot be used, and the reason in a few words."""

    model: str
    reason: str


def family_models(categories: Sequence[str], count: int) -> tuple[Model, ...]:
    """Return `count` parametric models of each family, with seeds 0 to count - 1.

    If no categories are given, the families are those of the paper's furniture.

    Raises:
        SettingsError: unknown family.
    """
    names = sorted(check_family(name) for name in categories or PAPER_FURNITURE)
    return tuple(Model(name, f"{name}-{seed:05d}", seed=seed) for name in names for seed in range(count))


def folder_models(folder: Path, categories: Sequence[str]) -> tuple[tuple[Model, ...], tuple[LeftOut, ...]]:
    """Return a folder's models, sorted, and those left out because of their name or a missing mesh file.

    Layouts: `<synset>/<model>/models/model_normalized.obj` (ShapeNet v2), `<synset>/<model>/model.obj` (v1),
    `<category>/<name>.obj` (or .ply, .stl, .off, .glb). In each, the first folder may be a synset or a
    category's name.

    Raises:
        SettingsError: the folder does not exist, has no category, or lacks a requested one.
    """
    if not folder.is_dir():
        raise SettingsError(f"{folder}: no folder of models there; give one with --models", what="no-file")
    folders: dict[str, list[Path]] = {}  # a category may be there by its synset and by its name
    for path in sorted(folder.iterdir()):
        if path.is_dir():
            folders.setdefault(SYNSETS.get(path.name, path.name), []).append(path)
    missing = [name for name in categories if name not in folders]
    if missing or not folders:
        listing = ", ".join(folders) or "no category's folder"
        raise SettingsError(
            f"{folder}: no {', '.join(missing) or 'models'} there; it holds {listing}", what="no-file"
        )
    models: dict[str, Model] = {}
    left_out = []
    spelled: dict[str, str] = {}
    for category in sorted(categories or folders):
        if (other_case := spelled.setdefault(category.lower(), category)) != category:
            left_out.append(LeftOut(category, f"but for case the same category as {other_case}"))
            continue
        for entry in chain.from_iterable(_entries(category, path) for path in folders[category]):
            if isinstance(entry, LeftOut):
                left_out.append(entry)
            elif (other := models.setdefault(entry.name.lower(), entry)) is not entry:
                same = "the same name as" if other.name == entry.name else "but for case the same name as"
                left_out.append(LeftOut(entry.label, f"{same} a model of {other.category}"))
    return tuple(sorted(models.values())), tuple(left_out)


def _entries(category: str, folder: Path) -> Iterator[Model | LeftOut]:
    """Yield the models in a category's folder, and those left out because of their name or a missing mesh."""
    if problem := category_problem(category):
        yield LeftOut(folder.name, f"a category's name: {problem}")
        return
    for path in sorted(folder.iterdir()):
        if path.is_dir():
            mesh = next((path / name for name in MESHES if (path / name).is_file()), None)
            model = Model(category, path.name, str(mesh or ""))
        elif path.suffix.lower() in SUFFIXES:
            model = Model(category, path.stem, str(path))
        else:
            continue  # materials, textures, lists
        problem = name_problem(model.name)
        if len(model.name) > LONGEST_NAME:
            problem = f"longer than {LONGEST_NAME} characters"
        if problem:
            yield LeftOut(replace(model, name=path.name).label, f"its name: {problem}")
        else:
            yield model if model.path else LeftOut(model.label, "no mesh file in its folder")


@dataclass(frozen=True)
class Dealt:
    """The models of one category after their assignment to splits.

    Attributes:
        split_of: {model: its split}.
        left_out: models that were checked and cannot be used.
        unused: number of models that were not needed, and not checked.
    """

    split_of: dict[Model, Split]
    left_out: tuple[LeftOut, ...]
    unused: int


# Order in which splits get a model if there are fewer models than splits.
PRIORITY: tuple[Split, ...] = ("test", "train", "validation")

Check = Callable[[Sequence[Model]], Sequence[str | None]]


def deal(models: Sequence[Model], settings: SynthesisSettings, check: Check) -> dict[str, Dealt]:
    """Draw models and assign them to the splits, separately for each category.

    The models are shuffled by the seed and checked in that order until enough are usable. With fewer usable
    models than requested, every split shrinks in proportion. The paper says only "randomly selected".

    Args:
        models: the models, sorted.
        settings: `seed` and the numbers of models per category and split are used.
        check: function that returns for each of some models why it cannot be used, or None if it can.

    Returns:
        {category: its models with their splits}, sorted by category.
    """
    wanted = sum(settings.wanted.values())
    waiting = {name: _shuffled(models, name, settings.seed) for name in sorted({m.category for m in models})}
    good: dict[str, list[Model]] = {category: [] for category in waiting}
    bad: dict[str, list[LeftOut]] = {category: [] for category in waiting}
    while batch := [m for name, order in waiting.items() for m in order[: wanted - len(good[name])]]:
        for model, reason in zip(batch, check(batch), strict=True):
            waiting[model.category].remove(model)
            if reason is None:
                good[model.category].append(model)
            else:
                bad[model.category].append(LeftOut(model.label, reason))
    dealt = {}
    for name, models_here in good.items():
        counts = shares(settings.wanted, len(models_here))
        splits = [split for split, count in counts.items() for _ in range(count)]
        split_of = dict(zip(models_here, splits, strict=True))
        dealt[name] = Dealt(split_of, tuple(sorted(bad[name])), len(waiting[name]))
    return dealt


def _shuffled(models: Sequence[Model], category: str, seed: int) -> list[Model]:
    """Return the models of one category in an order drawn by the seed."""
    chosen = [model for model in models if model.category == category]
    return [chosen[n] for n in np.random.default_rng([seed, *category.encode()]).permutation(len(chosen))]


def shares(wanted: dict[Split, int], available: int) -> dict[Split, int]:
    """Return {split: number of models}: as requested, or if fewer are available, reduced in proportion.

    Every requested split gets at least one model. If there are fewer models than splits, test comes first,
    then train.
    """
    total = sum(wanted.values())
    if available >= total:
        return dict(wanted)
    asked = [split for split in PRIORITY if wanted[split]]
    if available < len(asked):
        return {split: int(split in asked[:available]) for split in wanted}
    exact = {split: available * count / total for split, count in wanted.items()}
    counts = {split: max(int(exact[split]), min(1, wanted[split])) for split in wanted}
    while sum(counts.values()) < available:
        counts[max(asked, key=lambda split: exact[split] - counts[split])] += 1
    while sum(counts.values()) > available:
        counts[max((s for s in asked if counts[s] > 1), key=lambda split: counts[split] - exact[split])] -= 1
    return counts
