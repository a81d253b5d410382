"""HTML pages that are one file and open from disk: one head and style sheet, and a template for each page."""

import base64
from collections.abc import Mapping
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING

from kinectbench.core.untrusted import STEERING

if TYPE_CHECKING:
    from jinja2 import Environment
    from markupsafe import Markup


def render_page(template: str, shown: Mapping[str, object]) -> str:
    """Lay out a page: HTML text, the same for the same input.

    Names and reasons are untrusted: all text is escaped, and control characters show as `?`, except in
    the package's own files, which a template names by `packaged("core/page.css")`.

    Args:
        template: path of the page's template below the package, such as "doctor/page.html".
        shown: what the template shows, by the names it uses; a name that is missing is an error.
    """
    return environment().get_template(template).render(shown)


def png_uri(png: bytes) -> str:
    """A PNG file as a `data:` address."""
    return "data:image/png;base64," + base64.b64encode(png).decode()


@cache
def environment() -> "Environment":
    """The template environment: where templates are, and how values are escaped."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    made = Environment(
        loader=PackageLoader("kinectbench", ""),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=_shown,
    )
    made.globals["packaged"] = _packaged
    return made


def _shown(value: object) -> object:
    """A value as a template shows it, without control characters."""
    return value if type(value) is not str else STEERING.sub("?", value)


def _packaged(name: str) -> "Markup":
    """A file of the package, unchanged, by its path below the package."""
    from markupsafe import Markup

    return Markup(resources.files("kinectbench").joinpath(name).read_text(encoding="utf-8"))
