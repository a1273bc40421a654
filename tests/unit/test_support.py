"""Only ``tests/support.py`` knows the modules of the package, so that the layout can change."""

import ast
from functools import cache
from pathlib import Path

import pytest
import support

TESTS = Path(support.__file__).parent
FILES = [path for path in sorted(TESTS.rglob("*.py")) if path.name != "support.py"]


@cache
def import_nodes(path):
    """Import statements of a file, in functions too."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return [node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom)]


def test_tests_import_from_no_module_of_the_package():
    lines = []
    for path in FILES:
        for node in import_nodes(path):
            if isinstance(node, ast.Import):
                modules = [alias.name for alias in node.names]
            else:
                modules = [node.module or ""]
            inside = [name for name in modules if name.startswith("kc2spice.")]
            lines += [f"{path.relative_to(TESTS)}:{node.lineno}: {name}" for name in inside]
    assert not lines, "\n".join(lines)


def test_every_name_of_the_table_exists_and_is_used():
    nodes = [node for path in FILES for node in import_nodes(path)]
    from_support = [n for n in nodes if isinstance(n, ast.ImportFrom) and n.module == "support"]
    used = {alias.name for node in from_support for alias in node.names}
    assert used == set(support.HOMES)
    for name in support.HOMES:
        assert getattr(support, name) is not None


def test_a_name_has_one_home():
    names = [name for name, _, _ in support._list_homes()]
    assert len(names) == len(set(names))


def test_a_name_that_does_not_exist_is_refused():
    with pytest.raises(AttributeError):
        support.no_such_name  # noqa: B018
