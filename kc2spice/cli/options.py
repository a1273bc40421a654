"""Arguments and options that several commands have, each declared once."""

from importlib import resources
from pathlib import Path
from typing import Annotated

import typer


def _names(incomplete: str) -> list[str]:
    """What the shell offers; file names come from the shell itself."""
    names = (item.name for item in (resources.files("kc2spice") / "scenes").iterdir())
    return sorted(n[:-5] for n in names if n.startswith(incomplete) and n.endswith(".toml"))


def _directory(text: str) -> Path:
    if not text.strip():  # Path("") would be where one stands
        raise typer.BadParameter("names no directory; . is the one you are in")
    return Path(text)


_SCENE = typer.Argument(
    metavar="SCENE",
    help="Gallery name (see 'scenes') or path of a TOML file.",
    autocompletion=_names,
)
Scene = Annotated[str, _SCENE]
AnyScene = Annotated[str | None, _SCENE]
Out = Annotated[
    Path | None,
    typer.Option(
        "--out",
        "-o",
        metavar="DIR",
        parser=_directory,
        help="Where to write; default: ./NAME, ./NAME_verify, ./NAME_bench, ./NAME_sweep or "
        "./NAME_rom.",
    ),
]
Set = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Override a key, e.g. --set kick.drive.voltage=80 or --set control.kd='25 A s/m'. "
        "Repeatable; numbers are SI.",
    ),
]
Trust = Annotated[
    bool, typer.Option("--trust", help="Let included netlists act on this machine; see 'include'.")
]
AsJson = Annotated[
    bool, typer.Option("--json", help="One JSON object on stdout, everything else on stderr.")
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress, no tables.")]
