"""Finding, checking and dealing models: layouts, every kind of bad mesh, proportions."""

from collections import Counter
from collections.abc import Sequence as Rows
from pathlib import Path

import numpy as np
import pytest
import trimesh
from raising import raises
from synthesis_shapes import asymmetric, mesh_of, open_box, write_shapenet

from kinectbench.core.errors import SettingsError, ShapeError
from kinectbench.core.geometry import TriangleMesh
from kinectbench.core.storage import name_problem
from kinectbench.lab.synthesize.mesh_check import check_mesh, load_model, missing_materials
from kinectbench.lab.synthesize.models import (
    LeftOut,
    Model,
    SynthesisSettings,
    deal,
    family_models,
    folder_models,
    shares,
)
from kinectbench.release.exchange.layouts import synset_of

BOX = mesh_of(trimesh.creation.box([0.5, 0.4, 0.3]))


def test_shapenet_layouts(tmp_path: Path) -> None:
    models, left_out = folder_models(write_shapenet(tmp_path), ())
    assert [model.label for model in models] == [
        "chair/c0", "chair/c1", "chair/c2", "table/t0", "table/t1", "table/t2"
    ]  # fmt: skip
    assert models[0].path.endswith("03001627/c0/models/model_normalized.obj") and left_out == ()
    assert [model.category for model in folder_models(tmp_path, ["table"])[0]] == ["table"] * 3


def test_a_category_by_its_synset_and_by_its_name_is_one(tmp_path: Path) -> None:
    write_shapenet(tmp_path, 2, 1)
    (tmp_path / "chair").mkdir()
    for name in ("mine", "c1"):
        asymmetric().export(tmp_path / "chair" / f"{name}.obj")
    for chosen in ((), ("chair",)):
        models, left_out = folder_models(tmp_path, chosen)
        assert [m.label for m in models if m.category == "chair"] == ["chair/c0", "chair/c1", "chair/mine"]
        assert left_out == (LeftOut("chair/c1", "the same name as a model of chair"),)


@pytest.mark.parametrize("suffix", ["obj", "ply", "stl", "off", "glb"])
def test_flat_folders(suffix: str, tmp_path: Path) -> None:
    (tmp_path / "stool").mkdir()
    asymmetric().export(tmp_path / "stool" / f"one.{suffix}")
    (tmp_path / "stool" / "notes.txt").write_text("no mesh")
    ((model,), left_out) = folder_models(tmp_path, ())
    assert (model.category, model.name, left_out) == ("stool", "one", ())
    checked = load_model(model, 1000)
    assert (checked.rule, len(checked.mesh.faces)) == ("winding", 48)
    assert checked.mesh.volume_m3 == pytest.approx(asymmetric().volume, rel=1e-5)


def test_what_is_left_out_at_first_sight(tmp_path: Path) -> None:
    write_shapenet(tmp_path, 1, 1)
    (tmp_path / "03001627" / "empty").mkdir()
    (tmp_path / "02828884").mkdir()
    asymmetric().export(tmp_path / "02828884" / "t0.obj")
    asymmetric().export(tmp_path / "02828884" / "a b.obj")
    models, left_out = folder_models(tmp_path, ())
    assert [model.label for model in models] == ["bench/t0", "chair/c0"]
    assert sorted(left_out) == [
        LeftOut("bench/a b.obj", f"its name: {name_problem('a b')}"),
        LeftOut("chair/empty", "no mesh file in its folder"),
        LeftOut("table/t0", "the same name as a model of bench"),
    ]


def test_no_models(tmp_path: Path) -> None:
    with raises(SettingsError, "settings.no-file", match="no folder"):
        folder_models(tmp_path / "none", ())
    with raises(SettingsError, "settings.no-file", match="no models"):
        folder_models(tmp_path, ())
    with raises(SettingsError, "settings.no-file", match="chair, table"):
        folder_models(write_shapenet(tmp_path), ["sofa"])


def test_families_and_synsets() -> None:
    models = family_models(["table", "chair"], 2)
    assert [model.label for model in models] == [
        "chair/chair-00000", "chair/chair-00001", "table/table-00000", "table/table-00001"
    ]  # fmt: skip
    # Without a word, furniture only, whatever else the simulator can draw.
    assert [model.category for model in family_models([], 1)] == ["bench", "chair", "couch", "table"]
    with raises(SettingsError, "settings.wrong-value", match="'chair'"):
        family_models(["chari"], 1)
    assert (synset_of("couch"), synset_of("stool")) == ("04256520", "00000000")


