"""The connected pieces of a mesh."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from kinectbench.core.geometry.pieces import pieces_of


def test_pieces_are_those_of_the_graph_of_edges() -> None:
    for faces, vertices in ((1, 3), (60, 200), (120, 400)):
        corners = np.random.default_rng(faces).integers(0, vertices, (faces, 3)).astype(np.int32)
        ends = np.concatenate([corners[:, :2], corners[:, 1:]])
        joins = coo_array((np.ones(len(ends)), tuple(ends.T)), shape=(vertices, vertices))
        expected = connected_components(joins, directed=False)[1][corners[:, 0]]
        found = pieces_of(corners, vertices)
        pairs = set(zip(found.tolist(), expected.tolist(), strict=True))
        assert len(pairs) == len(set(expected.tolist())) == len(set(found.tolist()))
        assert faces == 1 or len(pairs) > 1
