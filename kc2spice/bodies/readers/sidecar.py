"""``NAME.toml`` beside the matrices: units, supports and ports of the model.

::

    band = [0, 2e4]               # frequency band [Hz] of the error estimate; --band overrides it
    length = "mm"                 # unit of displacements in the matrices (m, cm, mm, um, in, ft)
    force = "N"                   # unit of forces in the matrices (N, mN, uN, kN, lbf)
    symmetric = true              # a 'general' matrix with only one triangle is symmetric
                                  # (false: the matrix is triangular)
    files = { K = "a.mtx", M = "b.mtx" }      # files with names other than NAME.K, NAME_K.mtx
    matrices = { K = "KAAX", M = "MAAX" }     # names in a .mat, .npz, OP4 or punch file
    damping_matrix = "C"          # a square C beside M and K is the damping matrix (or "D"); or
                                  # outputs = "C": C is the output matrix, one row per output
    mesh = "job.inp"              # file of node coordinates and node sets: .inp, .bdf, .cdb, or
                                  # .csv with node,x,y,z
    dofs = "rows.csv"             # node,dof of each matrix row, if the matrix files lack them
    damping = { alpha = 0, beta = 1e-9 }      # E = alpha M + beta K, added to E in the files
    damping = { ratio = 0.01, at = 250e3 }    # or beta from a damping ratio at a frequency [Hz]
    damping = { loss_factor = 0.02 }          # structural damping K (1 + j loss_factor)

    [parameters]                  # parameters of the subcircuit, for the factors of [[terms]]
    thickness = { default = 1.0, low = 0.8, high = 1.25, unit = "mm" }

    [[terms]]                     # the model's matrix is K(p) = K + sum f_i(p) K_i
    matrix = "K"                  # or "M", or "E" in heat models
    file = "plate.K3.mtx"         # file of K_i; by default the file of the model
    name = "K3"                   # name of K_i inside a .npz, OP4 or punch file
    factor = "(thickness / 1.0)^3"            # f_i(p)

    [[fixed]]                     # degrees of freedom that are fixed at zero
    nodeset = "ROOT"              # or node = 7, nodes = [7, 8], at = [x, y, z]
    dof = ["ux", "uy", "uz"]      # by default all degrees of freedom of the nodes

    [[ports]]
    name = "tip"
    kind = "mechanical"           # or electrical, rotational, acceleration, thermal, acoustic,
                                  # input, output
    node = 12                     # or nodes = [...], nodeset = "TIP", at = [x, y, z] (unit length)
    within = 0.1                  # largest distance of the node from 'at' (unit length)
    dof = "uz"                    # ux uy uz rx ry rz volt temp, or 1 to 6
    axis = "z"                    # instead of 'dof': an axis, or a direction [0, 0.6, 0.8]
    unit = "um"                   # 1 V on the pin of a signal port means 1 um
    scale = 1e-6                  # value of this unit in units of the model, such as 1e-6 m
                                  # (inputs and outputs only)
    pins = ["anode", "cathode"]   # names of the netlist pins

    [[ports]]
    name = "force"
    kind = "input"
    column = 1                    # number of a column of B, counted from 1
                                  # (outputs: row = 1 is the first row of C)

A mechanical port at several nodes has the mean displacement of these nodes, and the force of the
port is distributed evenly over the nodes. A port of kind ``acceleration`` accelerates the support
of all fixed degrees of freedom, as a shaker does. An ``acceleration`` port needs only the key
``axis``. A port of kind ``acoustic`` needs the key ``column``. An acoustic port's column of B
contains the force on each unknown for 1 Pa at the port. The product of the acoustic port's column
and the unknowns is the volume that the body displaces. An ``electrical`` port at nodes connects
their degrees of freedom ``volt`` to one electrode. If a conservative port has the key ``column =
n``, row n of C is the output of this port. Without ``[[ports]]``, the columns of B are the input
signals ``u1``, ``u2``, …, and the rows of C are the output signals ``y1``, ``y2``, ….
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    PrivateAttr,
    StrictBool,
    StringConstraints,
    ValidationInfo,
    field_validator,
    model_validator,
)

from kc2spice.bodies.readers.raw_matrices import (
    DOF_NUMBERS,
    DOFS,
    ROTATIONS,
    TRANSLATIONS,
    call_reader,
    require_file,
)
from kc2spice.core.domains import (
    ACCELERATION,
    ELECTRICAL,
    PORTS,
    ROTATION,
    THERMAL,
    TRANSLATION,
)
from kc2spice.core.errors import UsageError, did_you_mean, list_candidates
from kc2spice.core.key_errors import validate_table
from kc2spice.core.quantities import Count, Section, make_invalid_value_error
from kc2spice.core.toml_errors import parse_toml_file
from kc2spice.core.units import parse_unit
from kc2spice.core.untrusted_files import MAX_TEXT_BYTES, decode_text, read_bounded
from kc2spice.fem.body_keys import reject_overcritical_damping
from kc2spice.rom.linear_model import PORT_KINDS, Port

LENGTH_UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254, "ft": 0.3048}
FORCE_UNITS = {"N": 1.0, "mN": 1e-3, "uN": 1e-6, "kN": 1e3, "lbf": 4.4482216152605}
# name of the degree of freedom of ports without a direction, keyed by kind of port
SCALAR_DOFS = {ELECTRICAL.port: "volt", THERMAL.port: "temp"}
DIRECTED_KINDS = (TRANSLATION.port, ROTATION.port)  # kinds of ports that act along an axis
# kinds of ports that can only be defined by a column of B or a row of C
COLUMN_KINDS_ONLY = tuple(PORTS.keys() - {*SCALAR_DOFS, *DIRECTED_KINDS, ACCELERATION.port})
_AXIS_VECTORS = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


def _require_printable(value: str) -> str:
    """Reject a name with unprintable characters, because netlists contain the name."""
    if not value.isprintable():
        raise make_invalid_value_error(
            "this text is not a valid name",
            "printable characters in one line",
            hint="delete line breaks and control characters from it",
        )
    return value


def _require_one_word_unit(value: str) -> str:
    """Return a unit without blanks, because blanks separate words in netlist headers.

    Blanks between the factors of a known unit become ``*``. All other blanks are rejected.
    """
    if len(value.split()) > 1 and parse_unit(value) is not None:
        value = re.sub(r" *([/()*]) *", r"\1", " ".join(value.split())).replace(" ", "*")
    if value and len(value.split()) != 1:
        hint = f"write the unit without blanks: {value.replace(' ', '*')}"
        raise make_invalid_value_error("this text is not a unit", "one word", hint=hint)
    return value


def _resolve_beside_sidecar(value: Path, info: ValidationInfo) -> Path:
    """Resolve a file path relative to the folder of the TOML file.

    Files outside of the folder of the TOML file are rejected.
    """
    _require_printable(str(value))
    if value.is_absolute() or ".." in value.parts:
        hint = "copy the file into the folder of the TOML file, and write only the file name"
        raise make_invalid_value_error(
            "this file is not in the folder of the TOML file", "a relative path", hint=hint
        )
    folder: Path = (info.context or {}).get("folder", Path())
    return folder / value


def _parse_dof(value: object) -> int:
    """Return the number of a degree of freedom that is given by name or number."""
    code = DOF_NUMBERS.get(value.lower()) if isinstance(value, str) else value
    if type(code) is not int or code not in DOFS:
        expected = f"one of {list_candidates(value, DOF_NUMBERS, 'docs/reference/matrices.md')}"
        hint = did_you_mean(str(value), DOF_NUMBERS)
        raise make_invalid_value_error("this degree of freedom does not exist", expected, hint=hint)
    return code


def _parse_axis(value: object) -> object:
    """Return the unit vector of an axis that is given by name, such as ``x``."""
    return _AXIS_VECTORS.get(value, value) if isinstance(value, str) else value


def _normalise_axis(value: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return the direction scaled to unit length; reject a zero vector."""
    length = math.hypot(*value)
    if length == 0.0:
        raise make_invalid_value_error(
            "this value is not an axis",
            "'x', 'y', 'z' or a direction [x, y, z]",
            hint="write for example  [0, 0, 1]",
        )
    x, y, z = (item / length for item in value)
    return x, y, z


