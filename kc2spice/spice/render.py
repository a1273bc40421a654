"""Fills the templates of ``templates/``: the netlist text that a person reads."""

from __future__ import annotations

import sys
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemBytecodeCache, FileSystemLoader, StrictUndefined
from jinja2.bccache import Bucket

from kc2spice.core.errors import MissingToolError
from kc2spice.spice.cards import comment, name, number


def template_directory() -> Path:
    """``kc2spice/templates`` of a wheel, else ``templates`` beside the package in a checkout."""
    package = Path(__file__).resolve().parent.parent
    for place in (package / "templates", package.parent / "templates"):
        if place.is_dir():
            return place
    raise MissingToolError(
        "the netlist templates are not installed", where=str(package), hint="reinstall kc2spice"
    )


class _Compiled(FileSystemBytecodeCache):
    """Compiled templates beside their text, as Python keeps its own bytecode, where that may be."""

    def dump_bytecode(self, bucket: Bucket) -> None:
        if not sys.dont_write_bytecode:
            with suppress(OSError):  # an installation that others own
                Path(self.directory).mkdir(exist_ok=True)
                super().dump_bytecode(bucket)


def loading() -> dict[str, Any]:
    """Options of an environment that reads our templates."""
    where = template_directory()
    return {
        "loader": FileSystemLoader(where),
        "bytecode_cache": _Compiled(str(where / "__pycache__"), "%s.jinja"),
        "undefined": StrictUndefined,  # a missing value is an error, never an empty field
        "trim_blocks": True,
        "lstrip_blocks": True,
    }


@cache
def _environment() -> Environment:
    environment = Environment(
        **loading(),
        keep_trailing_newline=True,
        line_comment_prefix="##",
    )
    environment.filters.update(n=number, name=name, comment=comment)
    return environment


def render(template: str, **values: object) -> str:
    """Text of ``template``; filters are ``n`` (number), ``name`` (checked) and ``comment``."""
    return _environment().get_template(template).render(**values)
