"""The page on own methods of reduction works as it is printed."""

import re
from pathlib import Path

import pytest
from commands import python

from kc2spice.rom.reductors import registry

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "how-to" / "own_reductor.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def printed(tmp_path_factory):
    """Output of all blocks of the page, one after the other."""
    folder = tmp_path_factory.mktemp("reductor")
    blocks = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    (folder / "trial.py").write_text("\n".join(blocks), encoding="utf-8")
    return python(folder, "trial.py")


def test_modal_truncation_needs_the_most_states_of_all_methods(printed):
    rows = re.findall(r"(?m)^(\w+ \w+) +(\d+) states", printed)
    states = {name: int(count) for name, count in rows}
    assert len(states) == 4
    assert max(states, key=states.get) == "modal truncation"


def test_the_table_lists_the_methods_that_exist():
    rows = dict(re.findall(r"(?m)^\| `([\w ]+)` \| .* \| `(\w+)` \|$", PAGE))
    known = {method.name: type(method).__name__ for method in registry._BUILT_IN}
    assert rows.items() <= known.items()
    assert set(rows.values()) == set(known.values())
