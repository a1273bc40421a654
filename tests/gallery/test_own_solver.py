"""The page on own direct solvers works as it is printed."""

import re
from pathlib import Path

from commands import python

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "how-to" / "own_solver.md").read_text(encoding="utf-8")


def test_the_page_contains_the_output_of_its_blocks(tmp_path):
    blocks = re.findall(r"(?<!<!-- not run -->\n)```python\n(.*?)```", PAGE, re.DOTALL)
    (tmp_path / "trial.py").write_text("\n".join(blocks), encoding="utf-8")
    assert python(tmp_path, "trial.py") == "".join(
        re.findall(r"```text\n(.*?)```", PAGE, re.DOTALL)
    )
