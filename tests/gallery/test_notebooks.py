"""The notebooks of the documentation run, and print the numbers that they store."""

import copy

import pytest

nbformat = pytest.importorskip("nbformat", reason="pip install 'kc2spice[test]'")
pytest.importorskip("nbclient", reason="pip install 'kc2spice[test]'")
import notebooks  # noqa: E402  needs nbclient

PATHS = notebooks.paths()
LARGEST = 300_000  # bytes of a notebook with its pictures
every_notebook = pytest.mark.parametrize("path", PATHS, ids=[path.stem for path in PATHS])


def test_there_are_three_notebooks():
    assert [path.stem for path in PATHS] == ["buzzer_and_driver", "kick_and_catch", "own_matrices"]


@every_notebook
def test_a_notebook_is_small_explained_and_illustrated(path):
    notebook = notebooks.read(path)
    nbformat.validate(notebook)
    assert path.stat().st_size < LARGEST
    kinds = [cell.cell_type for cell in notebook.cells]
    assert kinds == ["markdown", "markdown", *kinds[2:]]
    for before, cell in zip(notebook.cells, notebook.cells[1:], strict=False):
        assert cell.cell_type == "markdown" or before.cell_type == "markdown"
        assert len(cell.source.split()) > 4
    assert "image/png" in "".join(map(notebooks.printed, notebook.cells))


@every_notebook
def test_stored_outputs_are_whole(path):
    for cell in notebooks.read(path).cells:
        for output in cell.get("outputs", []):
            assert output.output_type != "error"
            assert output.get("name") != "stderr", output.text


@every_notebook
def test_a_changed_number_is_noticed(path):
    stored = notebooks.read(path)
    changed = copy.deepcopy(stored)
    cell = next(c for c in changed.cells if any(d.isdigit() for d in notebooks.printed(c)))
    output = cell.outputs[0]
    first = next(d for d in output.text if d in "123456789")
    output.text = output.text.replace(first, str(int(first) % 9 + 1), 1)
    assert not list(notebooks.differences(stored, stored))
    assert list(notebooks.differences(stored, changed))


@pytest.mark.slow
@every_notebook
def test_a_notebook_prints_what_it_stores(path):
    stored = notebooks.read(path)
    found = list(notebooks.differences(stored, notebooks.execute(stored)))
    assert not found, "\n".join(map(str, found))
