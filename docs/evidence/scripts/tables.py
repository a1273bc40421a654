"""Print tables in Markdown: shared by the scripts of this folder."""

from collections.abc import Iterable, Sequence


def print_table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Print a table with the given head, row by row."""
    for line in (head, ["---"] * len(head)):
        print("|", " | ".join(line), "|")
    for row in rows:
        print("|", " | ".join(map(str, row)), "|", flush=True)


def percent(value: float, reference: float) -> str:
    """Relative difference from a reference in percent, with its sign."""
    difference = f"{100 * (value / reference - 1):+.2f}"
    return "0" if float(difference) == 0 else difference


def power(error: float) -> str:
    """Return an error with one significant digit; smaller values than 1e-12 are rounding errors."""
    if 0 < abs(error) < 1e-12:
        return "< 1e-12"
    return f"{error:.0e}" if error else "0"
