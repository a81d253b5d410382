"""The closed solid shape, its labels and its quality."""

from kinectbench.shape.object_model import ObjectModel, build_object

__all__ = ["ObjectModel", "build_object"]