def test_closed_meshes_are_filled_by_winding() -> None:
    assert check_mesh(mesh_of(asymmetric()), 100).rule == "winding"
    soup = BOX.vertices[BOX.faces].reshape(-1, 3)  # every triangle with vertices of its own
    loose = check_mesh(TriangleMesh(soup, np.arange(36, dtype=np.int32).reshape(-1, 3)), 100)
    assert (loose.rule, len(loose.mesh.vertices)) == ("winding", 8)
    assert loose.mesh.volume_m3 == pytest.approx(0.06)
    # Two boxes that share an edge: four faces there, and still every point is in or out.
    pair = trimesh.util.concatenate(
        [
            trimesh.creation.box(bounds=[[0, 0, 0], [1, 1, 1]]),
            trimesh.creation.box(bounds=[[1, 1, 0], [2, 2, 1]]),
        ]
    )
    assert check_mesh(mesh_of(pair), 100).rule == "winding"


def test_other_meshes_are_filled_by_the_authors_rule() -> None:
    assert check_mesh(mesh_of(open_box()), 100).rule == "six-rays"
    flipped = BOX.faces.copy()
    flipped[3] = flipped[3][::-1]
    assert check_mesh(TriangleMesh(BOX.vertices, flipped), 100).rule == "six-rays"
    doubled = TriangleMesh(BOX.vertices, np.concatenate([BOX.faces, BOX.faces[:, ::-1]]))
    assert check_mesh(doubled, 100).rule == "six-rays"


@pytest.mark.parametrize(
    ("mesh", "reason"),
    [
        (TriangleMesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32)), "it is empty"),
        (TriangleMesh(BOX.vertices, np.zeros((0, 3), np.int32)), "it is empty"),
        (TriangleMesh(np.where(BOX.vertices > 0.2, np.nan, BOX.vertices), BOX.faces), "not a finite number"),
        (TriangleMesh(np.where(BOX.vertices > 0.2, np.inf, BOX.vertices), BOX.faces), "not a finite number"),
        (TriangleMesh(BOX.vertices * [1, 0, 0], BOX.faces), "no triangle has an area"),
        (TriangleMesh(BOX.vertices, BOX.faces[:, ::-1]), "it is inside out"),
        (TriangleMesh(BOX.vertices, BOX.faces + 1), "names a vertex that is not there"),
        (TriangleMesh(BOX.vertices + 2e4, BOX.faces), r"steps of 0\.0024 of its unit; move it to its origin"),
        (mesh_of(trimesh.creation.icosphere(2)), "320 faces, more than 100"),
    ],
)
def test_bad_meshes(mesh: TriangleMesh, reason: str) -> None:
    with raises(ShapeError, "shape.bad-mesh", match=reason):
        check_mesh(mesh, 100)


def test_collapsed_triangles_are_noted() -> None:
    faces = np.concatenate([BOX.faces, [[1, 1, 2]]]).astype(np.int32)
    checked = check_mesh(TriangleMesh(BOX.vertices, faces), 100)
    assert (checked.rule, len(checked.mesh.faces)) == ("winding", 12)
    assert checked.notes == ("1 triangles with two corners at one place left out",)


