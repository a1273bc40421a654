"""Readers that convert matrices of other programs to linear models.

The readers return linear models with named ports. The matrices come from finite-element programs,
such as Abaqus, Ansys, CalculiX, COMSOL and Nastran.
"""

from __future__ import annotations

import contextlib
import glob
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from itertools import product
from operator import attrgetter
from pathlib import Path

import numpy as np

from kc2spice.bodies.readers import fem_program_formats, raw_matrices
from kc2spice.bodies.readers import sidecar as _sidecar
from kc2spice.bodies.readers.matrix_assembly import LabelledMatrices, assemble_model
from kc2spice.bodies.readers.matrix_model_parameters import (
    get_default_values,
    make_model_parameter,
    make_term,
)
from kc2spice.bodies.readers.measured_admittance import TABLE_SUFFIXES, load_tables
from kc2spice.bodies.readers.mesh import read_nodes
from kc2spice.bodies.readers.sidecar import Sidecar, TermEntry, read_sidecar
from kc2spice.core.argument_and_option_names import check_arguments
from kc2spice.core.errors import UsageError, wrong
from kc2spice.core.other_file_formats import identify_format, make_other_format_error, read_head
from kc2spice.core.user_warnings import warn_user
from kc2spice.rom.affine import AffineModel, AffineTerm, sum_affine_terms
from kc2spice.rom.io import MARKET_BANNER, parse_matrix_market, parse_numbers
from kc2spice.rom.linear_model import LinearModel
from kc2spice.rom.pencil import Matrix

FORMATS = """\
NAME of Matrix Market or Harwell-Boeing files NAME.M .E .K .B .C (first order .A .B .C .D .E; heat
.E .K), also NAME.K.mtx, NAME_K.mtx, NAME_K.matrix; a .npz or .mat file with such matrices or one
mphmatrix struct (COMSOL); JOB_STIF1.mtx (Abaqus); JOB.sti (CalculiX); a punch file with DMIG cards
or .op4 (Nastran); .full (Ansys); or a TOML file that names the files"""

# description of every key of NAME.toml
SIDECAR_KEYS = _sidecar.__doc__ or ""


@check_arguments
def read_model(path: Path | str, sidecar: Path | str | None = None) -> LinearModel:
    """Read matrices from another finite-element program as a linear model with ports.

    The model is a second-order model ``M x'' + E x' + K x = B u``, ``y = C x + D u``, a first-order
    model ``E x' = A x + B u``, or a heat model ``E x' + K x = B u`` (without M and A). A missing E
    is zero in a second-order model, and the unit matrix in a first-order model. A missing C is
    ``B'``, and a missing D is zero. A complex K contains structural damping.

    Parameters
    ----------
    path : Path or str
        Any file of the model, or a TOML file with the key ``files``. :data:`FORMATS` lists the
        formats.
    sidecar : Path or str, optional
        TOML file that names the ports; :mod:`kc2spice.bodies.readers.sidecar` lists its keys. The
        default is ``NAME.toml`` beside the model, if this file exists.

    Returns
    -------
    LinearModel
        Model in SI units. The TOML file defines the ports. Without a TOML file, each column of B is
        an input signal, and each row of C is an output signal. All parameters in the TOML file are
        set to their default values; :func:`read_affine_model` returns a model with parameters.

    Raises
    ------
    UsageError : the model does not exist, a file is damaged or too large, a matrix is incomplete, a
        number in a matrix is not real or not finite, or the ports do not match the matrices. The
        error message states the file, the key, the wrong input and the expected input.
    MissingToolError : the format needs a package that is not installed. The error message names the
        missing package.

    Examples
    --------
    A mass of 10 g on a spring of 100 N/m moves by 10 mm for 1 N.

    >>> import numpy as np
    >>> import kc2spice as kc
    >>> np.savez("oscillator.npz", M=[[0.01]], K=[[100.0]], B=[[1.0]])
    >>> model = kc.read_model("oscillator.npz")
    >>> model.order, [port.name for port in model.ports]
    (1, ['u1', 'y1'])
    >>> print(f"{model.transfer([0.0])[0, 0, 0].real:.4f} m")
    0.0100 m
    """
    model = read_any_model(path, sidecar)
    return model.model if isinstance(model, AffineModel) else model