def _convert_to_list(value: object) -> object:
    """Return a list or tuple unchanged, and any other value as a list."""
    return value if isinstance(value, list | tuple) else [value]


Name = Annotated[str, Field(min_length=1, max_length=200), AfterValidator(_require_printable)]
File = Annotated[Path, AfterValidator(_resolve_beside_sidecar)]
Finite = Annotated[float, Field(allow_inf_nan=False, strict=True)]
Node = Annotated[Count, Field(gt=-(2**40), lt=2**40)]
Position = Annotated[Count, Field(ge=1)]
Dof = Annotated[int, BeforeValidator(_parse_dof)]
Point = tuple[Finite, Finite, Finite]
Axis = Annotated[Point, BeforeValidator(_parse_axis), AfterValidator(_normalise_axis)]
Unit = Annotated[
    str,
    Field(max_length=32),
    AfterValidator(_require_one_word_unit),
    AfterValidator(_require_printable),
]
Rayleigh = tuple[float, float]
Letter = Annotated[str, StringConstraints(pattern="^[MEKABCD]$")]
# letter of a matrix inside a file; the letter H denotes the structural damping matrix in K + j H
Inner = Annotated[str, StringConstraints(pattern="^[MEKABCDH]$")]


class NodeSelection(Section):
    """Selection of nodes by number, by node set, or by coordinates."""

    node: Node | None = None
    nodes: tuple[Node, ...] | None = Field(None, min_length=1)
    nodeset: Name | None = None
    at: Point | None = None
    within: Annotated[Finite, Field(ge=0)] | None = None

    @model_validator(mode="after")
    def _reject_second_selector(self) -> NodeSelection:
        """Reject a second node selector, and the key ``within`` without the key ``at``."""
        selectors = [k for k in ("node", "nodes", "nodeset", "at") if getattr(self, k) is not None]
        if len(selectors) > 1:
            hint = f"delete {selectors[0]} or {selectors[1]}"
            raise make_invalid_value_error(
                f"the nodes are defined twice: {', '.join(selectors)}",
                "one of these keys",
                hint=hint,
            )
        if self.within is not None and self.at is None:
            raise make_invalid_value_error(
                "the key `within` has no effect without the key `at`",
                "the keys `at` and `within`",
                hint="add  at = [x, y, z]",
            )
        return self

    @property
    def selects_nodes(self) -> bool:
        """Whether the table in the TOML file selects any nodes."""
        return any(item is not None for item in (self.node_numbers or None, self.nodeset, self.at))

    @property
    def node_numbers(self) -> tuple[int, ...]:
        """Numbers of the nodes in the keys ``node`` and ``nodes``."""
        return (self.node,) if self.node is not None else self.nodes or ()


