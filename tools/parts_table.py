"""Write the table of parts in netlists/README.md from the heads of the libraries.

python tools/parts_table.py
"""

from __future__ import annotations

import re
from pathlib import Path

NETLISTS = Path(__file__).parents[1] / "netlists"
PAGE = NETLISTS / "README.md"
TABLE = re.compile(r"(?s)(<!-- parts -->\n).*(<!-- end of parts -->)")
HEAD = """| library | part | pins (1 V is, 1 A is) | signs | rating |
|---|---|---|---|---|
"""


def fields(text: str) -> dict[str, str]:
    """``* key: value`` lines of a head."""
    return dict(re.findall(r"(?m)^\* (\w[\w-]*): (.+)$", text.partition(".subckt")[0]))


def pins(text: str) -> str:
    """Each pin with what one volt and one ampere are there; rings and ports of a kind once."""
    found = re.findall(r"(?m)^\* @pin \d+ (\S+) unit=(\S+) flow=(\S+)", text)
    rows = {re.sub(r"\d+$", "*", name): (unit, flow) for name, unit, flow in found}
    return ", ".join(f"`{name}` ({unit}, {flow})" for name, (unit, flow) in rows.items())


def row(path: Path) -> str:
    """One library: its name without numbers, and what its head says."""
    text = path.read_text(encoding="utf-8")
    head = fields(text)
    title = text.partition("\n")[0].partition(": ")[2]
    cells = (f"`{kind(path)}`", title, pins(text), head["sign"], head["rating"])
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |\n"


def kind(path: Path) -> str:
    """``sphere.lib`` for ``sphere3.lib``."""
    return re.sub(r"\d*\.lib$", ".lib", path.name)


def table() -> str:
    """A row for every kind of library, from the scene that comes first."""
    paths = sorted(NETLISTS.glob("*/*.lib"), key=lambda p: (kind(p), p.parent.name, p.name))
    ours = (path for path in reversed(paths) if "* sign: " in path.read_text(encoding="utf-8"))
    first = {kind(path): path for path in ours if ".ltspice" not in path.name}
    return HEAD + "".join(row(first[name]) for name in sorted(first))


def page() -> str:
    """The README with the table of today's libraries."""
    return TABLE.sub(lambda match: match[1] + table() + match[2], PAGE.read_text(encoding="utf-8"))


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
