"""The page on own methods of reduction works as it is printed."""

import json
import re
import shlex
from pathlib import Path

import pytest
from commands import install_package, python, typed
from support import registry

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
    rows = re.findall(r"(?m)^(\w+ \w+) +(\d+) unknowns", printed)
    states = {name: int(count) for name, count in rows if name != "tolerance 1e"}
    assert len(states) == 4
    assert max(states, key=states.get) == "modal truncation"


def test_static_responses_save_more_than_half_of_the_modes(printed):
    (modes,) = re.findall(r"(?m)^modal truncation +(\d+) unknowns", printed)
    (corrected,) = re.findall(r"(?m)^(\d+) unknowns", printed)
    assert 2 * int(corrected) < int(modes)


def test_the_table_lists_the_methods_that_exist():
    rows = dict(re.findall(r"(?m)^\| `([\w -]+)` \| .* \| `(\w+)(?:\(.*\))?` \|$", PAGE))
    assert rows == {method.name: type(method).__name__ for method in registry._BUILT_IN}


def test_the_comparison_contains_all_methods_in_states_of_first_order(printed):
    """A second-order model of q unknowns has 2 q states."""
    unknowns = dict(re.findall(r"(?m)^(\w+ \w+) +(\d+) unknowns", printed))
    rows = dict(re.findall(r"(?m)^(\D+) (\d+) \S+$", printed))
    for name in ("modal truncation", "block Krylov", "rational Krylov", "response POD"):
        assert int(rows[name]) == 2 * int(unknowns[name])
    for method in registry._BUILT_IN:
        assert re.search(rf"(?m)^{method.name} (\d+|[a-z])", printed)


def test_the_command_finds_an_installed_method(tmp_path):
    blocks = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    (entry,) = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)
    (command,) = re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL)
    (tmp_path / "modal_truncation.py").write_text(blocks[0], encoding="utf-8")
    install_package(tmp_path, entry)
    matrices = next(block.partition("chain =")[0] for block in blocks if "chain =" in block)
    (tmp_path / "save.py").write_text(f"{matrices}\n{blocks[-1]}", encoding="utf-8")
    python(tmp_path, "save.py")
    typed(tmp_path, [shlex.split(command)[1:]], path=[tmp_path])
    record = json.loads((tmp_path / "chain_rom" / "chain_rom.json").read_text(encoding="utf-8"))
    assert "modal truncation" in json.dumps(record)
