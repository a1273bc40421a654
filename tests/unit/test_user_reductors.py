"""Methods of reduction that a user adds: scale of vectors, and errors of what is no basis."""

import re
from pathlib import Path

import numpy as np
import pytest
import scipy
from scipy.linalg import eigh
from support import (
    SimulationError,
    UsageError,
    balanced_truncation,
    band_limited_balancing,
    compare_methods,
    registry,
    subcircuit,
)

import kc2spice as kc

N = 40


def chain(stiffness=1e9, mass=1e-6):
    """Masses between springs, clamped at both ends, driven at the first one."""
    K = stiffness * (2 * np.eye(N) - np.eye(N, k=1) - np.eye(N, k=-1))
    tip = kc.Port("tip", "mechanical")
    damping = 0.02 * np.sqrt(mass / stiffness)
    return kc.LinearModel(
        M=mass * np.eye(N), K=K, B=np.eye(N)[:, :1], rayleigh=(0.0, damping), ports=(tip,)
    )


class UserMethod(kc.Reductor):
    """A method whose basis is a function of the task."""

    name = "user method"
    reference = "none"

    def __init__(self, function, congruence=True):
        self.function, self.congruence = function, congruence

    def basis(self, task):
        return self.function(task)


def reduced(function, model=None, congruence=True, **aims):
    """Reduce a chain by a method of this function."""
    aims = aims or {"tolerance": 1e-3}
    band = 0, 0.1 * np.sqrt(1e9 / 1e-6)
    return kc.reduce(model or chain(), band=band, method=UserMethod(function, congruence), **aims)


def static_and_modes(task, scale=1.0):
    """Static response of the port and the modes; their norms differ by many powers of ten."""
    model = task.model
    modes = eigh(model.K, model.M)[1]
    static = np.linalg.solve(model.K, model.B)
    return np.hstack([scale * static / np.linalg.norm(static), modes[:, :-1]])


@pytest.mark.parametrize("scale", [1e-30, 2.6e-11, 1.0, 1e20])
def test_the_scale_of_a_vector_has_no_influence(scale):
    """Against ``B' K^-1 B`` at rest and a direct solution in the band."""
    rom = reduced(lambda task: task.project(static_and_modes(task, scale), fixed=1))
    full = chain()
    frequency = np.linspace(0.0, rom.certificate.band_hz[1], 50)
    s = 2j * np.pi * frequency
    E = full.rayleigh[1] * full.K
    exact = np.array([full.B.T @ np.linalg.solve(full.K + p * E + p * p * full.M, full.B)
                      for p in s])  # fmt: skip
    difference = np.abs(rom.transfer(frequency) - exact)
    assert abs(rom.transfer([0.0]) / exact[0] - 1).max() < 1e-9
    assert (difference / np.abs(exact)).max() < 1e-3
    assert rom.certificate.error_estimate < 1e-3
    states = rom.reconstruct(np.linalg.solve(rom.K, rom.B[:, 0]))
    np.testing.assert_allclose(states, np.linalg.solve(full.K, full.B[:, 0]), rtol=1e-6)


def test_the_scale_of_test_vectors_has_no_influence():
    def oblique(task):
        V = static_and_modes(task, 2.6e-11)
        return task.project(V, 1e-8 * V)

    assert reduced(oblique, congruence=False).certificate.error_estimate < 1e-3


@pytest.mark.parametrize("mass", [1e-20, 1.0, 1e20])
def test_an_unsymmetric_mass_of_any_size_has_a_state_space_form(mass):
    """Response of one chain with rows of its equations mixed, against a direct solution."""
    full = chain(mass * 1e12, mass)
    T = np.eye(N) + 0.5 * np.eye(N, k=1)
    model = kc.LinearModel(
        M=T @ full.M, K=T @ full.K, E=T @ (full.rayleigh[1] * full.K), B=T @ full.B, C=full.C
    )
    A, B, C, D = model.state_space()
    s = 2e5j
    direct = full.B.T @ np.linalg.solve(
        full.K * (1 + s * full.rayleigh[1]) + s * s * full.M, full.B
    )
    response = C @ np.linalg.solve(s * np.eye(len(A)) - A, B) + D
    np.testing.assert_allclose(response, direct, rtol=1e-8)


