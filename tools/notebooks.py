#!/usr/bin/env python3
"""Execute the notebooks of the documentation and store their outputs: ``make docs-numbers``.

    python tools/notebooks.py [--check] [NOTEBOOK ...]       default: all of docs/notebooks

``--check`` compares the printed text with the stored one and writes nothing. Numbers have the
tolerance of ``docs_numbers.py``. Pictures are counted and not compared.
"""

from __future__ import annotations

import argparse
import copy
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import nbformat
from docs_numbers import different_lines
from nbclient import NotebookClient

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "notebooks"
LONGEST = 600  # seconds of one cell


def paths() -> list[Path]:
    """All notebooks of the documentation."""
    return sorted(FOLDER.glob("*.ipynb"))


def read(path: Path) -> Any:
    """The notebook of a file; ``.cells`` lists its cells."""
    return nbformat.read(path, as_version=4)


def write(notebook: Any, path: Path) -> None:
    """Write a notebook with its outputs."""
    nbformat.write(notebook, path)


def execute(notebook: Any) -> Any:
    """Copy a notebook and compute its outputs in an empty directory that is removed afterwards.

    Raises
    ------
    nbclient.exceptions.CellExecutionError : a cell raises an exception.
    """
    renewed = copy.deepcopy(notebook)
    with tempfile.TemporaryDirectory(prefix="notebook-") as work:
        resources = {"metadata": {"path": work}}
        NotebookClient(renewed, timeout=LONGEST, record_timing=False, resources=resources).execute()
    renewed.metadata["language_info"] = {"name": "python"}  # the same on every machine
    return renewed


def printed(cell: Any) -> str:
    """All text that a cell prints, with one line for each picture."""
    lines = []
    for output in cell.get("outputs", []):
        if output.output_type == "stream":
            lines.append(output.text)
        else:
            lines.append(" ".join(sorted(output.get("data", {}))) + "\n")
    return "".join(lines)


def differences(stored: Any, renewed: Any) -> Iterator[tuple[str, str]]:
    """Pairs of lines that two executions of a notebook print differently."""
    for old, new in zip(stored.cells, renewed.cells, strict=True):
        yield from different_lines(printed(old), printed(new))


def main() -> int:
    """Write or check; return the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--check", action="store_true", help="compare, and write nothing")
    parser.add_argument("notebooks", nargs="*", type=Path, help="default: all of docs/notebooks")
    chosen = parser.parse_args()
    failed = False
    for path in chosen.notebooks or paths():
        stored = read(path)
        renewed = execute(stored)
        found = list(differences(stored, renewed))
        print(f"{path.name}: {len(found)} lines differ", flush=True)
        if chosen.check:
            for old, new in found:
                print(f"  stored:  {old}\n  printed: {new}")
            failed |= bool(found)
        else:
            write(renewed, path)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
