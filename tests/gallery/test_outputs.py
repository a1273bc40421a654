"""README, tutorials, guides, reference and short evidence show what their commands print."""

from pathlib import Path

import docs_numbers
import pytest

ROOT = Path(__file__).parents[2]
FOLDERS = ("tutorials", "how-to", "reference")
EVIDENCE = [ROOT / "docs" / "evidence" / f"{n}.md" for n in ("hard_cases", "reduction", "studies")]
TAUGHT = [page for page in docs_numbers.pages() if page.parent.name in FOLDERS]
TAUGHT += [ROOT / "README.md", *EVIDENCE]


@pytest.mark.slow
@pytest.mark.parametrize("page", TAUGHT, ids=[page.stem for page in TAUGHT])
def test_outputs_are_those_of_the_commands_above_them(page):
    _, differences = docs_numbers.renewed(page)
    assert not differences, "\n".join(map(str, differences))