def cantilever(elements=40):
    """Stiffness and mass of a clamped steel strip of 100 x 10 x 1 mm, in SI units."""
    h, bending, line_mass = 0.1 / elements, 210e9 * 10e-3 * 1e-3**3 / 12, 7850 * 10e-3 * 1e-3
    k = np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]])
    m = np.array([[156, 22, 54, -13], [22, 4, 13, -3], [54, 13, 156, -22], [-13, -3, -22, 4]]) / 420
    unit = np.array([1, h, 1, h])  # deflections and slopes
    k, m = bending / h**3 * k * np.outer(unit, unit), line_mass * h * m * np.outer(unit, unit)
    K, M = np.zeros((2, 2 * elements + 2, 2 * elements + 2))
    for at in range(0, 2 * elements, 2):
        K[at : at + 4, at : at + 4] += k
        M[at : at + 4, at : at + 4] += m
    return K[2:, 2:], M[2:, 2:]


@pytest.mark.parametrize("order", [20, 40, 78, 80])
def test_a_static_response_beside_many_modes_keeps_its_remainder(order):
    """Forces at the tip and the middle of a beam, against direct solutions."""
    (K, M), damping, top = cantilever(), 1e-5, 600.0  # Hz, above the second natural frequency
    B = np.eye(len(K))[:, [len(K) - 2, len(K) // 2 - 2]]
    beam = kc.LinearModel(M=M, K=K, B=B, rayleigh=(0.0, damping))

    def basis(task):
        model = task.model
        static = np.linalg.solve(model.K, model.B)
        return task.project(np.hstack([static, eigh(model.K, model.M)[1][:, :-2]]), fixed=2)

    rom = kc.reduce(beam, order=order, band=(0, top), method=UserMethod(basis))
    frequency = np.linspace(0.0, top, 40)
    exact = [B.T @ np.linalg.solve(K * (1 + s * damping) + s * s * M, B)
             for s in 2j * np.pi * frequency]  # fmt: skip
    assert rom.order == order
    assert rom.certificate.passive
    np.testing.assert_allclose(rom.transfer(frequency), exact, rtol=1e-8)


@pytest.mark.parametrize("frequency", [2j, [1.0, 2j], np.array([0j])])
def test_a_complex_frequency_is_an_error(frequency):
    with pytest.raises(UsageError, match="frequencies are complex") as caught:
        chain().transfer(frequency)
    assert "Hz" in caught.value.expected


def test_orthonormal_vectors_do_not_change():
    Q = np.linalg.qr(np.random.default_rng(1).standard_normal((N, 7)))[0]
    bases = []
    reduced(lambda task: bases.append(task.project(Q)) or bases[-1], order=7)
    np.testing.assert_array_equal(bases[0].vectors, Q)


def vectors(task):
    """Five modes."""
    return eigh(task.model.K, task.model.M)[1][:, :5]


BAD = {
    "wrong number of rows": (lambda t: t.project(vectors(t)[:-1]), "a wrong shape", "39 rows"),
    "one dimension": (lambda t: t.project(vectors(t)[:, 0]), "not a matrix", r"shape \(40,\)"),
    "no projection": (vectors, "does not return a basis", r"shape \(40, 5\)"),
    "text": (lambda t: "V", "does not return a basis", "str"),
    "test vectors of another shape": (
        lambda t: t.project(vectors(t), vectors(t)[:, :4]),
        "W: the vectors have a wrong",
        "4 columns",
    ),
    "too many fixed vectors": (
        lambda t: t.project(vectors(t), fixed=9), "not a valid number of leading vectors", "9"
    ),
    "fixed text": (
        lambda t: t.project(vectors(t), fixed="all"), "not a valid number of leading vectors", "all"
    ),
    "NaN": (lambda t: t.project(vectors(t) * np.nan), "not finite", "200 entries"),
    "infinity": (lambda t: t.project(vectors(t) / 0.0), "not finite", "200 entries"),
    "duplicate": (
        lambda t: t.project(vectors(t)[:, [0, 1, 1, 2]]), "linearly dependent", "column 2 of 4"
    ),
    "zero": (lambda t: t.project(0 * vectors(t)), "linearly dependent", "columns 0 to 4 of 5"),
    "too many": (
        lambda t: t.project(np.hstack([np.eye(N), vectors(t)])), "linearly dependent",
        "columns 40 to 44 of 45",
    ),
    "dependent test vectors": (
        lambda t: t.project(vectors(t), np.ones((N, 5))), "W: the vectors are linearly",
        "columns 1 to 4 of 5",
    ),
    "complex": (lambda t: t.project(vectors(t) * 1j), "complex", "complex128"),
    "ragged": (lambda t: t.project([[1.0], [1.0, 2.0]]), "not an array of numbers", "list"),
    "nothing": (lambda t: t.project(None), "not an array of numbers", "NoneType"),
    "no columns": (lambda t: t.project(vectors(t)[:, :0]), "no vectors", "0 columns"),
    "oblique congruence": (
        lambda t: t.project(vectors(t), vectors(t)), "combined with congruence", "congruence = True"
    ),
}  # fmt: skip


@pytest.mark.filterwarnings("ignore:divide by zero")
@pytest.mark.parametrize("case", BAD)
def test_an_invalid_basis_is_an_error_with_the_method(case):
    function, problem, got = BAD[case]
    with pytest.raises(UsageError, match=problem) as caught:
        reduced(function)
    text = str(caught.value)
    assert text.startswith("method 'user method'")
    assert re.search(f"got: .*{got}", text)
    assert "expected:" in text


@pytest.mark.parametrize(("count", "listed"), [(1, "columns 1, 3, 5 to 7 of 8"), (12, "columns 1")])
def test_the_hint_about_dependent_columns_removes_all_of_them(count, listed):
    """The hint is run as it is printed; three vectors remain, or as many as there are."""

    def repeated(task):
        V = vectors(task)[:, :3]
        if count > 1:  # many separate runs of dependent columns
            pairs = np.eye(N)[:, :count]
            return np.hstack([np.stack([v, v], axis=1) for v in pairs.T])
        return np.column_stack([V[:, 0], V[:, 0], V[:, 1], 2 * V[:, 1], V[:, 2], V])

    with pytest.raises(UsageError, match="linearly dependent") as caught:
        reduced(lambda task: task.project(repeated(task)))
    assert listed in caught.value.got
    seen = []

    def corrected(task):
        names = {"np": np, "scipy": scipy, "V": repeated(task)}
        exec(caught.value.hint.removeprefix("write "), names)
        seen.append(names["V"])
        return task.project(names["V"])

    with pytest.raises(SimulationError, match="tolerance is out of reach"):
        kc.reduce(chain(), tolerance=1e-9, band=(0, 1e6), method=UserMethod(corrected))
    assert seen[0].shape[1] == (3 if count == 1 else count)


@pytest.mark.parametrize("method", [np.eye(3), UserMethod, 3, UserMethod.basis])
def test_an_object_that_is_not_a_method_is_an_error(method):
    with pytest.raises(UsageError, match="not a reduction method"):
        kc.reduce(chain(), tolerance=1e-3, band=(0, 1e6), method=method)
    with pytest.raises(UsageError, match="not a reduction method"):
        kc.Reduction(chain(), band=(0, 1e6)).reduce(tolerance=1e-3, method=method)


def test_a_method_without_a_name_is_an_error():
    method = UserMethod(vectors)
    method.name = ""
    with pytest.raises(UsageError, match="without a name"):
        kc.reduce(chain(), tolerance=1e-3, band=(0, 1e6), method=method)


def test_an_unknown_method_lists_five_methods_and_states_where_new_ones_work():
    with pytest.raises(UsageError, match=r"kc\.register_reductor") as caught:
        kc.reduce(chain(), tolerance=1e-3, method="OWN")
    assert "response POD of both sides" in caught.value.expected
    assert "in all: kc2spice reduce MODEL --method compare)" in caught.value.expected
    with pytest.raises(UsageError, match=r"'block Krylov'\? For your own method, call kc"):
        kc.reduce(chain(), tolerance=1e-3, method="block Krilov")


@pytest.mark.parametrize(
    ("outputs", "words"), [(1, "stable, passive"), (2, "stable, passivity not shown")]
)
def test_netlist_and_text_of_a_model_state_proven_properties(outputs, words):
    """A second output that is no force at the driven mass leaves no proof of passivity."""
    full = chain(1.0, 1.0)
    signals = kc.LinearModel(
        M=full.M, K=full.K, E=0.02 * full.K, B=full.B, C=np.eye(N)[2 * outputs - 2 :][:1]
    )
    rom = kc.reduce(signals, tolerance=1e-3, band=(0, 0.1))
    assert rom.certificate.stable
    assert rom.certificate.passive == (outputs == 1)
    assert repr(rom).endswith(words)
    header = " ".join(line.lstrip("* ") for line in subcircuit(rom, "chain").text.splitlines())
    assert ("passivity not shown" in header) == (outputs == 2)


def test_the_text_of_a_passive_model_states_passivity():
    assert repr(reduced(lambda task: task.project(static_and_modes(task)))).endswith(
        "stable, passive"
    )


def reasons(**matrices):
    """Reasons of all methods that have no model, by their names."""
    rows = compare_methods(kc.LinearModel(**matrices), band=(0.0, 0.1), tolerance=1e-2)["methods"]
    return {row["method"]: row["reason"] for row in rows}


def test_a_comparison_states_why_a_method_does_not_apply():
    n = 12
    K = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    B = np.eye(n)[:, :1]
    skew = np.eye(n, k=1) - np.eye(n, k=-1)
    damped = {"M": np.eye(n), "E": 0.1 * K, "K": K, "B": B}
    relaxing = reasons(A=-K, B=B, C=B.T)
    assert relaxing["block Krylov"] == "the model is of first order"
    assert "use 'balanced truncation'" in relaxing["unscaled balanced truncation"]
    assert relaxing["IRKA"] is None
    gyroscopic = reasons(**damped | {"E": 0.1 * K + 0.01 * skew})
    assert "not symmetric" in gyroscopic["block Krylov"]
    dashpot = reasons(**damped | {"E": np.diag(np.linspace(0.1, 0.2, n))})
    assert "not proportional" in dashpot["block Krylov"]
    free = K.copy()
    free[0, 0] = free[-1, -1] = 1.0
    grounded = free + 0.5 * np.diag(np.eye(n)[0])
    body = reasons(**damped | {"K": free, "E": 0.1 * grounded})
    assert "rigid-body modes" in body["IRKA"]
    assert "rigid-body modes" in body["frequency-limited balanced truncation"]
    undamped = reasons(**damped | {"E": None})
    assert undamped["balanced truncation"] == "the model is not strictly stable"
    assert undamped["block Krylov"] is None


def test_a_comparison_states_why_a_user_method_does_not_apply(monkeypatch):
    monkeypatch.setattr(registry, "_reductors", dict(registry._reductors))
    method = kc.register_reductor(UserMethod(lambda task: None))
    rows = reasons(M=np.eye(3), K=np.diag([1.0, 4.0, 9.0]), B=np.ones((3, 1)))
    assert rows["user method"] == "its basis() returns None"
    monkeypatch.setattr(method, "applies_to", lambda task: False)
    rows = reasons(M=np.eye(3), K=np.diag([1.0, 4.0, 9.0]), B=np.ones((3, 1)))
    assert rows["user method"] == "its applies_to() returns False"


def test_irka_has_the_size_limit_of_the_balanced_models_that_it_starts_from():
    """251 decoupled masses have 502 first-order states, counted by hand."""
    n = 251
    K, B = np.diag(np.linspace(1.0, 9.0, n)), np.ones((n, 2))
    B[::2, 1] = -1.0
    model = kc.LinearModel(M=np.eye(n), E=0.1 * K, K=K, B=B)
    for method in ("IRKA", "unscaled balanced truncation"):
        with pytest.raises(UsageError, match="502 first-order states, more than 500"):
            kc.reduce(model, order=4, band=(0, 0.1), method=method)


def test_a_comparison_reports_the_number_and_name_of_each_method():
    seen = []
    compare_methods(
        chain(1.0, 1.0), band=(0.0, 0.1), order=2, progress=lambda *item: seen.append(item)
    )
    names = registry.list_reductor_names()
    texts = [text for _, _, text in seen if text.startswith("method ")]
    assert texts == [f"method {k + 1} of {len(names)}: {name}" for k, name in enumerate(names)]


def test_the_page_on_methods_states_their_size_limits():
    """The numbers in the column of limits are those in the errors of the methods."""
    page = (Path(__file__).parents[2] / "docs/how-to/own_reductor.md").read_text()
    cells = [row.split(" | ") for row in page.splitlines() if row.startswith("| `")]
    limits = {name.strip("| `"): re.findall(r"\d{3,}", limit) for name, _, limit, _ in cells}
    assert set(limits) <= set(registry.list_reductor_names())
    for name, size in {
        "balanced truncation": balanced_truncation.MAX_STATES,
        "balanced truncation by congruence": balanced_truncation.MAX_STATES,
        "unscaled balanced truncation": balanced_truncation.MAX_UNSCALED_STATES,
        "frequency-limited balanced truncation": band_limited_balancing.MAX_STATES,
        "IRKA": balanced_truncation.MAX_UNSCALED_STATES,
    }.items():
        assert limits.pop(name) == [str(size)]
    assert not any(limits.values())


def test_a_basis_with_too_few_vectors_is_the_cause_in_the_error():
    """Two modes of 40 lack the static compliance of the driven mass."""

    def two_modes(task):
        return task.project(vectors(task)[:, :2])

    with pytest.raises(SimulationError, match="has only 2 vectors") as caught:
        reduced(two_modes, tolerance=1e-6)
    assert "with 2 basis vectors" in caught.value.got
    assert "more vectors from basis()" in caught.value.hint
    with pytest.raises(UsageError, match="basis of the reduction method has fewer") as caught:
        reduced(two_modes, order=3)
    assert caught.value.expected == "1 to 2"
    few_points = kc.Reduction(chain(), band=(0, 0.1 * np.sqrt(1e15)), points=[0.0])
    with pytest.raises(SimulationError, match=r"has only \d vector") as caught:
        few_points.reduce(tolerance=1e-9)
    assert "add expansion points" in caught.value.hint


@pytest.mark.parametrize("key", ["rom.method", "disc.rom.method"])
def test_a_scene_without_methods_names_the_commands_that_have_them(key):
    with pytest.raises(UsageError, match="unknown key") as caught:
        kc.load_scene("buzzer_7bb_20_6", {key: "IRKA"})
    assert "--method" in caught.value.hint
    assert "kc.reduce" in caught.value.hint


def test_a_name_of_a_built_in_method_is_not_replaced(monkeypatch):
    """The proposed name works, and may be registered again with another method."""
    monkeypatch.setattr(registry, "_reductors", dict(registry._reductors))
    method = UserMethod(lambda task: task.project(static_and_modes(task)))
    method.name = "response POD"
    with pytest.raises(UsageError, match="built-in reduction method has this name") as caught:
        kc.register_reductor(method)
    assert not isinstance(registry.find_reductor("response POD"), UserMethod)
    method.name = re.search(r"name = '(.+)'", caught.value.hint).group(1)
    for _ in range(2):
        assert kc.register_reductor(method).name == "my response POD"
    assert kc.reduce(chain(), tolerance=1e-3, method="my response POD").certificate.passive
    (built_in,) = (item for item in registry._BUILT_IN if item.name == "block Krylov")
    assert kc.register_reductor(built_in) is built_in


def test_two_methods_of_the_same_name_have_separate_bases():
    """One model is reduced by the lowest 4 modes, then by the next 4; frequencies by hand."""
    reduction = kc.Reduction(chain(), band=(0, 0.1 * np.sqrt(1e9 / 1e-6)))
    lowest = np.sort(np.sqrt(eigh(chain().K, chain().M)[0]))
    for first in (0, 4):
        method = UserMethod(
            lambda task, k=first: task.project(eigh(task.model.K, task.model.M)[1][:, k : k + 4])
        )
        rom = reduction.reduce(order=4, method=method)
        np.testing.assert_allclose(
            np.sort(np.sqrt(eigh(rom.K, rom.M)[0])), lowest[first : first + 4], rtol=1e-9
        )


@pytest.mark.parametrize("place", ["basis", "applies_to", "obstacle"])
def test_an_exception_in_a_user_method_is_an_error_with_its_line(place, monkeypatch):
    def broken(*_):
        return 1 / 0

    method = UserMethod(vectors)
    monkeypatch.setattr(method, place, broken)
    for reduce in (kc.reduce, lambda model, **keys: kc.Reduction(model, band=keys["band"]).reduce(
        order=keys["order"], method=keys["method"])):  # fmt: skip
        with pytest.raises(UsageError, match="ZeroDivisionError: division by zero") as caught:
            reduce(chain(), order=3, band=(0, 1e6), method=method)
        assert str(caught.value).startswith("method 'user method': broken of this")
        line = broken.__code__.co_firstlineno + 1
        assert caught.value.hint == f"correct line {line} of {__file__}"
        assert isinstance(caught.value.__cause__, ZeroDivisionError)
    monkeypatch.setattr(method, place, lambda: None)
    with pytest.raises(UsageError, match="raises TypeError") as caught:
        kc.reduce(chain(), order=3, band=(0, 1e6), method=method)
    assert caught.value.hint == "correct UserMethod"


@pytest.mark.parametrize("aim", [{"tolerance": 1e-2}, {"order": 6}])
def test_a_comparison_has_a_row_for_the_default_choice(aim):
    """The row agrees with the reduction without a method."""
    model = chain(1.0, 1.0)
    result = compare_methods(model, band=(0.0, 0.1), **aim)
    (row,) = (row for row in result["methods"] if row["method"] == "default")
    rom = kc.reduce(model, band=(0.0, 0.1), norm=result["norm"], **aim)
    assert (row["order"], row["states"]) == (rom.order, 2 * rom.order)
    assert row["error_estimate"] == pytest.approx(rom.certificate.error_estimate)
    assert row["reason"] is None
