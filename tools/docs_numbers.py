#!/usr/bin/env python3
"""Write the outputs that documentation pages show, or check them: ``make docs-numbers``.

    python tools/docs_numbers.py [--check] [PAGE ...]       default: every page that shows outputs

A page shows an output between two comments, below the block of commands that prints it::

    ```sh
    kc2spice run buzzer_7bb_20_6
    ```
    <!-- output -->
    ```text
    resonance  6.3 kHz
    ```
    <!-- /output -->

Blocks marked ``sh`` and ``python`` run in the order of the page, in one empty directory that
contains links to the repository's files. A block below ``<!-- not run -->`` is not run.
``<!-- output markdown -->`` inserts the output as Markdown, such as a table.
``<!-- output=REGEX -->`` inserts only the lines that match REGEX, which contains no blanks. The
line after ``<!-- generated -->`` states date and commit.

``--check`` compares words literally, and numbers to 0.5 % or to one unit of their last digit. It
skips what the machine decides: table columns and lines that mention wall time, CPU or memory.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import date
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LINKED = ("docs", "netlists", "kc2spice", "templates", "tests", "bench", "tools")
LONGEST = 3600  # seconds of one block
TOLERANCE = 5e-3  # of a number; simulators and libraries of other versions differ less
_BLOCK = re.compile(
    r"(?P<skip><!-- not run -->\n)?```(?P<kind>sh|python)\n(?P<code>.*?)```"
    r"|<!-- output(?P<how>[ =].*?)-->\n(?P<shown>.*?)<!-- /output -->"
    r"|<!-- generated -->\n(?P<stamp>[^\n]*)",
    re.DOTALL,
)
_NUMBER = re.compile(r"[-+]?\d+(?:[ ]\d{3})*(?:\.\d+)?(?:[eE][-+]?\d+)?")
_SPEED = re.compile(r"\b(wall|CPU|time|elapsed|memory)\b", re.IGNORECASE)


@dataclass(frozen=True)
class Difference:
    """A line of a page that its command no longer prints."""

    page: str
    command: str
    shown: str
    printed: str

    def __str__(self) -> str:
        return f"{self.page}: {self.command}\n  shown:   {self.shown}\n  printed: {self.printed}"


def pages() -> list[Path]:
    """Pages that show outputs."""
    found = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    return [page for page in found if "<!-- output" in page.read_text(encoding="utf-8")]


def renewed(page: Path) -> tuple[str, list[Difference]]:
    """Text of a page with the outputs of its commands, and what differs from those it shows.

    Raises
    ------
    SystemExit : a command fails, or an output has no command above it.
    """
    text, done, last = page.read_text(encoding="utf-8"), 0, None
    pieces, differences = [], []
    with tempfile.TemporaryDirectory(prefix="docs-numbers-") as name:
        work = Path(name)
        for folder in LINKED:
            if (ROOT / folder).exists():
                (work / folder).symlink_to(ROOT / folder)
        for match in _BLOCK.finditer(text):
            pieces.append(text[done : match.start()])
            done, piece = match.end(), match[0]
            if match["code"] is not None and not match["skip"]:
                last = match["code"].strip().splitlines()[-1], _run(match, work, page)
            elif match["shown"] is not None:
                if last is None:
                    raise SystemExit(f"{page}: an output without a command above it")
                command, printed = last
                output = _formatted(printed, match["how"].strip())
                piece = f"<!-- output{match['how']}-->\n{output}<!-- /output -->"
                pairs = different_lines(match["shown"], output)
                differences += [Difference(page.name, command, a, b) for a, b in pairs]
            elif match["stamp"] is not None:
                stamp = f"Generated {date_and_commit()} by `make docs-numbers`."
                piece = f"<!-- generated -->\n{stamp}"
            pieces.append(piece)
    return "".join([*pieces, text[done:]]), differences


def _run(match: re.Match[str], work: Path, page: Path) -> str:
    """Standard output of a block of commands."""
    code = match["code"]
    command = ["bash", "-euo", "pipefail", "-c", code]
    if match["kind"] == "python":
        (work / "block.py").write_text(code, encoding="utf-8")
        command = [sys.executable, "block.py"]
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    environment = {**os.environ, "PATH": path, "COLUMNS": "100", "NO_COLOR": "1", "TERM": "dumb"}
    done = subprocess.run(
        command, cwd=work, env=environment, capture_output=True, text=True, timeout=LONGEST
    )
    if done.returncode:
        raise SystemExit(f"{page}: this block fails:\n{code}{done.stdout}{done.stderr}")
    return done.stdout


def _formatted(printed: str, how: str) -> str:
    """Lines of an output that a page shows."""
    lines = [line.rstrip() for line in printed.strip("\n").splitlines()]
    if how.startswith("="):
        wanted = re.compile(how.removeprefix("="))
        lines = [line for line in lines if wanted.search(line)]
    text = "\n".join(lines) + "\n"
    return f"\n{text}\n" if how == "markdown" else f"```text\n{text}```\n"


def date_and_commit() -> str:
    """Today's date and the commit of the tree, for the heads of generated pages."""
    command = ["git", "-C", str(ROOT), "rev-parse", "--short", "HEAD"]
    commit = subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()
    return f"on {date.today()} from commit {commit}"


