"""The material library against published stress-charge constants; tensor algebra; errors."""

import itertools
import tomllib
from pathlib import Path

import docs_numbers
import numpy as np
import pytest
from scipy.constants import epsilon_0
from support import UsageError, find_material, materials

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "materials.md"
PAIRS = [(0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1)]


def full_stiffness(C):
    """c_ijkl of a Voigt matrix."""
    c = np.zeros((3, 3, 3, 3))
    for (I, (i, j)), (J, (k, l)) in itertools.product(enumerate(PAIRS), repeat=2):
        for a, b in {(i, j), (j, i)}:
            for p, q in {(k, l), (l, k)}:
                c[a, b, p, q] = C[I, J]
    return c


def full_coupling(e):
    """e_ijk of a Voigt matrix."""
    t = np.zeros((3, 3, 3))
    for J, (j, k) in enumerate(PAIRS):
        t[:, j, k] = t[:, k, j] = e[:, J]
    return t


@pytest.mark.parametrize(
    ("name", "stiffness", "coupling"),
    [  # B. A. Auld, Acoustic Fields and Waves in Solids, 1973, appendix 2 (stress-charge form)
        ("PZT-4", (139, 77.8, 74.3, 115, 25.6, 30.6), (-5.2, 15.1, 12.7)),
        ("PZT-5A", (121, 75.4, 75.2, 111, 21.1, 22.6), (-5.4, 15.8, 12.3)),
        ("PZT-5H", (126, 79.5, 84.1, 117, 23.0, 23.5), (-6.5, 23.3, 17.0)),
        ("PZT-8", (149, 81.1, 81.1, 132, 31.3, 32.9), (-4.0, 13.8, 10.3)),
    ],
)
def test_strain_charge_data_convert_to_the_published_stress_charge_form(name, stiffness, coupling):
    m = find_material(name)
    C = m.C / 1e9
    np.testing.assert_allclose(
        [C[0, 0], C[0, 1], C[0, 2], C[2, 2], C[3, 3], C[5, 5]], stiffness, rtol=0.02
    )
    np.testing.assert_allclose([m.e[2, 0], m.e[2, 2], m.e[0, 4]], coupling, rtol=0.04)


def test_permittivity_at_stress_and_strain_and_the_strain_coefficients():
    m = find_material("PZT-5A")
    np.testing.assert_allclose(np.diag(m.eps_T) / epsilon_0, [1730, 1730, 1700], rtol=1e-12)
    np.testing.assert_allclose(np.diag(m.eps_S) / epsilon_0, [916, 916, 830], rtol=5e-3)
    np.testing.assert_allclose(m.d[2] * 1e12, [-171, -171, 374, 0, 0, 0], atol=1e-9)
    paper = find_material("THP51")
    np.testing.assert_allclose(np.diag(paper.eps_S) / epsilon_0, [1934, 1934, 803.5], rtol=1e-4)


def test_quartz_has_its_known_strain_coefficients():
    d = find_material("quartz").d * 1e12  # Bechmann 1958: d11 = 2.31, d14 = 0.727 pC/N
    assert d[0, 0] == pytest.approx(2.31, rel=3e-3)
    assert d[0, 3] == pytest.approx(0.727, rel=3e-3)
    assert d[1, 5] == pytest.approx(-2 * 2.31, rel=3e-3)
    c = full_stiffness(find_material("quartz").C)
    a = 2 * np.pi / 3  # trigonal: unchanged by a third of a turn about z
    R = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    turned = np.einsum("ai,bj,ck,dl,ijkl", R, R, R, R, c, optimize=True)
    np.testing.assert_allclose(turned, c, atol=2e-3 * 107e9)


