"""Optional modules, and the extra that installs each."""

from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec

from kinectbench.core.errors import SettingsError

# Top-level module -> extra of pyproject.toml.
EXTRA_OF: Mapping[str, str] = {
    **dict.fromkeys(("cv2", "fast_simplification", "lz4", "manifold3d", "matplotlib"), "build"),
    **dict.fromkeys(("open3d", "rosbags", "trimesh", "zstandard"), "build"),
    **dict.fromkeys(("distributed", "obstore"), "cluster"),
    "av": "azure",
    "freenect": "record-kinect",
    "h5py": "ycb",
    "huggingface_hub": "hub",
    "imagecodecs": "record3d",
    "openni": "record-openni",
    "pyarrow": "tables",
    "pyk4a": "record-azure",
    "pyorbbecsdk": "record-orbbec",
    "pyrealsense2": "record-realsense",
    "record3d": "record-iphone",
    "torch": "methods",
}
# A package -> another distribution with the same modules (pyproject.toml installs one of the two).
SAME_MODULES: Mapping[str, str] = {"open3d": "open3d-cpu"}


def package_version(package: str) -> str | None:
    """Version of an installed package, under any of its distribution names; None if it is not installed."""
    for name in (package, SAME_MODULES.get(package, package)):
        try:
            return version(name)
        except PackageNotFoundError:
            continue
    return None


def missing_module(error: ModuleNotFoundError) -> str | None:
    """Advice to install the extra that provides a missing module; None if no extra provides it."""
    module = (error.name or "").partition(".")[0]
    return _advice([module], EXTRA_OF[module]) if module in EXTRA_OF else None


def missing_extra(extra: str) -> str | None:
    """Advice if a module of an extra is not installed; None if all are."""
    missing = [module for module, of in EXTRA_OF.items() if of == extra and find_spec(module) is None]
    return _advice(missing, extra) if missing else None


def require_extra(extra: str, needed_by: str = "") -> None:
    """Refuse to go on if a module of an extra is not installed; the message begins with `needed_by`.

    Raises:
        SettingsError: with advice on how to install it.
    """
    if missing := missing_extra(extra):
        raise SettingsError(f"{needed_by}: {missing}" if needed_by else missing, what="no-package")


def _advice(modules: list[str], extra: str) -> str:
    more = f" and {len(modules) - 1} more" if len(modules) > 1 else ""
    return f"{modules[0]}{more}: not installed; run `pip install 'kinectbench[{extra}]'`"