class FixedNodes(NodeSelection):
    """Nodes whose degrees of freedom are fixed at zero."""

    dof: Annotated[tuple[Dof, ...], BeforeValidator(_convert_to_list)] = ()

    @model_validator(mode="after")
    def _require_nodes(self) -> FixedNodes:
        """Require that a table ``[[fixed]]`` selects nodes."""
        if not self.selects_nodes:
            expected = "one of node, nodes, nodeset and at"
            raise make_invalid_value_error(
                "this table selects no nodes", expected, hint="add for example  node = 1"
            )
        return self


class PortEntry(NodeSelection):
    """Table ``[[ports]]``: a port, defined by nodes or by a column or row number.

    The numbers ``column`` of B and ``row`` of C are counted from 1.
    """

    name: Name = Field(examples=['"tip"'])
    kind: Literal[PORT_KINDS]  # type: ignore[valid-type]
    dof: Dof | None = None
    axis: Axis | None = None
    column: Position | None = None
    row: Position | None = None
    unit: Unit = ""
    scale: Annotated[Finite, Field(gt=0)] = 1.0
    pins: tuple[Name, ...] = Field((), max_length=2)

    @model_validator(mode="after")
    def _require_one_place(self) -> PortEntry:
        """Require that a port has either nodes, a column or a row, as its kind needs."""
        if self.scale != 1 and self.kind in PORTS:
            problem = f"a port of kind {self.kind} does not accept the key `scale`"
            raise make_invalid_value_error(
                problem,
                "the key `scale` only in ports of kind input or output",
                hint="delete the key `scale`",
            )
        if self.row is not None and self.kind != "output":
            problem = f"a port of kind {self.kind} takes the key `column`, not `row`"
            hint = f"write  column = {self.row}  instead of row"
            if self.column is not None:
                hint = "delete the key `row`"
            raise make_invalid_value_error(problem, "column", hint=hint)
        if self.column is not None and self.kind == "output":
            hint = f"write  row = {self.column}  instead of column"
            raise make_invalid_value_error(
                "a port of kind output takes the key `row`, not `column`", "row", hint=hint
            )
        directed = self.dof is not None or self.axis is not None
        if self.column is not None or self.row is not None:
            if self.selects_nodes or directed:
                expected = "only the key `column` or `row`, or nodes with `dof` or `axis`"
                raise make_invalid_value_error(
                    "a port with `column` or `row` cannot have nodes, `dof` or `axis`",
                    expected,
                    hint="delete `column` and `row`, or delete the nodes, `dof` and `axis`",
                )
        elif self.kind in COLUMN_KINDS_ONLY:
            problem = f"a port of kind {self.kind} can only have the key `column`"
            raise make_invalid_value_error(
                problem, "column", hint="write  column = 1  and neither node nor axis"
            )
        elif self.kind == ACCELERATION.port:
            if self.axis is None or self.selects_nodes or self.dof is not None:
                problem = "a port of kind acceleration can only have the key `axis`"
                raise make_invalid_value_error(
                    problem, "axis", hint='write  axis = "z"  and neither node nor dof'
                )
        elif not self.selects_nodes:
            expected = "one of node, nodes, nodeset, at, column and row"
            raise make_invalid_value_error(
                "this port has neither nodes nor a matrix column or row",
                expected,
                hint="add for example  column = 1",
            )
        elif self.kind in SCALAR_DOFS:
            if self.axis is not None or self.dof not in (None, DOF_NUMBERS[SCALAR_DOFS[self.kind]]):
                hint = "delete axis and dof of this port"
                article = "an" if self.kind[0] in "aeiou" else "a"
                problem = f"{article} {self.kind} port has no direction"
                raise make_invalid_value_error(problem, "nodes alone", hint=hint)
        elif (self.dof is None) == (self.axis is None):
            both = self.axis is not None
            problem = "this port has both dof and axis" if both else "this port has no direction"
            hint = "delete dof or axis" if both else 'add  axis = "z"'
            raise make_invalid_value_error(problem, "either dof or axis", hint=hint)
        elif self.kind in DIRECTED_KINDS and not self.weights.keys() <= {*self._directional_dofs}:
            expected = ", ".join(DOFS[k] for k in self._directional_dofs)
            raise make_invalid_value_error(
                f"{DOFS[self.dof or 0]} is not a degree of freedom of a {self.kind} port",
                expected,
                hint=f'write for example  dof = "{DOFS[self._directional_dofs[-1]]}"',
            )
        return self

    @property
    def _directional_dofs(self) -> tuple[int, ...]:
        """Rotations about x, y and z for a rotational port, otherwise translations."""
        return ROTATIONS if self.kind == ROTATION.port else TRANSLATIONS

    @property
    def weights(self) -> dict[int, float]:
        """Weight of each degree of freedom in the port force, by degree-of-freedom number."""
        if self.dof is not None:
            return {self.dof: 1.0}
        if self.kind in SCALAR_DOFS:
            return {DOF_NUMBERS[SCALAR_DOFS[self.kind]]: 1.0}
        axis = zip(self._directional_dofs, self.axis or (0.0, 0.0, 0.0), strict=True)
        return {kind: weight for kind, weight in axis if weight}

    @property
    def port(self) -> Port:
        """Port that this table defines, as a port of the linear model."""
        return Port(self.name, self.kind, across=self.unit, pins=self.pins)


