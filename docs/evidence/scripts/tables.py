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
    """An error with one significant digit; below 1e-15 it is a rounding error and prints 0."""
    return "0" if abs(error) < 1e-15 else f"{error:.0e}"
