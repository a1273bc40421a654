"""Matrices that depend on parameters, against direct solutions by numpy at fresh values."""

import subprocess
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from scipy import sparse
from support import UsageError, export_rom, list_dialect_names, read_parametric_model, reduce_file

import kc2spice as kc

ELEMENTS, BETA, BAND = 20, 1e-3, (0.0, 5.0)
TIP = kc.Port("tip", "mechanical")


def cantilever():
    """Stiffness and mass of an Euler-Bernoulli cantilever of unit length, EI and mass.

    Its unknowns are deflection and slope of each node. (Przemieniecki, Theory of Matrix Structural
    Analysis, 1968, chapters 5 and 11.)
    """
    h = 1 / ELEMENTS
    k = [[12, 6 * h, -12, 6 * h], [6 * h, 4 * h**2, -6 * h, 2 * h**2]]
    k = np.array([*k, [-12, -6 * h, 12, -6 * h], [6 * h, 2 * h**2, -6 * h, 4 * h**2]]) / h**3
    m = [[156, 22 * h, 54, -13 * h], [22 * h, 4 * h**2, 13 * h, -3 * h**2]]
    m = [*m, [54, 13 * h, 156, -22 * h], [-13 * h, -3 * h**2, -22 * h, 4 * h**2]]
    K, M = np.zeros((2, 2 * ELEMENTS + 2, 2 * ELEMENTS + 2))
    for element in range(ELEMENTS):
        rows = slice(2 * element, 2 * element + 4)
        K[rows, rows] += k
        M[rows, rows] += h / 420 * np.array(m)
    return K[2:, 2:], M[2:, 2:]


K, M = cantilever()
LOAD = np.eye(2 * ELEMENTS)[-2]  # deflection of the tip
PARAMETERS = (
    kc.ModelParameter("thickness", 1.0, 0.8, 1.25, "mm", "thickness of the beam"),
    kc.ModelParameter("tip_mass", 0.2, 0.1, 0.4, "kg"),
)


def loaded_beam(parameters=PARAMETERS, tip=TIP):
    """A beam whose stiffness goes with the cube of its thickness, with a mass at its tip."""
    zero = sparse.csc_array(K.shape)
    fixed = kc.LinearModel(
        M=zero, K=zero, B=LOAD[:, None], ports=(tip,) if tip else (), rayleigh=(0.0, BETA)
    )
    terms = [
        ("K", K, lambda p: p["thickness"] ** 3),
        ("M", M, lambda p: p["thickness"]),
        ("M", np.outer(LOAD, LOAD), lambda p: p["tip_mass"]),
    ]
    return kc.AffineModel(fixed, terms, parameters)


def tip_compliance(frequency, thickness, tip_mass):
    """Deflection of the tip per unit force by direct solutions."""
    stiffness, mass = thickness**3 * K, thickness * M + tip_mass * np.outer(LOAD, LOAD)
    result = []
    for s in 2j * np.pi * frequency:
        dynamic = (1 + BETA * s) * stiffness + s**2 * mass
        result.append(np.linalg.solve(dynamic, LOAD)[-2])
    return np.array(result)


@pytest.fixture(scope="module")
def reduced():
    return kc.reduce(loaded_beam(), tolerance=1e-4, band=BAND)


def fresh_values():
    """Corners of the ranges and random values between them."""
    rng = np.random.default_rng(20)
    corners = [(0.8, 0.1), (0.8, 0.4), (1.25, 0.1), (1.25, 0.4)]
    inside = zip(rng.uniform(0.8, 1.25, 4), rng.uniform(0.1, 0.4, 4), strict=True)
    return [*corners, *inside]


def test_the_error_estimate_is_valid_at_corners_and_random_values(reduced):
    estimate = reduced.certificate.error_estimate
    frequency, errors = np.linspace(0.01, BAND[1], 200), []
    for thickness, tip_mass in fresh_values():
        model = reduced.evaluate({"thickness": thickness, "tip_mass": tip_mass})
        exact = tip_compliance(frequency, thickness, tip_mass)
        errors.append(np.abs(model.transfer(frequency)[:, 0, 0] / exact - 1).max())
    assert max(errors) <= estimate <= 1e-4
    assert reduced.certificate.passive
    assert reduced.order < 8


