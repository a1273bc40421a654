"""The linear model: operators with named, typed ports. Full and reduced models are this class.

A reductor maps one :class:`LinearModel` to a smaller one and attaches a :class:`Certificate`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

import numpy as np

Matrix: TypeAlias = Any  # np.ndarray or scipy.sparse array; scipy brings no types
PortKind = Literal["electrical", "mechanical", "rotational", "acceleration", "input", "output"]


@dataclass(frozen=True)
class Port:
    """A place where a model meets its surroundings: one column of B, one row of C.

    ``kind`` fixes the SI pair (input u, output y):

    * *electrical*: voltage [V] between ``pins[0]`` and ``pins[1]``, charge [C] into ``pins[0]``;
    * *mechanical*: force [N] on the body along the port's direction, displacement [m] along it;
    * *rotational*: moment [N m], angle [rad];
    * *acceleration*: acceleration [m/s^2] of the frame that the body is fixed to, and its
      conjugate (B = -M r, y = B' x [kg m]); coordinates are relative to the frame;
    * *input* and *output*: a signal in units of its own, in one direction. An input has no row of
      C, an output no column of B.

    ``across`` and ``flow`` are what 1 V and 1 A on the netlist pin mean (``um`` and ``N``).
    ``pins`` are the names of the netlist pins; empty stands for ``(name,)``, or for
    ``(name, name_ret)`` of an electrical port.
    """

    name: str
    kind: PortKind
    across: str = ""
    flow: str = "-"
    pins: tuple[str, ...] = ()


@dataclass(frozen=True)
class Certificate:
    """What is known about a reduced model's error with respect to the *full* model.

    ``error_estimate`` is the largest relative error of any transfer function over ``band_hz``;
    ``method`` names the estimator.
    """

    band_hz: tuple[float, float]
    error_estimate: float
    method: str
    stable: bool
    passive: bool


@dataclass(frozen=True, repr=False)
class LinearModel:
    """``M x'' + E x' + K x = B u``, ``y = C x + D u`` (second order, ``A`` is None), or
    ``E x' = A x + B u``, ``y = C x + D u`` (first order, ``M`` and ``K`` are None).

    ``M``, ``E``, ``K``, ``A`` (n, n) are sparse or dense, ``B`` (n, inputs), ``C`` (outputs, n) and
    ``D`` (outputs, inputs) dense. All values are SI and of the *whole* device. ``ports`` lists
    conservative ports and signals in the order of the columns of B; the rows of C follow the same
    order (an input has no row, an output no column). Symmetric models with conservative ports
    only have ``C = B'``.

    ``facts`` are the numbers by which an engineer knows the body (``mass_kg``, ``unknowns``,
    ``capacitance_free_f``, …). ``points`` are what a field picture needs of the body, if anything.
    """

    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    ports: tuple[Port, ...]
    M: Matrix = None
    E: Matrix = None
    K: Matrix = None
    A: Matrix = None
    certificate: Certificate | None = None
    facts: Mapping[str, float] = field(default_factory=dict)