@pytest.mark.parametrize("content", [b"", b"\x00\x01\x02", b"v 1 2\nf 1 2 3\n", b"v a b c\nf 1 1 1\n"])
@pytest.mark.parametrize("suffix", ["obj", "ply", "stl", "off", "glb"])
def test_unreadable_files(content: bytes, suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"bad.{suffix}"
    path.write_bytes(content)
    with pytest.raises(ShapeError) as error:
        load_model(Model("chair", "bad", str(path)), 100)
    assert "\n" not in str(error.value)


def test_missing_materials_are_noted(tmp_path: Path) -> None:
    path = tmp_path / "model.obj"
    asymmetric().export(path)
    text = "\n".join(line for line in path.read_text().splitlines() if not line.startswith("mtllib"))
    path.write_text(f"mtllib gone.mtl\nmtllib here.mtl\n{text}\n")
    (tmp_path / "here.mtl").write_text("newmtl a\nmap_Kd wood.png\nnewmtl b\nmap_Kd wood.png\n")
    checked = load_model(Model("chair", "model", str(path)), 100)
    assert checked.rule == "winding" and checked.notes == (
        "material gone.mtl is missing; the shape is whole",
        "texture wood.png is missing; the shape is whole",
    )


def test_options_of_textures_are_no_names(tmp_path: Path) -> None:
    """And lines may be indented; a name may have spaces, or begin as an option does."""
    (tmp_path / "model.obj").write_text("  mtllib here.mtl\n")
    names = ["wood.png", "my wood.png", "-s.png"]
    lines = [
        "-s 1 2.5 -1e-3 -cc on wood.png",
        "-type sphere -imfchan r my wood.png",
        "-s.png",
        "gone.png",
    ]
    (tmp_path / "here.mtl").write_text("".join(f"\tmap_Kd {line}\n" for line in lines))
    for name in names:
        (tmp_path / name).touch()
    assert missing_materials(tmp_path / "model.obj") == ("texture gone.png is missing; the shape is whole",)


@pytest.mark.parametrize("name", ["x" * 300, "a\0b", "y/" * 3000, "."], ids=lambda name: ascii(name[:3]))
def test_materials_that_no_disk_can_hold_are_missing(name: str, tmp_path: Path) -> None:
    path = tmp_path / "model.obj"
    asymmetric().export(path, include_texture=False, header=None)
    path.write_text(f"mtllib {name}\nmtllib here.mtl\n{path.read_text()}")
    (tmp_path / "here.mtl").write_text(f"newmtl a\nmap_Kd {name}\n")
    notes = load_model(Model("chair", "model", str(path)), 100).notes
    assert [note.split()[0] for note in notes] == ["material", "texture"]
    assert all(note.isprintable() and len(note) < 400 for note in notes)


@pytest.mark.parametrize(
    ("available", "expected"),
    [
        (272, (220, 12, 40)),
        (999, (220, 12, 40)),
        (136, (110, 6, 20)),
        (8, (6, 1, 1)),
        (3, (1, 1, 1)),
        (2, (1, 0, 1)),
        (1, (0, 0, 1)),
        (0, (0, 0, 0)),
    ],
)
def test_shares(available: int, expected: tuple[int, int, int]) -> None:
    counts = shares({"train": 220, "validation": 12, "test": 40}, available)
    assert tuple(counts.values()) == expected


def test_a_split_that_nobody_asked_for_stays_empty() -> None:
    assert shares({"train": 0, "validation": 1, "test": 9}, 5) == {"train": 0, "validation": 1, "test": 4}


def models_of(category: str, count: int) -> list[Model]:
    return [Model(category, f"{category}{n:02d}", "x") for n in range(count)]


def test_bad_models_are_replaced_while_there_are_others() -> None:
    models = models_of("chair", 20) + models_of("table", 4)
    settings = SynthesisSettings(train=4, validation=2, test=2)
    asked: list[Model] = []

    def check(batch: Rows[Model]) -> list[str | None]:
        asked.extend(batch)
        return ["bad" if model.name.endswith(("1", "2", "3")) else None for model in batch]

    dealt = deal(models, settings, check)
    chairs, tables = dealt["chair"], dealt["table"]
    assert Counter(chairs.split_of.values()) == {"train": 4, "validation": 2, "test": 2}
    assert Counter(tables.split_of.values()) == {"test": 1} and len(tables.left_out) == 3
    assert not any(model.name.endswith(("1", "2", "3")) for model in chairs.split_of)
    assert len(chairs.split_of) + len(chairs.left_out) + chairs.unused == 20
    assert len(asked) == len(set(asked)) == 24 - chairs.unused


def test_the_seed_draws_the_models_and_nothing_else_does() -> None:
    models = models_of("chair", 30)
    good = lambda batch: [None] * len(batch)  # noqa: E731
    settings = SynthesisSettings(train=3, validation=1, test=2)
    one = deal(models, settings, good)["chair"].split_of
    assert one == deal(models + models_of("table", 9), settings, good)["chair"].split_of
    other = deal(models, settings.model_copy(update={"seed": 1}), good)["chair"].split_of
    assert one != other