def test_subcircuit_has_the_parameters_and_answers_as_direct_solutions(reduced, tmp_path):
    library = kc.parametric_subcircuit(reduced, "beam")
    thickness = next(item for item in library.params if item.name == "thickness")
    assert (thickness.default, thickness.unit, thickness.low) == (1.0, "mm", pytest.approx(0.8))
    frequency = np.array([0.1, 0.5, 2.0])
    exact = tip_compliance(frequency, 0.9, 0.3)
    lines = [
        "beam",
        library.text,
        "X1 tip 0 beam thickness=0.9 tip_mass=0.3",
        "I1 0 tip DC 0 AC 1",
    ]
    for f, value in zip(frequency, exact, strict=True):
        got = _ngspice_response([*lines, f".ac lin 1 {f} {f}"], tmp_path)
        assert got == pytest.approx(1e6 * value, rel=2e-4)


def _ngspice_response(lines, folder):
    """Voltage of the node ``tip`` in an analysis of one frequency."""
    (response,) = _ngspice_responses(lines, folder)
    return response


def _ngspice_responses(lines, folder, more=()):
    """Voltages of the node ``tip``, also after more commands of ngspice."""
    deck = folder / "deck.cir"
    control = [".control", "run", "print real(v(tip)) imag(v(tip))", *more, ".endc", ".end"]
    deck.write_text("\n".join([*lines, *control]))
    command = ["ngspice", "-b", deck.name]
    output = subprocess.run(command, capture_output=True, text=True, cwd=folder).stdout
    words = [line.split()[-1] for line in output.splitlines() if line.startswith(("real", "imag"))]
    numbers = np.array(words, dtype=float)
    return list(numbers[::2] + 1j * numbers[1::2])


def test_a_parameter_of_the_wrong_kind_is_refused():
    with pytest.raises(UsageError, match="outside of the range"):
        kc.ModelParameter("k", 3.0, 1.0, 2.0)
    with pytest.raises(UsageError, match="not a valid range"):
        kc.ModelParameter("k", 0.0, -1.0, 2.0)
    with pytest.raises(UsageError, match="not a valid name"):
        kc.ModelParameter("2k", 1.0, 1.0, 2.0)
    with pytest.raises(UsageError, match="list of parameters is not valid"):
        loaded_beam(parameters=())
    with pytest.raises(UsageError, match="list of parameters is not valid"):
        loaded_beam(parameters=(PARAMETERS[0], PARAMETERS[0]))
    with pytest.raises(UsageError, match="the model has no such parameter"):
        loaded_beam().evaluate({"thick": 1.0})


def test_wrong_terms_end_with_an_error_that_names_them():
    beam = loaded_beam()
    with pytest.raises(UsageError, match="cannot depend on parameters"):
        kc.AffineModel(beam.model, [("E", K, lambda p: 1.0)], PARAMETERS)
    small = kc.AffineModel(beam.model, [("K", np.eye(2), lambda p: 1.0)], PARAMETERS)
    with pytest.raises(UsageError, match="matrix K has a wrong size"):
        small.evaluate({})
    infinite = kc.AffineModel(
        beam.model, [("K", K, lambda p: 1 / (p["thickness"] - 1))], PARAMETERS
    )
    with pytest.raises(UsageError, match="is not a number"):
        infinite.evaluate({})


def test_a_negative_stiffness_in_the_ranges_is_refused():
    terms = [("M", M, lambda p: 1.0), ("K", K, lambda p: p["thickness"] - 1.1)]
    beam = kc.AffineModel(loaded_beam().model, terms, PARAMETERS[:1])
    with pytest.raises(UsageError, match="not positive definite"):
        kc.reduce(beam, tolerance=1e-3, band=BAND)


