"""Fills the templates of ``templates/``: the netlist text that a person reads."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from kc2spice.core.errors import MissingToolError
from kc2spice.netlist.cards import comment, name, number


def template_directory() -> Path:
    """``kc2spice/templates`` of a wheel, else ``templates`` beside the package in a checkout."""
    package = Path(__file__).resolve().parent.parent
    for place in (package / "templates", package.parent / "templates"):
        if place.is_dir():
            return place
    raise MissingToolError(
        "the netlist templates are not installed", where=str(package), hint="reinstall kc2spice"
    )


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=FileSystemLoader(template_directory()),
        undefined=StrictUndefined,  # a missing value is an error, never an empty field
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        line_comment_prefix="##",
    )
    environment.filters.update(n=number, name=name, comment=comment, q=quoted)
    return environment


def quoted(text: str) -> str:
    """``text`` as a string of an S-expression."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
    return f'"{escaped}"'


def render(template: str, **values: object) -> str:
    """Text of ``template``; filters are ``n`` (number), ``name`` (checked), ``comment``
    and ``q`` (a string of an S-expression)."""
    return _environment().get_template(template).render(**values)