def _advise_damping(keys: set[str]) -> str:
    """Return a hint how to correct an incomplete or contradictory damping table.

    ``keys`` are the keys in the table.
    """
    others = sorted(keys & {"alpha", "beta"})
    if others:
        return f"delete {' and '.join(others)}"
    return "add  at = 1000  with a frequency in Hz" if "ratio" in keys else "add  ratio = 0.01"


class MatrixDamping(Section):
    """Damping of a matrix model: Rayleigh damping or a structural loss factor.

    Rayleigh damping is ``E = alpha M + beta K``. A damping ``ratio`` that applies ``at`` a
    frequency [Hz] may replace alpha and beta. ``loss_factor`` is the loss factor of structural
    damping, ``K (1 + j loss_factor)``.
    """

    alpha: Annotated[Finite, Field(ge=0)] = 0.0
    beta: Annotated[Finite, Field(ge=0)] = 0.0
    ratio: Annotated[Finite, Field(ge=0)] | None = None
    at: Annotated[Finite, Field(gt=0)] | None = None
    loss_factor: Annotated[Finite, Field(ge=0)] = 0.0

    @field_validator("ratio", "at", mode="before")
    @classmethod
    def _reject_two_ratios(cls, value: object) -> object:
        """Reject a list of damping ratios; a matrix model accepts one ratio only."""
        if isinstance(value, list):
            raise make_invalid_value_error(
                "matrix files accept only one damping ratio at one frequency",
                "a number",
                hint="write alpha and beta instead of ratio and at",
            )
        return value

    @model_validator(mode="after")
    def _require_ratio_and_at(self) -> MatrixDamping:
        """Require ``ratio`` and ``at`` together, without ``alpha`` or ``beta``."""
        keys = self.model_fields_set - {"loss_factor"}
        if keys & {"ratio", "at"} and keys != {"ratio", "at"}:
            expected = "alpha and beta, or ratio and at [Hz]"
            raise make_invalid_value_error(
                "ratio and at must be used together, without alpha and beta",
                expected,
                hint=_advise_damping(keys),
            )
        example = "loss_factor = 0.02" if self.ratio is None else "ratio = 0.01"
        reject_overcritical_damping(
            max(self.ratio or 0.0, 0.5 * self.loss_factor),
            "a damping ratio below 1, or a loss factor below 2",
            f"for 1 % damping, write {example}",
        )
        return self

    @property
    def rayleigh_factors(self) -> Rayleigh:
        """Rayleigh damping factors alpha [1/s] and beta [s] of ``E = alpha M + beta K``."""
        if self.ratio is None or self.at is None:
            return self.alpha, self.beta
        return 0.0, self.ratio / (math.pi * self.at)