def test_options_of_other_reductions_are_refused():
    with pytest.raises(UsageError, match="does not apply"):
        kc.reduce(loaded_beam(), tolerance=1e-3, order=4)
    with pytest.raises(UsageError, match="a model with parameters needs a tolerance"):
        kc.reduce(loaded_beam())


SIDECAR = """
band = [0, 5]
damping = { alpha = 0, beta = 1e-3 }

[parameters]
thickness = { default = 1.0, low = 0.8, high = 1.25, unit = "mm" }
tip_mass = { default = 0.2, low = 0.1, high = 0.4, unit = "kg" }

[[terms]]
matrix = "K"
factor = "thickness^3"

[[terms]]
matrix = "M"
factor = "thickness"

[[terms]]
matrix = "M"
name = "M_tip"
factor = "tip_mass"

[[ports]]
name = "tip"
kind = "mechanical"
column = 1
"""


@pytest.fixture
def folder(tmp_path):
    """Files of the loaded beam: one archive and its TOML file."""
    np.savez(tmp_path / "beam.npz", K=K, M=M, M_tip=np.outer(LOAD, LOAD), B=LOAD[:, None])
    (tmp_path / "beam.toml").write_text(SIDECAR)
    return tmp_path


def test_files_give_the_matrices_at_any_values(folder):
    beam, values = kc.read_affine_model(folder / "beam"), {"thickness": 0.9, "tip_mass": 0.3}
    frequency = np.array([0.1, 2.0])
    exact = tip_compliance(frequency, **values)
    assert np.allclose(beam.evaluate(values).transfer(frequency)[:, 0, 0], exact, rtol=1e-9)
    default = kc.read_model(folder / "beam.npz")
    exact = tip_compliance(frequency, 1.0, 0.2)
    assert np.allclose(default.transfer(frequency)[:, 0, 0], exact, rtol=1e-9)
    assert default.band == (0.0, 5.0)


def test_terms_may_be_files_of_their_own(folder):
    scipy.io.mmwrite(folder / "tip.mtx", sparse.csc_array(np.outer(LOAD, LOAD)))
    text = SIDECAR.replace('name = "M_tip"', 'file = "tip.mtx"')
    (folder / "beam.toml").write_text(text)
    other = kc.read_affine_model(folder / "beam").evaluate({"tip_mass": 0.35})
    assert np.allclose(other.M.toarray(), M + 0.35 * np.outer(LOAD, LOAD))


def test_files_without_parameters_are_no_affine_model(folder):
    (folder / "beam.toml").unlink()
    assert kc.read_affine_model(folder / "beam.npz") is None


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"thickness^3"', '"thickness^"', "not an expression"),
        ('"thickness^3"', '"width^3"', "no such parameter"),
        ('"thickness^3"', '"V(a)"', "not a number"),
        ('factor = "thickness^3"', 'factor = "' + "(" * 199 + '"', "expression"),
        ('"thickness^3"', '"1/(thickness-1)"', "is not a number"),
        ('"M_tip"', '"M_top"', "the file contains no matrix M_top"),
        ('name = "M_tip"', 'file = "other.mtx"', "does not exist"),
        ('name = "M_tip"', 'file = "../beam.npz"', "not in the folder of"),
        ('matrix = "K"', 'matrix = "E"', "terms"),
        ("default = 0.2", "default = 0.5", "outside of the range"),
        ("low = 0.1", "low = -0.1", "not a valid range"),
        ("tip_mass = {", "'tip mass' = {", "no such parameter|no name"),
    ],
)
def test_wrong_keys_are_named(folder, old, new, message):
    assert old in SIDECAR
    (folder / "beam.toml").write_text(SIDECAR.replace(old, new))
    with pytest.raises(UsageError, match=message) as error:
        kc.read_affine_model(folder / "beam").evaluate({})
    assert "Traceback" not in str(error.value)