# --- comparison -----------------------------------------------------------------------------------


def different_lines(shown: str, printed: str) -> Iterator[tuple[str, str]]:
    """Pairs of lines that differ in words, or in numbers beyond the tolerance."""
    ours, theirs = shown.strip().splitlines(), printed.strip().splitlines()
    speed: set[int] = set()
    for k in range(max(len(ours), len(theirs))):
        a, b = ours[k] if k < len(ours) else "", theirs[k] if k < len(theirs) else ""
        cells = b.split("|")
        if "|" not in b:
            speed = set()
        elif not speed and _SPEED.search(b):
            speed = {i for i, cell in enumerate(cells) if _SPEED.search(cell)}
        if speed:
            a, b = _without(a, speed), _without(b, speed)
        elif _SPEED.search(b):
            continue
        if not _alike(a, b):
            yield a, b


def _without(line: str, columns: set[int]) -> str:
    cells = line.split("|")
    return "|".join(cell for i, cell in enumerate(cells) if i not in columns)


def _alike(shown: str, printed: str) -> bool:
    words, numbers = _split(shown)
    other_words, other_numbers = _split(printed)
    if words != other_words:
        return False
    return all(_close(a, b) for a, b in zip(numbers, other_numbers, strict=True))


def _split(line: str) -> tuple[list[str], list[str]]:
    words = " ".join(_NUMBER.sub(" # ", line).split()).split(" ")
    return words, _NUMBER.findall(line)


def _close(shown: str, printed: str) -> bool:
    """To the tolerance, or to one unit of the last digit that is shown; counts have none."""
    a, b = (float(text.replace(" ", "")) for text in (shown, printed))
    mantissa, _, exponent = shown.lower().partition("e")
    count = shown.replace(" ", "").lstrip("+-").isdigit()
    last = 0.0 if count else 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))
    return abs(a - b) <= max(TOLERANCE * abs(b), 1.01 * last)


def main() -> int:
    """Write or check; return the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--check", action="store_true", help="compare, and write nothing")
    parser.add_argument("pages", nargs="*", type=Path, help="default: all that show outputs")
    chosen = parser.parse_args()
    failed = False
    for page in [path.resolve() for path in chosen.pages] or pages():
        text, differences = renewed(page)
        print(f"{page.relative_to(ROOT)}: {len(differences)} lines differ", flush=True)
        if chosen.check:
            print("\n".join(map(str, differences)), end="\n" if differences else "")
            failed |= bool(differences)
        else:
            page.write_text(text, encoding="utf-8")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
