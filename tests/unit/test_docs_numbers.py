"""Outputs in the documentation are those of the commands above them."""

import docs_numbers
import pytest

PAGE = """# Numbers

```sh
printf 'resonance 6.30 kHz\\nwall 3 s\\n'
```
<!-- output -->
```text
resonance 6.31 kHz
wall 9 s
```
<!-- /output -->

<!-- not run -->
```sh
exit 1
```

```python
print("| a | CPU [s] |\\n|---|---|\\n| 2.0 | 7 |")
```
<!-- output markdown -->
old
<!-- /output -->
"""


@pytest.fixture
def page(tmp_path):
    path = tmp_path / "page.md"
    path.write_text(PAGE, encoding="utf-8")
    return path


def test_outputs_are_written_below_their_commands(page):
    text, differences = docs_numbers.renewed(page)
    assert "resonance 6.30 kHz\nwall 3 s\n```\n<!-- /output -->" in text
    assert "| a | CPU [s] |\n|---|---|\n| 2.0 | 7 |\n\n<!-- /output -->" in text
    assert [d.shown for d in differences] == ["old", "", ""]
    page.write_text(text, encoding="utf-8")
    assert docs_numbers.renewed(page) == (text, [])


def test_a_command_that_fails_ends_the_check(page):
    page.write_text(PAGE.replace("<!-- not run -->\n", ""), encoding="utf-8")
    with pytest.raises(SystemExit, match="this block fails"):
        docs_numbers.renewed(page)


@pytest.mark.parametrize(
    ("shown", "printed", "differs"),
    [
        ("Q 50", "Q 50", False),
        ("launch 1.020 m/s", "launch 1.021 m/s", False),
        ("launch 1.02011 m/s", "launch 1.04 m/s", True),
        ("16 722 unknowns", "16 702 unknowns", False),
        ("16 722 unknowns", "15 722 unknowns", True),
        ("error 2e-05", "error 3e-05", False),
        ("error 2.0e-05", "error 3.0e-05", True),
        ("17 checks passed", "18 checks passed", True),
        ("one mode", "two modes", True),
        ("took 3 s of CPU", "took 8 s of CPU", False),
        ("| x | wall |\n|---|---|\n| 1 | 2 s |", "| x | wall |\n|---|---|\n| 1 | 9 s |", False),
        ("| x | wall |\n|---|---|\n| 100 | 2 s |", "| x | wall |\n|---|---|\n| 300 | 2 s |", True),
        ("a\nb", "a", True),
    ],
)
def test_numbers_differ_beyond_rounding_and_words_at_all(shown, printed, differs):
    assert bool(list(docs_numbers.different_lines(shown, printed))) is differs


@pytest.mark.slow
@pytest.mark.campaign
def test_every_page_contains_the_output_of_its_commands():
    found = []
    for page in docs_numbers.pages():
        found += map(str, docs_numbers.renewed(page)[1])
    assert not found, "\n".join(found)