@check_arguments
def read_affine_model(path: Path | str, sidecar: Path | str | None = None) -> AffineModel | None:
    """Read an affine model, whose matrices are sums with parameter-dependent factors.

    The TOML file beside the matrices contains the parameters and the factors of the matrices.

    Parameters
    ----------
    path : Path or str
        Path of the model, see :func:`read_model`.
    sidecar : Path or str, optional
        TOML file with the tables ``parameters`` and ``terms``, see :func:`read_model`.

    Returns
    -------
    AffineModel or None
        Model in SI units for :func:`kc2spice.reduce`, or None if the TOML file contains no
        parameters.

    Raises
    ------
    UsageError : an error of :func:`read_model` occurs, or a factor is not an expression of the
        parameters.

    Examples
    --------
    A mass of 10 g is on a spring of 100 N/m. The stiffness of the spring is multiplied by the
    square of a parameter.

    >>> import numpy as np
    >>> import kc2spice as kc
    >>> np.savez("spring.npz", M=[[0.01]], K=[[100.0]], B=[[1.0]])
    >>> parameter = "parameters.ratio = {default = 1.0, low = 0.5, high = 2.0}"
    >>> term = '[[terms]]\\nmatrix = "K"\\nfactor = "ratio^2"'
    >>> port = '[[ports]]\\nname = "tip"\\nkind = "mechanical"\\ncolumn = 1'
    >>> text = "\\n".join([parameter, term, port])
    >>> characters = Path("spring.toml").write_text(text)
    >>> spring = kc.read_affine_model("spring.npz")
    >>> float(spring.evaluate({"ratio": 2.0}).K[0, 0])
    400.0
    """
    model = read_any_model(path, sidecar)
    return model if isinstance(model, AffineModel) else None


def read_any_model(
    path: Path | str, sidecar: Path | str | None = None
) -> LinearModel | AffineModel:
    """Read a model from matrix files, with parameters if its TOML file contains any.

    If the TOML file contains parameters, the model is the same as in :func:`read_affine_model`,
    otherwise as in :func:`read_model`.
    """
    rows, terms = _read_matrix_terms(path, sidecar)
    settings = rows.sidecar
    model = _assemble_at(rows, terms, get_default_values(settings))
    if not settings.parameters:
        return model
    return AffineModel(
        model,
        parameters=[make_model_parameter(settings, name) for name in settings.parameters],
        assemble=lambda values: _assemble_at(rows, terms, values),
    )


def _assemble_at(
    rows: LabelledMatrices, terms: list[AffineTerm], values: Mapping[str, float]
) -> LinearModel:
    """Assemble the full-order model for the given values of its parameters.

    Each matrix of the model is the sum of its constant part and its terms.
    """
    return assemble_model(replace(rows, matrices=sum_affine_terms(rows.matrices, terms, values)))


def _read_matrix_terms(
    path: Path | str, sidecar: Path | str | None
) -> tuple[LabelledMatrices, list[AffineTerm]]:
    """Read the constant matrices of a model, and its terms that depend on parameters."""
    if not isinstance(path, (str, Path)):
        raise UsageError(
            "this object is not the path of a model",
            where="path",
            got=repr(path)[:120],
            expected="a str or a Path",
            hint="make a model of matrices by kc.LinearModel(M=M, K=K, B=B)",
        )
    path, sidecar = Path(path), None if sidecar is None else Path(sidecar)
    if "\0" in str(path):
        raw_matrices.require_file(path)  # this call raises the error for a missing file
    if not path.name:
        raise UsageError(
            "this path is a folder, not a model",
            where=str(path),
            expected="the name of a model, such as FOLDER/NAME",
            hint="add the name of a file in this folder",
        )
    base, files, _, settings = locate_model(path, sidecar)
    path = files.pop(_SINGLE_FILE, path)  # the user may write NAME for the file NAME.npz
    _require_named_format(path, {**files, **settings.files}, settings)
    result = _read_files(path, {**files, **settings.files}, settings.matrices)
    _warn_of_unused_matrices(path, base, files, result, settings)
    sound = {
        k: raw_matrices.require_matrix(m, k, result.files.get(k, path))
        for k, m in result.matrices.items()
    }
    if settings.dofs is not None:
        dofs = raw_matrices.parse_file(
            settings.dofs, "one line 'node,dof' for each matrix row", _parse_row_dofs
        )
        result = replace(result, dofs=dofs)
    terms = []
    for number, entry in enumerate(settings.terms):
        matrix = _read_term(entry, path, result, f"{settings.file_path}: terms[{number}]")
        if matrix is None:
            if entry.matrix not in sound:
                raise wrong(
                    f"{settings.file_path}: terms[{number}]",
                    f"the model has no matrix {entry.matrix}",
                    hint=(
                        f"add the key `file` or `name` to this term, or add matrix {entry.matrix} "
                        "to the model"
                    ),
                )
            matrix = sound.pop(entry.matrix)
        terms.append(make_term(settings, number, matrix))
    return LabelledMatrices(base.name, str(path), settings, result, sound), terms


