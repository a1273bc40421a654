"""Parameters of a matrix model, and the factors that depend on parameters.

The TOML file beside the matrices contains the parameters and the factors. A factor is an expression
of the parameters in the syntax of netlists, such as ``(t/1.0)^3``.
"""

from __future__ import annotations

from collections.abc import Mapping

from kc2spice.bodies.readers.sidecar import Sidecar
from kc2spice.core.errors import UsageError, wrong
from kc2spice.netlist.expression import Name, Tree, evaluate_parameter, parse_expression, walk_tree
from kc2spice.rom.affine import AffineTerm, ModelParameter
from kc2spice.rom.pencil import Matrix


def get_default_values(settings: Sidecar) -> dict[str, float]:
    """Return the default values of a model's parameters, keyed by name."""
    return {name: entry.default for name, entry in settings.parameters.items()}


def make_model_parameter(settings: Sidecar, name: str) -> ModelParameter:
    """Make a parameter of a model from its table in the TOML file.

    Raises
    ------
    UsageError : the parameter's range is empty, or its default value is outside of the range.
    """
    entry = settings.parameters[name]
    try:
        return ModelParameter(
            name, entry.default, entry.low, entry.high, entry.unit, entry.description
        )
    except UsageError as error:
        error.where = f"{settings.file_path}: parameters.{name}"
        raise


def make_term(settings: Sidecar, number: int, matrix: Matrix) -> AffineTerm:
    """Make a parameter-dependent term of a model: a matrix times a factor.

    The factor depends on parameters. The factor is in the table ``[[terms]]`` with the ``number``,
    counted from 0.

    Raises
    ------
    UsageError : the factor is not an expression of the parameters.
    """
    entry, where = settings.terms[number], f"{settings.file_path}: terms[{number}].factor"
    try:
        tree = parse_expression(entry.factor, where=where)
    except RecursionError:
        raise wrong(
            where,
            "the expression has too many nested parentheses",
            got=entry.factor,
            expected="fewer parentheses",
        ) from None
    known = {name.lower() for name in settings.parameters}
    for node in walk_tree(tree):
        if isinstance(node, Name) and node.text.lower() not in known:
            raise wrong(
                where,
                "the model has no such parameter",
                got=node.text,
                expected=f"one of {', '.join(settings.parameters)}",
            )

    def evaluate_factor(values: Mapping[str, float]) -> float:
        """Return the value of the term's factor for the given parameter values."""
        return _evaluate_factor(tree, values, where)

    return AffineTerm(entry.matrix, matrix, evaluate_factor, where)


def _evaluate_factor(tree: Tree, values: Mapping[str, float], where: str) -> float:
    """Evaluate the expression of a factor at the given parameter values.

    An error message begins with ``where``, which names the file and the key of the factor.
    """
    try:
        return evaluate_parameter(tree, {name.lower(): value for name, value in values.items()})
    except UsageError as error:
        error.where = where
        raise