@pytest.mark.parametrize("name", ["PZT-5H", "quartz"])
@pytest.mark.parametrize("direction", [(0, 0, -1), (1, 0, 0), (0, -2, 0), (0.3, -0.5, 0.7)])
def test_poling_turns_every_tensor_by_its_indices(name, direction):
    m, n = find_material(name), np.array(direction) / np.linalg.norm(direction)
    turned = m.rotate_z_axis(direction)
    axis, angle = np.cross([0, 0, 1], n), np.arccos(n[2])
    axis = axis / np.linalg.norm(axis) if np.linalg.norm(axis) > 0 else np.array([1.0, 0, 0])
    K = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    R = np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K
    np.testing.assert_allclose(R @ [0, 0, 1], n, atol=1e-14)
    c = np.einsum("ai,bj,ck,dl,ijkl", R, R, R, R, full_stiffness(m.C), optimize=True)
    e = np.einsum("ai,bj,ck,ijk", R, R, R, full_coupling(m.e), optimize=True)
    np.testing.assert_allclose(full_stiffness(turned.C), c, atol=1e-9 * np.abs(c).max())
    np.testing.assert_allclose(full_coupling(turned.e), e, atol=1e-9 * np.abs(e).max())
    np.testing.assert_allclose(turned.eps_S, R @ m.eps_S @ R.T, atol=1e-12 * m.eps_S.max())


STEEL = {"density": 7860, "youngs_modulus": 210e9, "poisson_ratio": 0.3}
PZT = {
    "density": 7750,
    "symmetry": "hexagonal",
    "stiffness": {"c11": 121e9, "c12": 75.4e9, "c13": 75.2e9, "c33": 111e9, "c44": 21.1e9},
    "stress_coupling": {"e31": -5.4, "e33": 15.8, "e15": 12.3},
    "permittivity": {"eps11": 916, "eps33": 830},
    "permittivity_at": "strain",
}


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ("PZT-5B", "this material does not exist"),
        (STEEL | {"poisson_ratio": 0.51}, "Poisson ratio"),
        (STEEL | {"poisson_ratio": -1}, "Poisson ratio"),
        (STEEL | {"youngs_modulus": 210}, "outside of the range of all materials"),
        (STEEL | {"youngs_modulus": "210 GHz"}, "wrong unit"),
        (STEEL | {"youngs_modulus": [1e9, 2e9]}, "do not define an elastic material"),
        (STEEL | {"density": -1}, "> 0"),
        (STEEL | {"colour": "grey"}, "unknown key"),
        (STEEL | {"sources": {"colour": "me"}}, "contains unknown keys"),
        ({"density": 1000}, "exactly one of"),
        (PZT | {"permittivity_at": "stress"}, "constant strain"),  # eps^S as eps^T
        ({k: v for k, v in PZT.items() if k != "permittivity_at"}, "permittivity_at"),
        (PZT | {"symmetry": "monoclinic"}, "not one of the choices"),
        ({k: v for k, v in PZT.items() if k != "symmetry"}, "need the key `symmetry`"),
        (PZT | {"stiffness": {"c11": 121e9, "c12": 75e9}}, "do not match the symmetry"),
        (PZT | {"stiffness": [[1e9, 0], [0, 1e9]]}, "wrong number of entries"),
        (PZT | {"stiffness": (np.eye(6) * 1e11 + np.eye(6, k=1) * 1e10).tolist()}, "not symmetric"),
        (PZT | {"permittivity": {"eps33": 830}}, "components of a permittivity"),
        (PZT | {"conductor": True}, "cannot have piezoelectric constants"),
    ],
)
def test_impossible_materials_are_refused_with_a_reason(table, says):
    if isinstance(table, dict) and table.get("permittivity_at") == "stress":
        table = table | {"permittivity": {"eps11": 800, "eps33": 500}}
    with pytest.raises(UsageError) as caught:
        find_material(table, "disc.materials.A")
    assert says in str(caught.value)


