"""Records that contain arrays compare by content, also to themselves, on every supported Python."""

import ast
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import RecordedWave, Waveforms, find_material, have_same_content

import kc2spice as kc

PACKAGE = Path(kc.__file__).parent
# Functions of arrays are compared by identity.
CALLABLES = re.compile(r"Callable\[\[[^]]*\], [^]]*\]")
ARRAYS = re.compile(r"\b(ndarray|c[sc][cr]_array|Matrix|Mesh|OptimizeResult)\b")


def generated_equality(node):
    """Whether ``dataclass`` writes ``__eq__`` of a class."""
    decorators = [ast.unparse(each) for each in node.decorator_list]
    own = any(isinstance(item, ast.FunctionDef) and item.name == "__eq__" for item in node.body)
    return not own and any("dataclass" in d and "eq=False" not in d for d in decorators)


def test_no_class_with_arrays_has_the_equality_that_dataclass_generates():
    names = []
    for path in PACKAGE.rglob("*.py"):
        classes = filter(
            lambda node: isinstance(node, ast.ClassDef),
            ast.walk(ast.parse(path.read_text("utf-8"))),
        )
        for node in filter(generated_equality, classes):
            fields = filter(lambda item: isinstance(item, ast.AnnAssign), node.body)
            if any(
                ARRAYS.search(CALLABLES.sub("", ast.unparse(item.annotation))) for item in fields
            ):
                names.append(f"{path.name}: {node.name}")
    assert names == []


def test_materials_are_equal_by_their_constants():
    pzt = find_material("PZT-5A")
    same = replace(pzt, C=pzt.C.copy(), e=pzt.e.copy())
    assert pzt == pzt  # Python 3.13 compares the arrays of one object too
    assert pzt == same
    assert (pzt, 1) == (same, 1)
    assert pzt != replace(pzt, C=pzt.C * (1 + 1e-15))
    assert pzt != replace(pzt, quality=pzt.quality + 1)
    assert pzt != find_material("PZT-5H")
    assert pzt != "PZT-5A"


@pytest.mark.parametrize("name", ["kick_and_catch", "buzzer_7bb_20_3", "stack_p882"])
def test_scenes_loaded_twice_have_equal_parts(name):
    one, other = kc.load_scene(name), kc.load_scene(name)
    for scene in (one, other):
        for part in scene.parts.values():
            if hasattr(part.type, "rated_voltage"):
                part.type.rated_voltage(part)  # fills caches of keys
    assert one.parts == one.parts
    assert one.parts == other.parts
    assert one.frame == other.frame


def test_arrays_within_containers_are_compared_element_by_element():
    t = np.linspace(0.0, 1.0, 5)
    assert Waveforms({"time": t}, {"cpu_s": 1.0}) == Waveforms({"time": t.copy()}, {"cpu_s": 1.0})
    assert Waveforms({"time": t}, {}) != Waveforms({"time": t[:4]}, {})
    assert Waveforms({"time": t}, {}) != Waveforms({"frequency": t}, {})
    assert RecordedWave(t, t) != RecordedWave(t, 2 * t)
    gap = np.array([1.0, np.nan])
    assert have_same_content([gap, "a"], [gap.copy(), "a"])
    assert not have_same_content([gap, "a"], [gap.copy(), "b"])
    assert not have_same_content((t,), [t])
    assert not have_same_content(t, list(t))
    assert have_same_content(np.array(["a"]), np.array(["a"]))
