"""Pages of HTML from their templates, all in one style; entry point ``fill``."""

from importlib import resources

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from handeye_fg.report import wording


def fill(template: str, **content: object) -> str:
    """A page as text; what is filled in shows as text, whatever it holds.

    Args:
        template: of Jinja; ``style`` is the style that all pages share, ``printable`` a filter.
        content: what it shows.
    """
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["printable"] = wording.printable
    page = environment.from_string(template).render(style=asset("style.css"), **content)
    # A name may hold half a surrogate pair (a file name that is not UTF-8); the page is UTF-8.
    return page.encode("utf-8", "backslashreplace").decode("utf-8")


def asset(name: str) -> Markup:
    """A file of the package, which is part of a page as it is."""
    folder = resources.files("handeye_fg.report") / "assets"
    return Markup(folder.joinpath(name).read_text(encoding="utf-8"))
