"""Objects of other installed packages, and packages that are damaged."""

import pytest
from support import UsageError, find_dialect, find_part_type, list_entry_points, load_plugin

METADATA = "Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n"


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Function that installs a package with one module and one entry point for a test."""

    def add(group, name, text, module):
        (tmp_path / f"{module}.py").write_text(text)
        metadata = tmp_path / f"{module}-1.0.dist-info"
        metadata.mkdir()
        (metadata / "METADATA").write_text(METADATA.format(name=module))
        (metadata / "entry_points.txt").write_text(f"[{group}]\n{name} = {module}:ITEM\n")
        monkeypatch.syspath_prepend(tmp_path)

    return add


def test_a_plugin_is_imported_when_it_is_loaded(install):
    install("kc2spice.test_sizes", "large", "ITEM = 7\n", "plugin_with_a_size")
    assert list_entry_points("kc2spice.test_sizes") == ("large",)
    assert load_plugin("kc2spice.test_sizes", "large") == 7
    assert load_plugin("kc2spice.test_sizes", "small") is None


def test_a_damaged_package_is_named_with_its_error(install):
    install("kc2spice.test_damage", "broken", "import no_such_module\n", "damaged_plugin")
    with pytest.raises(UsageError) as caught:
        load_plugin("kc2spice.test_damage", "broken")
    assert caught.value.got == "ModuleNotFoundError: No module named 'no_such_module'"
    assert caught.value.hint.endswith("pip uninstall damaged_plugin")


@pytest.mark.parametrize(
    ("group", "find", "expected"),
    [
        ("kc2spice.parts", find_part_type, "part type"),
        ("kc2spice.dialects", find_dialect, "netlist dialect"),
    ],
)
def test_a_plugin_of_another_class_is_an_error(install, monkeypatch, group, find, expected):
    name = f"number_in_{group.rpartition('.')[2]}"
    install(group, name, "ITEM = 7\n", f"{name}_plugin")
    monkeypatch.setattr("kc2spice.core.plugins._list_entry_points", uncached_entry_points)
    with pytest.raises(UsageError, match=f"this object is not a {expected}") as caught:
        find(name)
    assert caught.value.where == f"entry point {name} of {group}"


def uncached_entry_points(group):
    """Return entry points that include packages installed during a test."""
    from importlib.metadata import entry_points

    return tuple(entry_points(group=group))
