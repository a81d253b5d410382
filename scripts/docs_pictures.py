"""Make the tutorial's text and pictures of one run of its own commands on simulated recordings.

    .venv/bin/python scripts/docs_pictures.py [WORK]

WORK, a new folder, keeps what was made. Pages are photographed with chromium, which must be installed.
docs_tutorial.py runs the commands and puts what they print into the text.
"""

import base64
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
from docs_tutorial import BIN, NAME, PICTURES, keep, run_all
from numpy.typing import NDArray

from kinectbench.core import images, pictures
from kinectbench.core.geometry import TriangleMesh
from kinectbench.core.geometry.mesh import read_own_ply
from kinectbench.core.types import Rgb
from kinectbench.core.voxels.pair_file import read_pair

QUALITY = 80
TILE_PX = 240
GAP_PX = 6
AROUND_M = 1.25
INK, SOFT, GOOD, BAD = "#1f2328", "#8a8f98", "#0072b2", "#d55e00"


def main() -> None:
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        sys.exit("docs_pictures.py: no chromium: install it, so that pages are of the same run as all else")
    with tempfile.TemporaryDirectory() as temporary:
        work = Path(sys.argv[1] if len(sys.argv) > 1 else temporary).resolve()
        if work.is_dir() and any(work.iterdir()):
            sys.exit(f"{work}: not empty; name a new folder, so that all is of one run")
        outputs = run_all(work)
        root = work / NAME
        build = root / "build" / NAME
        draw_walk(PICTURES / "walk.svg")
        save("frames", recorded(build / "sequence"))
        save("mesh", scene(build))
        save("object", solid(build))
        save("unseen", unseen(work / BIN / "build" / BIN / "object"))
        save("views", views(build / "views"))
        save("pairs", pairs(build))
        shutil.copyfile(build / "trajectory" / "trajectory.png", PICTURES / "trajectory.png")
        shutil.copyfile(build / "candidates" / "plan.png", PICTURES / "candidates.png")
        photograph(browser, root / "inspect.html", 900, {"inspect": (0, 980)})
        # By eye: the head with the first table, and the first card of the gallery.
        photograph(
            browser, root / "scores" / "index.html", 1100, {"page": (0, 1090), "gallery": (3310, 4362)}
        )
        keep(outputs, work)
    total = sum(path.stat().st_size for path in PICTURES.iterdir())
    sys.stdout.write(f"{PICTURES}: {total / 1e6:.2f} MB\n")