def _require_named_format(path: Path, files: Mapping[str, Path], settings: Sidecar) -> None:
    """Reject names of matrices for files that contain no names.

    Raises
    ------
    UsageError : the TOML file contains `matrices`, but the format of the model has no names.
    """
    unnamed = (".full", *fem_program_formats.SUFFIXES)
    if settings.matrices and (files or path.suffix.lower() in unnamed):
        names = [file.name for file in files.values()] or [path.name]
        raise wrong(
            f"{settings.file_path}: matrices",
            "this file format does not contain names of matrices",
            got=", ".join(names[:5]),
            expected=f"a file whose name ends with {', '.join(NAMED_FORMATS)}",
            hint="delete the key `matrices`; to name a file for each matrix, use the key `files`",
        )


def _warn_of_unused_matrices(
    path: Path,
    base: Path,
    files: Mapping[str, Path],
    model: raw_matrices.RawMatrices,
    settings: Sidecar,
) -> None:
    """Warn of matrices that have the size of the model, but an unknown name.

    The matrices are in the file of the model, or in Matrix Market files beside its other files.
    """
    square = next((m for k, m in model.matrices.items() if k in "MKA"), None)
    size = 0 if square is None else square.shape[0]
    key, unknown = "matrices", {name: (name, shape) for name, shape in model.unknown.items()}
    terms = {entry.name for entry in settings.terms}
    if files:
        listed = [*files.values(), *settings.files.values(), *(t.file for t in settings.terms)]
        used = {file.resolve() for file in listed if file}
        key, unknown = "files", {}
        for file in sorted(base.parent.glob(f"{glob.escape(base.name)}[._]*.mtx")):
            name = file.stem[len(base.name) + 1 :]
            if name.isalnum() and file.resolve() not in used:
                unknown[name] = file.name, _read_market_shape(file)
    for name, (text, shape) in unknown.items():
        if size < 2 or len(shape) != 2 or size not in shape or name in terms:
            continue
        advice = "if the model needs it, give it one of these names"
        if shape == (size, size):
            advice = "if the model needs it, add it to the damping matrix"
            if not {"E", settings.damping_matrix} & set(model.matrices):
                advice = (
                    "if it is the damping or gyroscopic matrix, write  "
                    f'{key} = {{ E = "{text}" }}  into {base.name}.toml'
                )
        warn_user(
            f"{path}: matrix {name} of {shape[0]} x {shape[1]} is not used, because its name is "
            f"none of {', '.join(raw_matrices.LETTERS)}: {advice}; "
            "otherwise remove it"
        )


def _read_market_shape(path: Path) -> tuple[int, ...]:
    """Read the shape of a matrix from the first lines of a Matrix Market file.

    Return an empty tuple if the first lines of the file contain no shape.
    """
    lines = _read_head(path).splitlines()
    if not lines or not lines[0].lower().startswith(MARKET_BANNER):
        return ()
    for line in lines[1:]:
        words = line.split()
        if words and not words[0].startswith(b"%"):
            return tuple(int(word) for word in words[:2] if word.isdigit())
    return ()


