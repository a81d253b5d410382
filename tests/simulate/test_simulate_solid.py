"""Parts and furniture: closed, convex, standing on the floor, and exact to test for inside."""

from collections import Counter

import numpy as np
import pytest

from kinectbench.errors import SettingsError
from kinectbench.simulate.furniture import FAMILIES, make_object, parse_object
from kinectbench.simulate.solid import Mesh, Part, Solid, outline_points


def signed_volume_m3(mesh: Mesh) -> float:
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    return float(np.sum(a * np.cross(b, c)) / 6)


def assert_closed(mesh: Mesh) -> None:
    edges = np.concatenate([mesh.triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    count = Counter(map(tuple, edges.tolist()))
    assert all(count[(b, a)] == n == 1 for (a, b), n in count.items())


@pytest.mark.parametrize("outline", ["rectangle", "rounded", "ellipse"])
def test_a_part_is_closed_and_its_planes_touch_its_vertices(outline):
    part = Part("p", outline, (0.4, 0.2), (0, 0, 0.1), (0.05, -0.1, 0.6), 0.7, yaw_rad=0.3)
    mesh, planes = part.mesh(), part.planes()
    assert_closed(mesh)
    assert signed_volume_m3(mesh) > 0
    height_m = mesh.vertices @ planes[:, :3].T + planes[:, 3]
    assert height_m.max() < 1e-12
    assert np.all(np.sum(np.abs(height_m) < 1e-12, axis=0) >= 4)


def test_a_box_has_its_volume_and_its_inside():
    part = Part("p", "rectangle", (0.4, 0.2), (0, 0, 0.0), (0, 0, 0.5))
    assert signed_volume_m3(part.mesh()) == pytest.approx(0.04)
    points = np.array([[0.19, 0.09, 0.01], [0.21, 0, 0.1], [0, 0.11, 0.1], [0, 0, 0.51], [0.2, 0.1, 0.5]])
    assert Solid((part,)).contains(points).tolist() == [True, False, False, False, True]


def test_outlines_have_their_size():
    for outline in ("rectangle", "rounded", "ellipse"):
        points = outline_points(outline, (0.6, 0.3))
        assert np.allclose(np.ptp(points, axis=0), [0.6, 0.3])


def test_a_part_survives_json():
    part = Part("leg", "ellipse", (0.04, 0.04), (0, 0, 0), (0.1, 0, 0.4), 1.2, 0.5, (0.1, 0.2, 0.3))
    assert Part.from_json(part.to_json()) == part


@pytest.mark.parametrize("family", FAMILIES)
def test_furniture_stands_on_the_floor_and_varies(family):
    solids = [make_object(family, seed) for seed in range(30)]
    assert len({solid.parts for solid in solids}) == 30
    assert make_object(family, 7) == solids[7]
    for solid in solids:
        low, high = solid.bounds_m()
        assert low[2] == pytest.approx(0, abs=1e-9)
        assert np.allclose((low + high)[:2], 0, atol=1e-9)
        assert 0.35 < high[2] < 1.15
        assert np.all(high - low < 1.6)


@pytest.mark.parametrize("family", FAMILIES)
def test_no_part_is_thinner_than_25_mm_and_none_hangs_in_the_air(family):
    for seed in range(20):
        solid = make_object(family, seed)
        for part in solid.parts:
            height = part.top_m[2] - part.bottom_m[2]
            assert min(*part.size_m, height) * min(1, part.top_scale) > 0.0249, (seed, part)
        assert connected(solid), seed


def connected(solid: Solid) -> bool:
    """Whether the parts hang together: sampled points of one lie inside another, transitively."""
    samples = []
    for part in solid.parts:
        bottom, top = part.rings()
        share = np.linspace(0, 1, 41)[:, None, None]
        shells = [
            c * (1 - f) + f * r for r, c in ((bottom, bottom.mean(0)), (top, top.mean(0))) for f in (0.5, 1)
        ]
        samples.append(
            np.concatenate([shells[k] * (1 - share) + shells[k + 2] * share for k in (0, 1)]).reshape(-1, 3)
        )
    n = len(solid.parts)
    touches = np.array(
        [[Solid((solid.parts[i],)).contains(samples[j]).any() for j in range(n)] for i in range(n)]
    )
    reached = np.eye(n, dtype=bool)[0]
    for _ in range(n):
        reached = reached | touches[reached].any(axis=0) | touches[:, reached].any(axis=1)
    return bool(reached.all())


def test_parse_object():
    assert parse_object("chair:seed=3") == ("chair", 3)
    assert parse_object("table") == ("table", 0)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("chiar:seed=3", "did you mean 'chair'"),
        ("chair:sed=3", "such as chair:seed=3"),
        ("chair:seed=-1", "such as chair:seed=3"),
        ("", "such as chair:seed=3"),
    ],
)
def test_parse_object_refuses(text, says):
    with pytest.raises(SettingsError, match=says):
        parse_object(text)
