"""Open3D is loaded without dash and plotly, and its plots work all the same."""

import subprocess
import sys

SCRIPT = """
import sys
import numpy as np
from kinectbench.core.geometry.mesh import isosurface
isosurface(np.linalg.norm(np.indices((5, 5, 5)) - 2.0, axis=0).astype(np.float32), level=1.0)
assert "open3d" in sys.modules and not {"dash", "plotly"} & set(sys.modules)
import inspect
assert inspect.getsource(isosurface).startswith("def isosurface")  # which asks every module for its file
import open3d
print(type(open3d.visualization.get_plotly_fig([open3d.geometry.TriangleMesh.create_box()])).__name__)
"""


def test_plots_are_loaded_on_their_first_call() -> None:
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=False)
    assert (done.stdout.strip(), done.stderr) == ("Figure", "")
