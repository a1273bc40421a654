"""README, tutorials and how-to guides show what their commands print."""

from pathlib import Path

import docs_numbers
import pytest

ROOT = Path(__file__).parents[2]
TAUGHT = [page for page in docs_numbers.pages() if page.parent.name in ("tutorials", "how-to")] + [
    ROOT / "README.md"
]


@pytest.mark.slow
@pytest.mark.parametrize("page", TAUGHT, ids=[page.stem for page in TAUGHT])
def test_outputs_are_those_of_the_commands_above_them(page):
    _, differences = docs_numbers.renewed(page)
    assert not differences, "\n".join(map(str, differences))