def test_parameters_and_terms_need_each_other(folder):
    text = "[[ports]]" + SIDECAR.partition("[[ports]]")[2]
    (folder / "beam.toml").write_text('terms = [{ matrix = "K", factor = "2" }]\n' + text)
    with pytest.raises(UsageError, match="parameters are missing"):
        kc.read_affine_model(folder / "beam")


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """The result of ``kc2spice reduce`` for the files of the loaded beam."""
    place = tmp_path_factory.mktemp("affine")
    np.savez(place / "beam.npz", K=K, M=M, M_tip=np.outer(LOAD, LOAD), B=LOAD[:, None])
    (place / "beam.toml").write_text(SIDECAR)
    return reduce_file(place / "beam", place / "out", tolerance=1e-3)


def test_the_command_writes_a_model_that_comes_back(written):
    assert written["files"] == ["beam_rom.npz", "beam_rom.json"]
    assert written["error_estimate"] < 1e-3
    assert written["parameters"]["tip_mass"]["unit"] == "kg"
    varying = read_parametric_model(written["rom"])
    assert varying.certificate.band_hz == (0.0, 5.0)
    frequency = np.array([0.1, 2.0])
    values = {"thickness": 0.83, "tip_mass": 0.37}
    exact = tip_compliance(frequency, **values)
    assert varying.evaluate(values).transfer(frequency)[:, 0, 0] == pytest.approx(exact, rel=1e-3)


def test_every_dialect_has_the_parameters(written, tmp_path):
    for dialect in list_dialect_names():
        files = export_rom(written["rom"], tmp_path / dialect, dialect=dialect)
        library = next(path for path in files if path.suffix in (".lib", ".va"))
        text = library.read_text()
        assert "tip_mass" in text
        assert "0.1..0.4" in text
    with pytest.raises(UsageError, match="--dense does not apply"):
        export_rom(written["rom"], tmp_path / "dense", dense=True)


def test_alterparam_of_ngspice_changes_the_parameter(written, tmp_path):
    export_rom(written["rom"], tmp_path)
    lines = [
        "beam",
        ".include beam_rom.lib",
        ".param mass=0.2",
        "X1 tip 0 beam_rom tip_mass={mass}",
        "I1 0 tip DC 0 AC 1",
        ".ac lin 1 0.5 0.5",
    ]
    first, second = (1e6 * tip_compliance(np.array([0.5]), 1.0, mass)[0] for mass in (0.2, 0.4))
    change = ["alterparam mass=0.4", "reset", "run", "print real(v(tip)) imag(v(tip))"]
    got = _ngspice_responses(lines, tmp_path, change)
    assert got == pytest.approx([first, second], rel=2e-3)
    assert abs(first / second - 1) > 0.1


def _damage(path, **changes):
    arrays = dict(np.load(path)) | changes
    np.savez(path, **arrays)


@pytest.mark.parametrize(
    "changes",
    [
        {"diagonal": np.zeros((3, 2))},
        {"gain": np.array(["a"])},
        {"exponents": np.array([[1000, 0]])},
        {"record": np.array("{}")},
    ],
)
def test_damaged_files_are_refused(written, tmp_path, changes):
    path = tmp_path / "beam_rom.npz"
    path.write_bytes(Path(written["rom"]).read_bytes())
    _damage(path, **changes)
    with pytest.raises(UsageError, match="not a reduced model"):
        export_rom(path, tmp_path / "out")


def test_records_with_commands_are_refused(written, tmp_path):
    path = tmp_path / "beam_rom.npz"
    record = str(np.load(written["rom"])["record"]).replace('"kg"', '"kg\\n.control"')
    path.write_bytes(Path(written["rom"]).read_bytes())
    _damage(path, record=np.array(record))
    with pytest.raises(UsageError, match="a text has a line break"):
        export_rom(path, tmp_path / "out")


def test_options_of_other_models_are_refused(folder):
    with pytest.raises(UsageError, match="does not apply"):
        reduce_file(folder / "beam", folder / "out", order=4)
    (folder / "beam.toml").write_text(SIDECAR.partition("[[ports]]")[0])
    with pytest.raises(UsageError, match="must be electrical, mechanical, rotational or acoustic"):
        reduce_file(folder / "beam", folder / "out")