def _read_term(
    entry: TermEntry, path: Path, model: raw_matrices.RawMatrices, where: str
) -> Matrix | None:
    """Read the matrix of a parameter-dependent term from its file.

    Return None if the term has neither file nor matrix name. If a term states neither a file nor a
    matrix name, its factor multiplies the model's matrix ``entry.matrix``, such as K.

    Raises
    ------
    UsageError : a file cannot be used, or the term's matrix has other nodes or degrees of freedom
        than the model.
    """
    if entry.file is None and entry.name is None:
        return None
    letter, file = entry.matrix, entry.file or path
    if entry.name is not None and file.suffix.lower() not in NAMED_FORMATS:
        raise wrong(
            where,
            "this file format does not contain names of matrices",
            got=file.name,
            expected=f"a file whose name ends with {', '.join(NAMED_FORMATS)}",
            hint="write the matrix into a separate file, and delete the key `name` of this term",
        )
    if file.suffix.lower() in READERS:
        term = _read_files(file, {}, {letter: entry.name} if entry.name else {})
    else:
        term = _read_matrices({letter: file})
    if letter not in term.matrices:
        raise wrong(
            where,
            f"the file has no matrix {letter}",
            got=file.name,
            expected=f"matrix {letter}",
            hint=(
                f"rename a matrix in {file.name} to {letter}, or set the key `matrix` of this "
                "term to the name of a matrix in the file"
            ),
        )
    rows, others = model.dofs, term.dofs
    if rows and others and not np.array_equal(rows.encode_rows(), others.encode_rows()):
        raise wrong(
            where,
            "the nodes and degrees of freedom of this term differ from those of the model",
            got=file.name,
            expected="the degrees of freedom of the model, in the same order",
            hint=f"export {file.name} from the same mesh and numbering as the model",
        )
    return raw_matrices.require_matrix(term.matrices[letter], letter, file)


def measure_mesh_extent(path: Path, sidecar: Path | None) -> np.ndarray | None:
    """Measure the extent [m] of a model's mesh along x, y and z.

    Return None if the TOML file of the model does not contain the key ``mesh``.

    Raises
    ------
    UsageError : the TOML file or the mesh file contains an error.
    """
    *_, settings = locate_model(path, sidecar)
    if settings.mesh is None:
        return None
    return np.asarray(
        _sidecar.LENGTH_UNITS[settings.length] * np.ptp(read_nodes(settings.mesh).at, axis=0)
    )


# file extensions that may follow NAME.K or NAME_K
_MATRIX_SUFFIXES = ("", ".mtx", ".mm", ".txt", ".matrix", ".hb", ".rsa", ".rua")
_LETTER_SUFFIXES = tuple(f".{letter}" for letter in raw_matrices.LETTERS)  # of NAME.K and others
_MATRIX_FILE = re.compile(r"(.+)([._])([MEKABCD])(\.(?:mtx|mm|txt|matrix|hb|rsa|rua))?")
# Key of a file that contains all matrices, in a dictionary of files.
# A file of a single matrix has the letter of the matrix, such as K, as its key.
# A dictionary of files contains the key _SINGLE_FILE if the user writes the name of a model without
# a file extension.
_SINGLE_FILE = ""
_MATLAB_EXPECTED = "a MATLAB file of version 5 to 7.2 with matrices, or with one mphmatrix struct"
_ARRAYS_EXPECTED = (
    "an archive by numpy.savez(FILE, M=M, K=K, B=B); a scipy.sparse K as K.data, K.indices, "
    "K.indptr, K.shape and K.format, or in a file of its own, NAME.K.mtx, by scipy.io.mmwrite"
)
_JOB_EXPECTED = f"{', '.join(fem_program_formats.SUFFIXES)} of one job"
NAMED_FORMATS = (".npz", ".mat", ".op4", ".pch")  # formats that contain names of matrices
# Description and reader of each format with all matrices in one file, keyed by file extension.
# The second argument of a reader is the mapping `matrices` in the TOML file.
# The mapping `matrices` contains the names of the matrices inside the file.
READERS: Mapping[str, tuple[str, Callable[[Path, Mapping[str, str]], raw_matrices.RawMatrices]]] = {
    ".npz": (_ARRAYS_EXPECTED, raw_matrices.read_matrix_archive),
    ".mat": (_MATLAB_EXPECTED, raw_matrices.make_isolated_reader(raw_matrices.unpack_matlab)),
    ".full": (
        "a symmetric .full file of Ansys",
        raw_matrices.make_isolated_reader(fem_program_formats.unpack_ansys_full),
    ),
    ".op4": (
        "a Nastran OUTPUT4 file",
        raw_matrices.make_isolated_reader(fem_program_formats.unpack_op4),
    ),
    **dict.fromkeys(
        fem_program_formats.SUFFIXES, (_JOB_EXPECTED, fem_program_formats.read_calculix)
    ),
    **dict.fromkeys(
        (".pch", ".pch1", ".bdf", ".dat", ".nas", ".dmig"),
        ("a punch file of Nastran", fem_program_formats.read_dmig),
    ),
}