# Constants of PZT-5A in units that the table does not have, and the constants in SI units.
WRONG_UNITS = {
    "permittivity in F/m": (
        {"permittivity": {"eps11": 1730.0, "eps33": 1700 * epsilon_0}},
        "write  eps33 = 1700  if",
        {"permittivity": {"eps11": 1730.0, "eps33": 1700}},
    ),
    "permittivity in F/m at strain": (
        {"permittivity": {"eps33": 1.5e-8}, "permittivity_at": "strain"},
        "write  eps33 = 1694  if",
        {"permittivity": {"eps33": 1694}, "permittivity_at": "strain"},
    ),
    "pC/N": (
        {"strain_coupling": {"d31": -171, "d33": 374, "d15": 584}},
        "write  d31 = -171e-12, d33 = 374e-12, d15 = 584e-12  if",
        {"strain_coupling": {"d31": -171e-12, "d33": 374e-12, "d15": 584e-12}},
    ),
    "one value in pC/N, at strain": (
        {"strain_coupling": {"d33": 374}, "permittivity_at": "strain"},
        "write  d33 = 374e-12  if",
        {"strain_coupling": {"d33": 374e-12}, "permittivity_at": "strain"},
    ),
    "nC/N": (
        {"strain_coupling": {"d33": 0.374}},
        "write  d33 = 0.374e-9  if",
        {"strain_coupling": {"d33": 0.374e-9}},
    ),
    "one value in 1/TPa": (
        {"compliance": {"s44": 47.5}},
        "write  s44 = 47.5e-12  if",
        {"compliance": {"s44": 47.5e-12}},
    ),
    "an off-diagonal value in GPa": (
        PZT | {"stiffness": PZT["stiffness"] | {"c13": 75.2, "c44": 21.1}},
        "write  c13 = 75.2e9, c44 = 21.1e9  if",
        PZT,
    ),
    "GPa": (
        PZT | {"stiffness": {"c11": 121, "c12": 75.4, "c13": 75.2, "c33": 111, "c44": 21.1}},
        "write  c11 = 121e9, c12 = 75.4e9, c13 = 75.2e9, c33 = 111e9, c44 = 21.1e9  if",
        PZT,
    ),
    "one modulus in GPa": (
        STEEL | {"youngs_modulus": 0.5},
        'write  youngs_modulus = "0.5 GPa"',
        STEEL | {"youngs_modulus": "0.5 GPa"},
    ),
    "mC/m2": (
        PZT | {"stress_coupling": {"e31": -5400, "e33": 15800, "e15": 12300}},
        "write  e31 = -5400e-3, e33 = 15800e-3, e15 = 12300e-3  if",
        PZT | {"stress_coupling": {"e31": -5400e-3, "e33": 15800e-3, "e15": 12300e-3}},
    ),
}


@pytest.mark.parametrize("case", WRONG_UNITS)
def test_a_constant_in_another_unit_is_refused_with_its_value_in_si(case):
    wrong, advice, right = WRONG_UNITS[case]
    tables = [t if "density" in t else {"like": "PZT-5A"} | t for t in (wrong, right)]
    with pytest.raises(UsageError) as caught:
        find_material(tables[0], "disc.material")
    assert caught.value.hint.startswith(advice)
    assert find_material(tables[1], "disc.material").density > 0


def test_a_coupling_factor_near_one_is_refused():
    """The coupling factor k, with k^2 = d^2 C / eps^T, is nearly 1 for eps^S = 3 eps_0."""
    table = PZT | {"permittivity": {"eps11": 3.0, "eps33": 3.0}}
    with pytest.raises(UsageError, match="too large for this permittivity") as caught:
        find_material(table)
    ceramic = find_material(PZT)
    coupled = ceramic.e @ np.linalg.solve(ceramic.C, ceramic.e.T)
    square = np.diag(coupled) / (np.diag(coupled) + 3.0 * epsilon_0)
    assert f"{np.sqrt(square.max()):.4g}" in caught.value.got
    with pytest.raises(UsageError) as caught:
        find_material(table | {"permittivity_at": "stress"})
    assert caught.value.hint.startswith('write  permittivity_at = "strain"')


@pytest.mark.parametrize(
    "table",
    [
        # gel: nearly incompressible, with a shear modulus of 1 kPa
        {"density": 1000, "youngs_modulus": 3e3, "poisson_ratio": 0.4999995},
        # relaxor crystal PZN-8%PT (Zhang et al., J. Appl. Phys. 90 (2001) 3471)
        {"density": 8315, "symmetry": "orthotropic",
         "stiffness": {"c11": 105e9, "c12": 96e9, "c13": 95.5e9, "c22": 105e9, "c23": 95.5e9,
                       "c33": 105.5e9, "c44": 64e9, "c55": 64e9, "c66": 65e9},
         "stress_coupling": {"e31": -5.1, "e32": -5.1, "e33": 15.4, "e15": 10.1, "e24": 10.1},
         "permittivity": {"eps11": 2720, "eps33": 984}, "permittivity_at": "strain"},
        # polymer film, and a fibre that is much stiffer along its axis
        {"density": 1780, "symmetry": "6mm",
         "stiffness": {"c11": 3.6e9, "c12": 1.6e9, "c13": 1.5e9, "c33": 1.6e9, "c44": 0.6e9},
         "strain_coupling": {"d31": 23e-12, "d33": -33e-12, "d15": -27e-12},
         "permittivity": {"eps11": 12}, "permittivity_at": "stress"},
        {"density": 40, "youngs_modulus": [1e5, 1e5, 1e9],
         "poisson_ratio": {"nu_xy": 0.3, "nu_yz": 0.0, "nu_xz": 0.0},
         "shear_modulus": {"g_yz": 1e7, "g_xz": 1e7, "g_xy": 1e5}},
    ],
)  # fmt: skip
def test_unusual_materials_are_accepted(table):
    assert find_material(table).name


