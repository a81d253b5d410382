"""The page of an evaluation: one file that opens from disk, with every picture inside."""

import base64
from collections.abc import Mapping
from importlib import resources

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from kinectbench import __version__
from kinectbench.evaluate.evaluation import Evaluation
from kinectbench.evaluate.table import sections

CAPTIONS = {
    "path": "Cameras from above, the true object's axes. Grey: true path. Dots: built positions, aligned.",
    "meshes": "Above: the built mesh, red where it is too far out, blue where too far in. Below: the true "
    "mesh, dark where the built one is far away. The last look is from below.",
    "errors": "Left: signed distances of the built surface from the true one. Right: shares of the built "
    "(precision) and true (recall) surface within a distance; dashed: of what the camera saw.",
    "slices": "Slices of the upright cube, 256 cells a side, through the true solid's centre of mass.",
}


def make_page(name: str, evaluation: Evaluation, pictures: Mapping[str, bytes]) -> str:
    """Lay out the page: HTML text, the same for the same input.

    Args:
        name: of the recording.
        evaluation: all figures.
        pictures: PNG files by the keys of `CAPTIONS`, as far as there are any.
    """
    # Names come from strangers: all text is escaped but the style sheets.
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    shown = [(key, png_uri(pictures[key]), CAPTIONS[key]) for key in CAPTIONS if key in pictures]
    style = Markup(_packaged("report", "page.css") + _packaged("evaluate", "page.css"))
    template = environment.from_string(_packaged("evaluate", "page.html"))
    return template.render(
        name=name,
        evaluation=evaluation,
        sections=sections(evaluation),
        pictures=shown,
        version=__version__,
        style=style,
    )


def png_uri(png: bytes) -> str:
    """A PNG file as a `data:` address."""
    return "data:image/png;base64," + base64.b64encode(png).decode()


def _packaged(room: str, name: str) -> str:
    return resources.files(f"kinectbench.{room}").joinpath(name).read_text(encoding="utf-8")