def list_source_files(path: Path, sidecar: Path | None) -> tuple[Path, ...]:
    """List the existing files of a model.

    The names of the listed files begin with the name of the model, or are in the model's TOML file.

    Raises
    ------
    UsageError : the TOML file contains an error.
    """
    base, files, selected, settings = locate_model(path, sidecar)
    paths = [
        path,
        selected,
        *files.values(),
        *settings.files.values(),
        settings.mesh,
        settings.dofs,
        *(entry.file for entry in settings.terms),
    ]
    paths += [*base.parent.glob(f"{base.name}.*"), *base.parent.glob(f"{base.name}_*")]
    return tuple(sorted(set(filter(Path.is_file, filter(None, paths)))))


def locate_model(path: Path, sidecar: Path | None) -> tuple[Path, dict[str, Path], Path, Sidecar]:
    """Locate the files of a model, and read its TOML file.

    Return the path of the model without file extension, its matrix files keyed by letter, the path
    of its TOML file, and the content of the TOML file. The TOML file may be missing if ``sidecar``
    is None.

    Raises
    ------
    UsageError : the TOML file contains an error.
    """
    base, files = _find_matrix_files(path)
    default = path if path.suffix == ".toml" else base.with_name(f"{base.name}.toml")
    selected, required = sidecar or default, sidecar is not None or path.suffix == ".toml"
    settings = read_sidecar(selected) if required or raw_matrices.is_file(default) else Sidecar()
    return base, files, selected, settings


def _find_matrix_files(path: Path) -> tuple[Path, dict[str, Path]]:
    """Find the files of a model that contain one matrix each.

    Return the path of the model without file extension, and the files keyed by letter.
    """
    job = fem_program_formats.find_abaqus_files(path)
    if job:
        match = fem_program_formats.ABAQUS_NAME.fullmatch(path.name)
        assert match is not None  # find_abaqus_files() has checked the form of the name
        return path.with_name(match[1]), job
    if path.suffix == ".toml":
        return path.with_suffix(""), {}
    match = _MATRIX_FILE.fullmatch(path.name)  # the user may write NAME.K for NAME.K.mtx
    if match is not None and not raw_matrices.is_file(path):
        tails = () if match[4] else _MATRIX_SUFFIXES[1:]
        if not any(raw_matrices.is_file(path.with_name(path.name + tail)) for tail in tails):
            match = None
    base = path.with_name(match[1]) if match else path
    separators = (match[2],) if match else (".", "_")
    result: dict[str, Path] = {}
    for letter in raw_matrices.LETTERS:
        candidates = list(map("".join, product((base.name,), separators, letter, _MATRIX_SUFFIXES)))
        if "_" in separators:  # a file NAME_K is a matrix file only with a file extension
            candidates.remove(f"{base.name}_{letter}")
        fits = list(filter(raw_matrices.is_file, map(base.with_name, candidates)))
        if len(fits) > 1:
            names = ", ".join(map(attrgetter("name"), fits))
            raise wrong(
                str(base),
                f"matrix {letter} is in two files",
                got=names,
                expected="one file for each matrix",
                hint=f"delete or rename one of these files: {names}",
            )
        if fits:
            result[letter] = fits[0]
    if result:
        return base, result
    archives = [path.with_name(f"{path.name}{suffix}") for suffix in READERS]
    archives = [] if raw_matrices.is_file(path) else list(filter(raw_matrices.is_file, archives))
    if len(archives) > 1:
        got = ", ".join(map(attrgetter("name"), archives))
        raise wrong(
            str(path),
            "several model files have this name",
            got=got,
            expected="one file",
            hint=f"give the full name, such as {archives[0].name}",
        )
    archive = dict.fromkeys([_SINGLE_FILE], archives[0]) if archives else {}
    return (path.with_suffix("") if raw_matrices.is_file(path) else path), archive


def _read_files(
    path: Path, files: dict[str, Path], requested: Mapping[str, str]
) -> raw_matrices.RawMatrices:
    """Read the matrices of a model without any conversion.

    ``files`` contains a file for each matrix. If ``files`` is empty, ``path`` contains all
    matrices. ``requested`` maps matrix letters, such as K, to the names of the matrices in
    ``path``.
    """
    suffix = path.suffix.lower()
    if files:
        return _read_matrices(files)
    if not raw_matrices.is_file(path) or suffix == ".toml":
        if not raw_matrices.is_file(path) and suffix:
            raise raw_matrices.make_missing_error(
                path,
                "a model: kc2spice reduce --help lists the kinds of files",
                (*READERS, *_LETTER_SUFFIXES, *_MATRIX_SUFFIXES[1:], *TABLE_SUFFIXES),
            )
        if path.is_dir():
            raise wrong(
                str(path),
                "this path is a directory, not a file",
                expected="the path of a model file",
                hint="write the path of a file in this directory",
            )
        raise wrong(
            str(path),
            "this model does not exist",
            expected=f"{path.name}.M and {path.name}.K, or {path.name}.npz or .mat",
            hint="kc2spice reduce --help lists the kinds of files",
        )
    if suffix not in READERS:
        raise _make_unknown_file_error(path)
    expected, read = READERS[suffix]
    return raw_matrices.call_reader(path, expected, lambda: read(path, requested))


