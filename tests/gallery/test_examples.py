"""The examples of the docs run as they stand, in an empty directory."""

from pathlib import Path

import pytest
from commands import python

ROOT = Path(__file__).parents[2]
# Those that ask for a library of the reader run in tests/clients.
EXAMPLES = [
    path
    for path in sorted((ROOT / "docs" / "examples").glob("*.py"))
    if "sys.argv" not in path.read_text("utf-8")
]


# Of what they show other tests are quick.
SLOW = ("edited_deck", "error_budget", "fit", "impedance", "mountings", "own_driver", "own_part",
        "parameters", "pyspice_parts", "python_controller", "sweep", "tune")  # fmt: skip


@pytest.mark.parametrize(
    "path",
    [pytest.param(path, marks=pytest.mark.slow if path.stem in SLOW else ()) for path in EXAMPLES],
    ids=lambda path: path.stem,
)
def test_example_runs(path, tmp_path):
    assert python(tmp_path, "-W", "error::DeprecationWarning", str(path))