def test_the_page_has_every_built_in_material_with_its_source():
    page, _, _ = PAGE.read_text("utf-8").partition("## Constants of built-in materials")
    library = tomllib.loads((Path(materials.__file__).with_suffix(".toml")).read_text("utf-8"))
    for name, table in library.items():
        (row,) = [line for line in page.splitlines() if line.startswith(f"| `{name}` |")]
        assert f"| {table['density']:g} |" in row
        assert all(said in row for said in (table["source"], *table.get("sources", {}).values()))
    assert all(f"| `{key}` |" in page for key in materials.MaterialTable.model_fields)


def read_constants(name):
    """The constants of a material in the tables of the page, keyed by the head of the column."""
    _, _, text = PAGE.read_text("utf-8").partition("## Constants of built-in materials")
    head = []
    for line in text.splitlines():
        cells = [cell.strip() for cell in line.strip("| ").split(" | ")]
        if cells[0] == "material":
            head = cells
        elif cells[0] == f"`{name}`":
            return dict(zip(head, cells, strict=False))
    raise AssertionError(f"{name} is not in a table")


def test_the_constants_of_the_page_are_those_of_the_library():
    """PIC255: numpy's inverse of the stiffness c11 … c44 that its source states."""
    differences = docs_numbers.renewed(PAGE)[1]
    assert not differences, "\n".join(map(str, differences))
    c11, c12, c13, c33, c44 = 119, 84, 83, 117, 21  # GPa
    C = np.diag([c11, c11, c33, c44, c44, (c11 - c12) / 2]).astype(float)
    C[0, 1] = C[1, 0] = c12
    C[:2, 2] = C[2, :2] = c13
    s = np.linalg.inv(C)  # 1e-9/Pa
    e31, e33, e15 = -6.03, 15.49, 12.09  # C/m2
    d31 = e31 * (s[0, 0] + s[0, 1]) + e33 * s[0, 2]
    d33 = 2 * e31 * s[0, 2] + e33 * s[2, 2]
    eps33 = 743.2 + 1e-9 * (2 * e31 * d31 + e33 * d33) / epsilon_0
    expected = {"s11": 1e3 * s[0, 0], "s13": 1e3 * s[0, 2], "s33": 1e3 * s[2, 2], "eps33": eps33}
    expected |= {"d31": 1e3 * d31, "d33": 1e3 * d33, "d15": 1e3 * e15 / c44}
    shown = read_constants("PIC255")
    assert {name: float(shown[name]) for name in expected} == pytest.approx(expected, rel=5e-4)


def test_the_constants_of_quartz_are_those_of_bechmann():
    """R. Bechmann, Phys. Rev. 110 (1958) 1060, table: d11 = 2.31 and d14 = 0.727 pC/N."""
    others = dict(pair.split(" = ") for pair in read_constants("quartz")["others"].split(", "))
    assert float(others["d11"]) == pytest.approx(2.31, rel=2e-3)
    assert float(others["d14"]) == pytest.approx(0.727, rel=3e-3)


@pytest.mark.parametrize(
    ("said", "name"), [("6mm", "PZT-4"), ("∞m", "PZT-8"), ("32", "quartz"), ("m3m", "silicon")]
)
def test_point_groups_mean_their_class(said, name):
    library = tomllib.loads((Path(materials.__file__).with_suffix(".toml")).read_text("utf-8"))
    np.testing.assert_array_equal(
        find_material({**library[name], "symmetry": said}).C, find_material(name).C
    )
    with pytest.raises(UsageError, match="symmetry"):
        find_material({**library[name], "symmetry": "3m"})