def _make_unknown_file_error(path: Path) -> UsageError:
    """Make the error for a file whose name belongs to no format of matrices."""
    matrices = "matrices with names such as NAME.K, NAME_K.mtx or JOB_STIF1.mtx"
    expected = f"{matrices}, or measured values such as NAME.csv"
    if (name := identify_format(read_head(path), path.suffix)) is not None:
        return make_other_format_error(path, name, "matrices", expected)
    hint = 'to use other names, name the files in NAME.toml: files = { K = "...", M = "..." }'
    with contextlib.suppress(ValueError, OSError):
        load_tables(path)
        hint = f"if this table contains measured values, rename it to {path.stem}.csv"
    problem = "the name of this file is not the name of a matrix or of measured values"
    return raw_matrices.make_unusable_file_error(path, path.name, expected, hint, problem)


def _read_matrices(files: dict[str, Path]) -> raw_matrices.RawMatrices:
    """Read one matrix from each Matrix Market, Harwell-Boeing or Abaqus file."""
    result: dict[str, Matrix] = {}
    tables: dict[str, Path] = {}
    mapped: list[Path] = []
    for letter, path in files.items():
        head = _read_head(path)
        allowed = partial(raw_matrices.require_size, path, letter)
        if head[: len(MARKET_BANNER)].lower() == MARKET_BANNER:
            expected = "a Matrix Market file, 'coordinate' or 'array', not 'pattern' or 'hermitian'"
            result[letter] = raw_matrices.parse_file(
                path, expected, partial(parse_matrix_market, allowed=allowed)
            )
        elif fem_program_formats.is_harwell_boeing(head):
            read = partial(fem_program_formats.read_harwell_boeing, allowed=allowed)
            result[letter] = raw_matrices.parse_file(
                path, fem_program_formats.HARWELL_BOEING_EXPECTED, read
            )
            mapped += map(path.with_suffix, (".mapping", ".MAPPING"))
        elif (
            letter in f"MEK{fem_program_formats.LOSS_LETTER}" and path.suffix.lower() == ".mtx"
        ):  # matrix file of Abaqus
            tables[letter] = path
        else:
            expected = "Matrix Market, Harwell-Boeing, or an .mtx file of Abaqus"
            hint = f"save matrix {letter} as Matrix Market, such as by scipy.io.mmwrite"
            got = f"matrix {letter} in an unknown format"
            raise raw_matrices.make_unusable_file_error(path, got, expected, hint)
    abaqus = raw_matrices.RawMatrices({})
    if tables:
        one = next(iter(tables.values()))
        expected = "stiffness, mass and damping of one job"
        abaqus = raw_matrices.call_reader(
            one, expected, lambda: fem_program_formats.read_abaqus(tables)
        )
    result |= abaqus.matrices
    dofs, names = abaqus.dofs, list(filter(raw_matrices.is_file, mapped))
    if names and dofs is None:
        size = next(m.shape[0] for k, m in result.items() if k in "MEKA")
        expected = f"one line 'equation node dof' for each of {size} equations"
        dofs = raw_matrices.parse_file(
            names[0], expected, partial(fem_program_formats.read_mapping, size=size)
        )
    return raw_matrices.RawMatrices(result, dofs, abaqus.fixed, files)


def _read_head(path: Path) -> bytes:
    """Return the first bytes of a file, without a byte-order mark."""
    return read_head(raw_matrices.require_file(path)).removeprefix(b"\xef\xbb\xbf")


def _parse_row_dofs(data: bytes) -> raw_matrices.Dofs:
    """Parse the nodes and the degrees of freedom of matrix rows.

    The data contain a line ``node, degree of freedom`` for each row.
    """
    values = parse_numbers(data)
    if values.size == 0 or values.size % 2:
        raise ValueError(f"expected an even number of values (node, dof), got {values.size}")
    return raw_matrices.Dofs(*values.reshape(-1, 2).T)
