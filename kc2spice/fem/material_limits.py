"""Plausibility of the constants in a material table.

The input is the constants as stated in the table, in SI units. A constant that no material can have
is probably in a wrong unit: the error then contains the value in the likely unit. The module
:mod:`kc2spice.fem.materials` builds the tensors from the constants.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from kc2spice.core.errors import UsageError, join_first
from kc2spice.core.quantities import EPSILON_0

# Relative permittivities in static fields: 1 is the value of vacuum.
# Ceramics with giant permittivity reach 1e5.
MIN_PERMITTIVITY, MAX_PERMITTIVITY = 1.0, 1e6
# Largest strain coefficient [C/N]: relaxor crystals reach 1e-8 C/N, and piezoelectric foams 2e-8.
MAX_STRAIN_COUPLING = 1e-6
# Largest stress coefficient [C/m2]: lead ceramics and crystals reach 30 C/m2.
MAX_STRESS_COUPLING = 1e3
# Largest permitted ratio of two elastic constants of a material.
# The shear modulus of a gel is 1e-6 of its bulk modulus. The factor between GPa and Pa is 1e9.
MAX_ELASTIC_RATIO = 1e8
# Smallest share of the permittivity at constant stress that remains at constant strain.
# In relaxor crystals, which have the strongest coupling, this share is 0.05.
MIN_CLAMPED_SHARE = 0.01
MIN_STIFFNESS, MAX_STIFFNESS = 1e3, 2e12  # Pa, from soft gels to twice the stiffness of diamond

_Values = float | Sequence[float] | Mapping[str, float] | Sequence[Sequence[float]]


def reject_implausible_permittivity(
    values: Mapping[str, float] | Sequence[Sequence[float]],
) -> None:
    """Reject relative permittivities that no material can have."""
    for name, value in _name_diagonal("permittivity", values).items():
        if MIN_PERMITTIVITY <= value <= MAX_PERMITTIVITY:
            continue
        relative = value / EPSILON_0
        hint = "write the relative permittivity, such as 1700 for a ceramic"
        if MIN_PERMITTIVITY <= relative <= MAX_PERMITTIVITY:
            hint = f"write  {name} = {relative:.4g}  if the value is in F/m"
        raise UsageError(
            "no material has this relative permittivity",
            where="permittivity",
            got=f"{name} = {value:g}",
            expected=f"{MIN_PERMITTIVITY:g} to {MAX_PERMITTIVITY:g}",
            hint=hint,
        )


def reject_implausible_coupling(
    key: str, values: Mapping[str, float] | Sequence[Sequence[float]]
) -> None:
    """Reject piezoelectric coefficients that no material can have."""
    strain = key == "strain_coupling"
    limit, unit = (MAX_STRAIN_COUPLING, "C/N") if strain else (MAX_STRESS_COUPLING, "C/m2")
    wrong = {name: v for name, v in _name_entries(key, values).items() if abs(v) > limit}
    if not wrong:
        return
    largest = max(map(abs, wrong.values()))
    exponent, likely = (-3, "mC/m2")
    if strain:
        exponent, likely = (-12, "pC/N") if largest >= 1 else (-9, "nC/N")
    hint = f"multiply the matrix by 1e{exponent} if its values are in {likely}"
    if isinstance(values, Mapping):
        hint = f"write  {_format_scaled_components(wrong, exponent)}  if the values are in {likely}"
    raise UsageError(
        "no material has these piezoelectric coefficients",
        where=key,
        got=_list_components(wrong, unit),
        expected=f"magnitudes of at most {limit:g} {unit}",
        hint=hint,
    )


def reject_mixed_elastic_units(key: str, values: _Values) -> None:
    """Reject elastic constants of one material that differ by powers of ten.

    ``key`` is ``stiffness``, ``compliance`` or ``youngs_modulus``. With ``youngs_modulus``, the
    ``values`` are all moduli, keyed by name.
    """
    entries = _name_diagonal(key, values)
    sizes = {name: abs(value) for name, value in entries.items() if value}
    if not sizes:
        return
    soft = key == "compliance"
    reference = min(sizes.values()) if soft else max(sizes.values())
    wrong = {}
    for name, size in sizes.items():
        ratio = size / reference if soft else reference / size
        if ratio > MAX_ELASTIC_RATIO:
            wrong[name] = entries[name]
    if not wrong:
        return
    unit, exponent, likely = ("1/Pa", -12, "1/TPa") if soft else ("Pa", 9, "GPa")
    hint = f"state all values in {unit}; these values seem to be in {likely}"
    if isinstance(values, Mapping):
        hint = f"write  {_format_scaled_components(wrong, exponent)}  if the values are in {likely}"
    raise UsageError(
        "some elastic constants are in another unit than the other constants",
        where=key,
        got=_list_components(wrong, unit),
        expected=f"constants whose magnitudes differ at most by a factor of {MAX_ELASTIC_RATIO:g}",
        hint=hint,
    )


def reject_implausible_stiffness(largest: float, key: str, values: _Values) -> None:
    """Reject a material whose largest stiffness is implausible.

    A stiffness below :data:`MIN_STIFFNESS` or above :data:`MAX_STIFFNESS` is outside of the range
    of all materials. ``largest`` [Pa] is the largest diagonal entry of the stiffness matrix. The
    ``values`` are the constants under the ``key`` of the table.
    """
    if MIN_STIFFNESS <= largest <= MAX_STIFFNESS:
        return
    hint = 'numbers are in SI: write "121 GPa" or 121e9, "16.4e-12 1/Pa" or 16.4e-12'
    soft = key == "compliance"
    for exponent, unit in ((12, "1/TPa"), (9, "1/GPa")) if soft else ((9, "GPa"), (6, "MPa")):
        if not MIN_STIFFNESS <= 10.0**exponent * largest <= MAX_STIFFNESS:
            continue
        power = -exponent if soft else exponent
        if isinstance(values, Mapping):
            hint = f"write  {_format_scaled_components(values, power)}  if the values are in {unit}"
        elif isinstance(values, float):
            hint = f'write  {key} = "{values:g} {unit}"'
        else:
            hint = f"multiply all values of {key} by 1e{power} if they are in {unit}"
        break
    raise UsageError(
        "the stiffness is outside of the range of all materials",
        got=f"{largest:g} Pa",
        expected="1e3 to 2e12 Pa",
        hint=hint,
    )


def reject_excessive_coupling(
    coupled: np.ndarray, eps_T: np.ndarray, key: str, stated_at: str | None
) -> None:
    """Reject piezoelectric constants with an excessive coupling factor, such as 1.

    The matrix ``coupled`` (3, 3) [F/m] is the part ``e C^-1 e'`` of the permittivity ``eps_T`` at
    constant stress. The largest eigenvalue of ``coupled`` relative to ``eps_T`` is the square of
    the largest coupling factor (IEEE Std 176-1987, section 5). ``key`` is the key of the
    piezoelectric constants, and ``stated_at`` the value of the key ``permittivity_at``.
    """
    if not coupled.any() or np.diag(eps_T).min() <= 0:
        return
    try:
        factor = np.linalg.cholesky(eps_T)
    except np.linalg.LinAlgError:  # the next check rejects an indefinite permittivity
        return
    relative = np.linalg.solve(factor, np.linalg.solve(factor, coupled).T)
    square = float(np.linalg.eigvalsh(relative)[-1])
    if square <= 1 - MIN_CLAMPED_SHARE:
        return
    hint = f"compare the units of {key} and permittivity with the data sheet"
    if stated_at == "stress" and square >= 1:
        hint = 'write  permittivity_at = "strain"  if the permittivity is at constant strain'
    raise UsageError(
        "the piezoelectric constants are too large for this permittivity",
        where=key,
        got=f"a coupling factor of {np.sqrt(square):.4g}",
        expected=f"at most {np.sqrt(1 - MIN_CLAMPED_SHARE):.4g}",
        hint=hint,
    )


def _name_entries(
    key: str, values: Mapping[str, float] | Sequence[Sequence[float]]
) -> dict[str, float]:
    """Return the entries of a tensor, keyed by component or by row and column."""
    if isinstance(values, Mapping):
        return dict(values)
    result = {}
    for i, row in enumerate(values):
        for j, value in enumerate(row):
            result[f"{key}[{i}][{j}]"] = value
    return result


def _name_diagonal(key: str, values: _Values) -> dict[str, float]:
    """Return the diagonal entries of a tensor, keyed by component or index."""
    if isinstance(values, Mapping):
        return dict(values)
    if isinstance(values, float):
        return {key: values}
    result = {}
    for i, row in enumerate(values):
        if isinstance(row, Sequence) and i < len(row):
            result[f"{key}[{i}][{i}]"] = row[i]
    return result


def _list_components(values: Mapping[str, float], unit: str) -> str:
    """Return at most five components with their unit, for messages."""
    texts = [f"{name} = {value:g} {unit}" for name, value in values.items()]
    return join_first(texts)


def _format_scaled_components(values: Mapping[str, float], exponent: int) -> str:
    """Format tensor components as text, scaled by a power of ten."""
    texts = []
    for name, value in values.items():
        plain = f"{value:g}"
        scaled = f"{value * 10.0**exponent:g}" if "e" in plain else f"{plain}e{exponent}"
        texts.append(f"{name} = {scaled if value else plain}")
    return ", ".join(texts)
