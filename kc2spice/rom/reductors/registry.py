"""Registry of reduction methods by name, and the default methods for a model.

Other packages declare reduction methods as entry points of the group :data:`ENTRY_POINT_GROUP`.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from kc2spice.core.errors import UsageError, did_you_mean, unknown
from kc2spice.core.plugins import list_entry_points, load_plugin, make_built_in_name_error
from kc2spice.rom.reduced_basis import ReductionTask
from kc2spice.rom.reductors.balanced_truncation import BalancedTruncation
from kc2spice.rom.reductors.band_limited_balancing import BandLimitedBalancing
from kc2spice.rom.reductors.base import Reductor
from kc2spice.rom.reductors.block_krylov import BlockKrylov
from kc2spice.rom.reductors.congruent_balancing import CongruentBalancing
from kc2spice.rom.reductors.irka import Irka
from kc2spice.rom.reductors.rational_krylov import RationalKrylov
from kc2spice.rom.reductors.response_pod import ResponsePod

POD = ResponsePod()
TWO_SIDED_POD = ResponsePod(two_sided=True)
BALANCED = BalancedTruncation()
UNSCALED = BalancedTruncation(scaled=False)
OVER_BAND = BandLimitedBalancing()
CONGRUENT = CongruentBalancing()
BLOCK_KRYLOV = BlockKrylov()
_BUILT_IN = (
    POD, TWO_SIDED_POD, BALANCED, UNSCALED, OVER_BAND, CONGRUENT, BLOCK_KRYLOV, RationalKrylov(),
    Irka(),
)  # fmt: skip
_BUILT_IN_NAMES = frozenset(reductor.name for reductor in _BUILT_IN)
ENTRY_POINT_GROUP = "kc2spice.reductors"
_reductors: dict[str, Reductor] = {reductor.name: reductor for reductor in _BUILT_IN}


def register_reductor(reductor: Reductor) -> Reductor:
    """Register a reduction method for the argument ``method`` of ``kc2spice.reduce``.

    The new method replaces an earlier method of the same name, except a built-in method. Without
    the argument ``method``, :func:`kc2spice.reduce` tries only built-in methods.

    Parameters
    ----------
    reductor : Reductor
        Reduction method with the attribute ``name``.

    Returns
    -------
    Reductor
        The argument ``reductor``.

    Raises
    ------
    UsageError : the argument has no name or the name of a built-in method, or is not an instance of
        :class:`Reductor`.

    Examples
    --------
    >>> import numpy as np
    >>> import kc2spice as kc
    >>> from scipy.linalg import eigh
    >>> class ModalTruncation(kc.Reductor):
    ...     name = "modal truncation"
    ...     reference = "Craig and Kurdila, Fundamentals of Structural Dynamics (2006), chapter 11"
    ...     def basis(self, task):
    ...         return task.project(eigh(task.model.K, task.model.M)[1])
    >>> kc.register_reductor(ModalTruncation()).name
    'modal truncation'
    >>> model = kc.LinearModel(M=np.eye(3), K=np.diag([1.0, 4.0, 9.0]), B=np.ones((3, 1)))
    >>> kc.reduce(model, order=2, band=(0, 0.1), method="modal truncation").order
    2
    """
    where = "register_reductor"
    _reductors[reductor.name] = _require_free_name(_require_reductor(reductor, where), where)
    return reductor


def _require_reductor(value: object, where: str) -> Reductor:
    """Return the value if it is a reductor with a name; otherwise, raise UsageError."""
    if isinstance(value, Reductor) and isinstance(value.name, str) and value.name:
        return value
    expected, got = "an instance of a subclass of kc.Reductor with a name", repr(value)
    hint = "write a subclass of kc.Reductor as in docs/how-to/own_reductor.md"
    if isinstance(value, type) and issubclass(value, Reductor):
        hint = f"make an instance of the class: {value.__name__}()"
    elif isinstance(value, Reductor):
        got, hint = f"{type(value).__name__} without a name", "add name = '...' to the class"
    elif isinstance(value, np.ndarray):
        got = f"ndarray of shape {value.shape}"
        hint = "return task.project(V) from basis() of a subclass of kc.Reductor"
    raise UsageError(
        "this object is not a reduction method", where=where, got=got, expected=expected, hint=hint
    )


def _require_free_name(reductor: Reductor, where: str) -> Reductor:
    """Return a reductor; raise UsageError if another built-in method has its name."""
    if reductor.name in _BUILT_IN_NAMES and not is_built_in(reductor):
        hint = f"write  name = 'my {reductor.name}'  in the class {type(reductor).__name__}"
        raise make_built_in_name_error("reduction method", reductor.name, where, hint)
    return reductor


@cache
def _load_installed_reductors() -> None:
    """Register reduction methods of installed packages, except names that the user registered."""
    for name in list_entry_points(ENTRY_POINT_GROUP):
        where = f"entry point {name} of {ENTRY_POINT_GROUP}"
        plugin = _require_reductor(load_plugin(ENTRY_POINT_GROUP, name), where)
        reductor = _require_free_name(plugin, where)
        _reductors.setdefault(reductor.name, reductor)


def list_reductor_names() -> list[str]:
    """Return the names of all reduction methods, built-in methods first."""
    _load_installed_reductors()
    return list(_reductors)


def require_method_name(name: str, where: str, advice: str, advice_for_own_method: str) -> None:
    """Raise UsageError if no reduction method has the given name.

    ``where`` is the argument or option that contains the name. ``advice`` is the hint for the user
    if no registered name is similar. Every hint ends with ``advice_for_own_method``, even if a
    registered name is similar. The unknown name may belong to a user's own method that is not yet
    registered.
    """
    if name not in _reductors and name not in list_reductor_names():
        error = unknown(
            "this reduction method does not exist",
            name,
            _reductors,
            where,
            command="kc2spice reduce MODEL --method compare",
        )
        proposed = did_you_mean(name, list(_reductors))
        begin = f"{proposed} For" if proposed else f"{advice}; for"
        error.hint = f"{begin} your own method, {advice_for_own_method}"
        raise error


def find_reductor(method: str | Reductor) -> Reductor:
    """Return the reductor named ``method``; if ``method`` is a reductor, return it.

    Raises
    ------
    UsageError : no reduction method has the given name, or ``method`` is neither a name nor a
        reductor.
    """
    if not isinstance(method, str):
        return _require_reductor(method, "method")
    require_method_name(method, "method", "leave out method", "call kc.register_reductor first")
    return _reductors[method]


def is_built_in(reductor: Reductor) -> bool:
    """Return whether a reductor is a built-in method, possibly with other options."""
    return type(reductor) in map(type, _BUILT_IN)


def advise_more_vectors(reductor: Reductor) -> str:
    """Return the hint for the user of a method whose basis has too few vectors."""
    if isinstance(reductor, RationalKrylov) and reductor.points is not None:
        return "add expansion points, or use a larger tolerance"
    if is_built_in(reductor):
        return "leave method out, so that kc2spice selects a method"
    return "return more vectors from basis(), or use a larger tolerance"


def list_suited_reductors(task: ReductionTask) -> list[Reductor]:
    """List the reductors that suit a reduction task, in the order of their use.

    The reductors are response POD and balanced truncation. Congruences come first. In the norm
    *pointwise*, balancing over the band comes next, because it represents notches accurately.
    """
    congruences: list[Reductor] = [POD, CONGRUENT if task.is_collocated else TWO_SIDED_POD]
    if task.norm == "pointwise":
        return [*congruences, OVER_BAND, BALANCED, UNSCALED]
    return [*congruences, BALANCED, UNSCALED, OVER_BAND]
