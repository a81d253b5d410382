"""Self-contained HTML pages that open from disk: a shared head and style sheet, and a template per page."""

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
    """Render a page from a template: HTML text, the same for the same input.

    All text is escaped and control characters become `?`, because names and reasons are untrusted. Files of
    the package, which templates include by `packaged("core/page.css")`, are inserted unchanged. The
    template's path is relative to the package; a missing variable is an error.
    """
    return environment().get_template(template).render(shown)


def png_uri(png: bytes) -> str:
    """Return a PNG file as a `data:` address."""
    return "data:image/png;base64," + base64.b64encode(png).decode()


@cache
def environment() -> "Environment":
    """Return the Jinja environment: it finds the templates in the package, and escapes values."""
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
    """Replace control characters in a text for a template; return other values unchanged."""
    return value if type(value) is not str else STEERING.sub("?", value)


def _packaged(name: str) -> "Markup":
    """Return the unescaped content of a file of the package, by its path below the package."""
    from markupsafe import Markup

    return Markup(resources.files("kinectbench").joinpath(name).read_text(encoding="utf-8"))
