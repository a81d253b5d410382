"""Which models there are: a folder of CAD meshes, or the parametric families."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from kinectbench.config import NAME
from kinectbench.errors import SettingsError

# The categories of the paper, by their ShapeNet synsets; ShapeNet's sofa is the paper's couch.
SYNSETS = {
    "02828884": "bench",
    "03001627": "chair",
    "04256520": "couch",
    "04379243": "table",
    "02958343": "car",
    "03325088": "faucet",
    "04090263": "firearm",
    "03467517": "guitar",
    "03211117": "monitor",
    "02691156": "plane",
}
NO_SYNSET = "00000000"
# Where ShapeNet v2 and v1 keep a model's mesh, in the model's folder.
MESHES = ("models/model_normalized.obj", "model_normalized.obj", "model.obj")
SUFFIXES = (".obj", ".ply", ".stl", ".off", ".glb")
# `<model>-sv` and `<model>-cv` are names of recordings.
LONGEST_NAME = 77


@dataclass(frozen=True, order=True)
class Model:
    """One thing to be seen from everywhere.

    Attributes:
        category: such as "chair".
        name: unique among all; a name for files.
        path: its mesh file; "" if it is parametric.
        seed: of the parametric family `category`; -1 if it is a file.
    """

    category: str
    name: str
    path: str = ""
    seed: int = -1

    @property
    def label(self) -> str:
        """`<category>/<name>`, what messages call it."""
        return f"{self.category}/{self.name}"


@dataclass(frozen=True, order=True)
class LeftOut:
    """A model that is not used, and why, in a few words."""

    model: str
    reason: str


def synset_of(category: str) -> str:
    """The ShapeNet synset of a category; "00000000" if it is none of the paper's."""
    return next((synset for synset, name in SYNSETS.items() if name == category), NO_SYNSET)


def family_models(categories: Sequence[str], count: int) -> tuple[Model, ...]:
    """Parametric furniture: seeds 0 to count - 1 of every family.

    Raises:
        SettingsError: there is no such family.
    """
    from kinectbench.simulate.objects.furniture import FAMILIES, check_family

    names = sorted(check_family(name) for name in categories or FAMILIES)
    return tuple(Model(name, f"{name}-{seed:05d}", seed=seed) for name in names for seed in range(count))


def folder_models(folder: Path, categories: Sequence[str]) -> tuple[tuple[Model, ...], tuple[LeftOut, ...]]:
    """The models in a folder, sorted, and what is left out at first sight.

    Layouts: `<synset>/<model>/models/model_normalized.obj` (ShapeNet v2), `<synset>/<model>/model.obj` (v1),
    `<category>/<name>.obj` (or .ply, .stl, .off, .glb); any of them with a synset or a category's name.

    Raises:
        SettingsError: no folder there, no category in it, or not those asked for.
    """
    if not folder.is_dir():
        raise SettingsError(f"{folder}: no folder of models there; give one with --models")
    found = {SYNSETS.get(path.name, path.name): path for path in sorted(folder.iterdir()) if path.is_dir()}
    missing = [name for name in categories if name not in found]
    if missing or not found:
        there = ", ".join(found) or "no category's folder"
        raise SettingsError(f"{folder}: no {', '.join(missing) or 'models'} there; it holds {there}")
    models: dict[str, Model] = {}
    left_out = []
    for category in sorted(categories or found):
        for entry in _entries(category, found[category]):
            if isinstance(entry, LeftOut):
                left_out.append(entry)
            elif entry.name in models:
                other = models[entry.name].category
                left_out.append(LeftOut(entry.label, f"the same name as a model of {other}"))
            else:
                models[entry.name] = entry
    return tuple(sorted(models.values())), tuple(left_out)


def _entries(category: str, folder: Path) -> Iterator[Model | LeftOut]:
    """The models of one category's folder."""
    if not NAME.fullmatch(category):
        yield LeftOut(folder.name, "a category needs a name of letters, digits, '.', '_' and '-'")
        return
    for path in sorted(folder.iterdir()):
        if path.is_dir():
            mesh = next((path / name for name in MESHES if (path / name).is_file()), None)
            model = Model(category, path.name, str(mesh or ""))
        elif path.suffix.lower() in SUFFIXES:
            model = Model(category, path.stem, str(path))
        else:
            continue  # materials, textures, lists
        if not NAME.fullmatch(model.name) or len(model.name) > LONGEST_NAME:
            yield LeftOut(
                replace(model, name=path.name).label, "its name is not made of letters, digits, '.', '_', '-'"
            )
        else:
            yield model if model.path else LeftOut(model.label, "no mesh file in its folder")