class ParameterEntry(Section):
    """Table of a model parameter: its default value, its range and its unit."""

    default: Finite = Field(examples=["1.0"])
    low: Finite = Field(examples=["0.5"])
    high: Finite = Field(examples=["2.0"])
    unit: Unit = "-"
    description: Annotated[str, Field(max_length=200), AfterValidator(_require_printable)] = ""


class TermEntry(Section):
    """Table ``[[terms]]``: a matrix times a factor that depends on parameters.

    ``file`` and ``name`` are the location of the matrix. If ``file`` and ``name`` are missing, the
    factor multiplies the model's matrix with the letter ``matrix``, such as K.
    """

    matrix: Literal["M", "K", "E"]
    factor: Annotated[str, Field(min_length=1, max_length=200)] = Field(examples=['"t/1.5"'])
    file: File | None = None
    name: Name | None = None


class Sidecar(Section):
    """Content of the TOML file that states the ports and supports of a matrix model.

    A model without a TOML file has the default values.
    """

    help_command: ClassVar[str] = "docs/reference/matrices.md"

    ports: tuple[PortEntry, ...] = ()
    fixed: tuple[FixedNodes, ...] = ()
    band: tuple[Annotated[Finite, Field(ge=0)], Finite] | None = None
    symmetric: StrictBool | None = None
    files: Mapping[Letter, File] = Field(default_factory=dict)
    matrices: Mapping[Inner, Name] = Field(default_factory=dict)
    mesh: File | None = None
    dofs: File | None = None
    damping_matrix: Literal["C", "D", "E"] = "E"
    outputs: Literal["C"] | None = None
    length: Literal["m", "cm", "mm", "um", "in", "ft"] = "m"
    force: Literal["N", "mN", "uN", "kN", "lbf"] = "N"
    damping: MatrixDamping = MatrixDamping()
    parameters: Mapping[Name, ParameterEntry] = Field(default_factory=dict)
    terms: tuple[TermEntry, ...] = Field((), max_length=50)
    _where: str = PrivateAttr("")

    @property
    def file_path(self) -> str:
        """Path of the TOML file, for errors that occur after the file was read."""
        return self._where

    def locate_entry(self, entry: NodeSelection) -> str:
        """Locate an entry for error messages by the file path and the name of its table.

        Error messages about the table ``entry`` begin with the returned string.
        """
        for word in ("ports", "fixed"):
            for number, item in enumerate(getattr(self, word)):
                if item is entry:
                    name = f" ({entry.name})" if isinstance(entry, PortEntry) else ""
                    return f"{self.file_path}: {word}[{number}]{name}"
        return self.file_path

    @model_validator(mode="after")
    def _require_consistent_keys(self) -> Sidecar:
        """Reject contradictory keys of the TOML file of a matrix file."""
        if self.band is not None and not self.band[0] < self.band[1]:
            hint = "write the lower frequency first, such as band = [0, 20000]"
            raise make_invalid_value_error(
                "this value is not a frequency band", "[f0, f1] with 0 <= f0 < f1, Hz", "band", hint
            )
        if self.outputs == self.damping_matrix == "C":
            expected = 'outputs = "C" or damping_matrix = "C"'
            hint = "delete one of these two keys"
            raise make_invalid_value_error(
                "outputs and damping_matrix are both C", expected, hint=hint
            )
        if bool(self.terms) != bool(self.parameters):
            lacking, present = ("parameters", "terms") if self.terms else ("terms", "parameters")
            raise make_invalid_value_error(
                f"{lacking} are missing",
                "[parameters] and [[terms]]",
                hint=f"add the table {lacking}, or delete the table {present}",
            )
        names = [port.name.lower() for port in self.ports]
        twice = [name for name, times in Counter(names).items() if times > 1]
        if twice:
            problem = f"two ports have the same name: {', '.join(twice[:5])}"
            raise make_invalid_value_error(
                problem, "a name for each port", hint="rename one of these ports"
            )
        return self


def read_sidecar(path: Path) -> Sidecar:
    """Read the TOML file at ``path``, which describes a matrix model.

    Raises
    ------
    UsageError : the file is missing, too long or not in the TOML format, a key is unknown, a value
        has the wrong type, or a name occurs twice. The error message contains the file and the key.
    """
    expected = f"a TOML file of at most {MAX_TEXT_BYTES} bytes"
    require_file(path, expected, (".toml",))
    text = call_reader(path, expected, lambda: decode_text(read_bounded(path, MAX_TEXT_BYTES)))
    data = parse_toml_file(text, str(path), ("ports", "fixed", "terms"))
    parts = [name for name, table in data.items() if isinstance(table, dict) and "part" in table]
    if parts:
        raise UsageError(
            "this file is a scene, not a description of matrices",
            where=str(path),
            got=f"the part {parts[0]}",
            expected="keys of docs/reference/matrices.md",
            hint=f"kc2spice run {path} simulates the scene, "
            f"kc2spice reduce {path}:{parts[0]} reduces its part",
        )
    result = validate_table(Sidecar, data, f"{path}:", {"folder": path.parent})
    result._where = str(path)
    return result