def save(name: str, picture: Rgb) -> None:
    path = PICTURES / f"{name}.jpg"
    cv2.imwrite(str(path), np.ascontiguousarray(picture[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, QUALITY])


def sheet(tiles: Sequence[Rgb], columns: int) -> Rgb:
    """Pictures of one size side by side, on paper."""
    height, width = tiles[0].shape[:2]
    rows = -(-len(tiles) // columns)
    whole = np.full(
        (rows * (height + GAP_PX) - GAP_PX, columns * (width + GAP_PX) - GAP_PX, 3), 255, np.uint8
    )
    for number, tile in enumerate(tiles):
        y, x = number // columns * (height + GAP_PX), number % columns * (width + GAP_PX)
        whole[y : y + height, x : x + width] = tile
    return whole


def recorded(sequence: Path) -> Rgb:
    """Colour above depth of some frames all around."""
    from kinectbench.stages.ingest.sequence_folder import read_sequence

    frames = read_sequence(sequence)
    chosen = np.linspace(0, 0.8 * len(frames), 5).astype(int)
    color = [frames.color_rgb(i) for i in chosen]
    depth = [images.depth_picture((1000 * frames.depth_m(i)).astype(np.uint16)) for i in chosen]
    return sheet([images.shrunk(p, TILE_PX) for p in (*color, *depth)], 5)


def scene(build: Path) -> Rgb:
    """The fused scene around the object, from two sides."""
    T = np.array(json.loads((build / "object" / "floor.json").read_text())["T_floor_world"])
    whole, thing = (floor_mesh(build / name, T) for name in ("reconstruction/mesh.ply", "object/mesh.ply"))
    centre = (thing.vertices.min(axis=0) + thing.vertices.max(axis=0)) / 2
    near = np.linalg.norm((whole.vertices - centre)[:, :2], axis=1) < AROUND_M
    cut = TriangleMesh(whole.vertices, whole.faces[near[whole.faces].all(axis=1)])
    return around(cut, whole.vertices[near], (-50.0, 130.0), 30.0)


def solid(build: Path) -> Rgb:
    """The closed mesh, from three sides."""
    T = np.array(json.loads((build / "object" / "floor.json").read_text())["T_floor_world"])
    thing = floor_mesh(build / "object" / "mesh.ply", T)
    return around(thing, thing.vertices, (-50.0, 70.0, 190.0), 24.0)


def unseen(folder: Path) -> Rgb:
    """An object from three sides and from where one would look into it, as `report` draws it."""
    from kinectbench.core.artefacts.object import QualityFile
    from kinectbench.core.artefacts.object_grids import ObjectVolume, unmeasured_faces
    from kinectbench.report.recording import object_pictures

    T = np.array(json.loads((folder / "floor.json").read_text())["T_floor_world"])
    mesh = read_own_ply(folder / "mesh.ply")
    volume = ObjectVolume.read(folder)
    faces = unmeasured_faces(mesh, volume.grid, volume.labels)
    drawn = object_pictures(mesh.transformed(T), faces, QualityFile.read(folder).frontiers)
    content = [np.frombuffer(base64.b64decode(each.picture.partition(",")[2]), np.uint8) for each in drawn]
    return sheet([cv2.imdecode(each, cv2.IMREAD_COLOR)[..., ::-1] for each in content], len(content))


def floor_mesh(path: Path, T_floor_world: NDArray[np.float64]) -> TriangleMesh:
    """A mesh of the world, in the frame `floor`: z up."""
    return read_own_ply(path).transformed(T_floor_world)


def around(
    mesh_floor: TriangleMesh,
    fitted_m: NDArray[np.float64],
    azimuths_deg: Sequence[float],
    elevation_deg: float,
) -> Rgb:
    """A mesh from several sides; each picture just holds the fitted points."""
    looks = pictures.viewpoints_around(fitted_m, [(azimuth, elevation_deg) for azimuth in azimuths_deg])
    tiles = [pictures.render(mesh_floor, look, 380) for look in looks]
    return sheet(tiles, len(tiles))


def views(folder: Path) -> Rgb:
    """Some views with the object's mask."""
    rows = json.loads((folder / "views.json").read_text())["views"]
    tiles = []
    for row in [rows[i] for i in np.linspace(0, len(rows) - 1, 10).astype(int)]:
        color = images.read_color(folder / f"{row['view']}.color.jpg")
        mask = images.read_gray(folder / f"{row['view']}.mask.png") > 0
        tiles.append(images.shrunk(images.overlay_mask(color, mask), TILE_PX))
    return sheet(tiles, 5)


def pairs(build: Path) -> Rgb:
    """Three pairs: partial (blue) above the full shape, as `report` draws them, larger."""
    from kinectbench.report import page_pictures

    page_pictures.TILE_PX = 300
    plane = json.loads((build / "object" / "floor.json").read_text())["plane_world"]
    tiles = []
    for path in sorted((build / "pairs").glob("*.npz"))[::17][:3]:
        pair = read_pair(path)
        up_grid = pair.T_world_grid[:3, :3].T @ np.array(plane[:3])
        drawn = page_pictures.pair_picture(pair.partial, pair.full, pair.voxel_size_m, up_grid)
        tiles.append(np.concatenate([drawn[:, :300], drawn[:, 300:]], axis=0))
    return sheet(tiles, 3)


def photograph(browser: str, page: Path, width: int, cuts: Mapping[str, tuple[int, int]]) -> None:
    """A page as chromium shows it: each name is a picture from one row of pixels to another."""
    height = max(bottom for _, bottom in cuts.values())
    with tempfile.TemporaryDirectory() as folder:
        shot = Path(folder) / "shot.png"
        options = ["--headless", "--no-sandbox", "--hide-scrollbars", "--virtual-time-budget=15000"]
        options += ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]  # 3-D without a graphics card
        words = [browser, *options, f"--window-size={width},{height}", f"--screenshot={shot}", page.as_uri()]
        subprocess.run(words, check=True, capture_output=True)
        whole = cv2.imread(str(shot))[..., ::-1]
        for name, (top, bottom) in cuts.items():
            save(name, whole[top:bottom])


def draw_walk(path: Path) -> None:
    """How to walk: from above and from the side."""
    import matplotlib

    matplotlib.use("svg")
    matplotlib.rcParams["svg.hashsalt"] = "walk"
    from matplotlib import pyplot as plt
    from matplotlib.patches import Circle, Rectangle

    figure, (above, side) = plt.subplots(1, 2, figsize=(9, 3.9), width_ratios=(1, 1.15))
    angles = np.linspace(0, 2.25 * np.pi, 200)
    radius = 1.5 - 0.06 * np.linspace(0, 1, 200)
    above.plot(radius * np.cos(angles), radius * np.sin(angles), color=GOOD, linewidth=2)
    for angle in np.deg2rad(np.arange(0, 360, 45)):
        start, end = (
            1.47 * np.array([np.cos(angle), np.sin(angle)]),
            1.12 * np.array([np.cos(angle), np.sin(angle)]),
        )
        above.annotate("", end, start, arrowprops={"arrowstyle": "->", "color": SOFT})
    above.add_patch(Rectangle((-0.25, -0.25), 0.5, 0.5, color="#cdbaa0"))
    above.add_patch(Circle((0, 0), 1.0, fill=False, linestyle=":", color=SOFT))
    above.text(0, 0, "chair", ha="center", va="center", fontsize=9, color=INK)
    above.text(0, 0.62, "1 m of floor kept free", ha="center", fontsize=8, color=SOFT)
    above.text(
        0,
        -2.02,
        "once all the way round and a little more,\nlooking at the chair; 30 to 60 seconds",
        ha="center",
        fontsize=9,
        color=INK,
    )
    above.set(xlim=(-1.9, 1.9), ylim=(-2.1, 1.75), aspect="equal", title="from above")

    side.plot([-0.3, 2.6], [0, 0], color=INK, linewidth=1.5)
    for box in (
        (-0.25, 0.4, 0.5, 0.06),
        (-0.25, 0, 0.05, 0.4),
        (0.2, 0, 0.05, 0.4),
        (-0.25, 0.46, 0.05, 0.45),
    ):
        side.add_patch(Rectangle(box[:2], *box[2:], color="#cdbaa0"))
    for x, y, words in (
        (1.5, 1.45, "first half: chest height"),
        (1.5, 0.6, "second half: knee height, to see\nunder seat and table tops"),
    ):
        side.annotate(
            "", (0.25, 0.5), (x, y), arrowprops={"arrowstyle": "->", "color": GOOD, "linewidth": 1.6}
        )
        side.add_patch(Rectangle((x, y - 0.05), 0.2, 0.1, color=GOOD))
        side.text(x + 0.28, y, words, va="center", fontsize=9, color=INK)
    side.annotate("", (0.25, -0.14), (1.5, -0.14), arrowprops={"arrowstyle": "<->", "color": SOFT})
    side.text(0.87, -0.3, "0.8 to 2.5 m", ha="center", fontsize=9, color=INK)
    side.set(xlim=(-0.5, 3.4), ylim=(-0.45, 1.9), aspect="equal", title="from the side")
    for axes in (above, side):
        axes.axis("off")
    figure.tight_layout()
    figure.savefig(path, metadata={"Date": None, "Creator": None})
    plt.close(figure)


if __name__ == "__main__":
    main()
