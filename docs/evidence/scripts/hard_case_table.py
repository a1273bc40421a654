"""Run the hard cases of tests/spice/hard_cases; print their errors, limits and refusals.

PYTHONPATH must contain the root of the repository, ``tests`` and ``tests/spice``. Each error is
the difference to a reference solution: scipy, a closed form, or the conservation of energy.
"""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from hard_cases import cases_catch, cases_contact, cases_kick, cases_models  # noqa: F401
from hard_cases.kit import TABLE, BenchKeys
from tables import power, print_table

from kc2spice.core.errors import Kc2spiceError


def row(entry: str, name: str, what: str, limit: float, measure: Callable) -> list[str]:
    """Return the row of a case: its error and limit, or the error message of the run."""
    begin = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        try:
            error = float(measure(BenchKeys(Path(folder))))
        except Kc2spiceError as refusal:
            cells = ["", "", f"refused: {refusal.message}"]
        else:
            cells = [power(error), power(limit), "met" if error <= limit else "**missed**"]
    return [entry, name, what, *cells, f"{time.process_time() - begin:.1f}"]


if __name__ == "__main__":
    head = ["what is hard", "case", "error of", "error", "limit", "outcome", "CPU of Python [s]"]
    print_table(head, (row(*declared) for declared in TABLE))
