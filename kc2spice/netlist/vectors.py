"""Names of results: voltages of nodes and currents of devices, also inside of instances."""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Trace:
    """A saved vector: ``quantity`` is ``v`` of one or two nodes (``xa.xb.node``) or ``i`` of the
    device ``names[0]`` inside of the instances ``path``, by its ``parameter`` where it has one.
    """

    quantity: str
    names: tuple[str, ...]
    path: tuple[str, ...] = ()
    parameter: str = ""

    def within(self, instance: str) -> Trace:
        """The same inside of an instance of the circuit."""
        if self.quantity == "v":
            return replace(self, names=tuple(f"{instance}.{name}" for name in self.names))
        return replace(self, path=(instance, *self.path))

    def __str__(self) -> str:
        """As ngspice has it: the letter of an inner device stands before its path."""
        device = ".".join([self.names[0][0], *self.path, *self.names] if self.path else self.names)
        if self.parameter:
            return f"@{device}[{self.parameter}]"
        return f"{self.quantity}({','.join(self.names) if self.quantity == 'v' else device})"


def vector(text: str) -> Trace | None:
    """``v(node)``, ``v(a,b)``, a bare node, ``i(source)`` or ``@device[parameter]`` as a trace.

    None of anything else.
    """
    text = text.strip("\"'")
    head, _, inside = text.partition("(")
    if text.startswith("@") and text.endswith("]"):
        device, _, parameter = text[1:-1].partition("[")
        return _device(device, parameter)
    if not inside:
        return Trace("v", (text,))
    if head.lower() not in ("v", "i") or not inside.endswith(")") or "(" in inside:
        return None
    names = tuple(name.strip() for name in inside[:-1].split(","))
    return Trace("v", names) if head.lower() == "v" else _device(names[0], "")


def _device(text: str, parameter: str) -> Trace:
    *path, name = text.split(".")
    inner = path[1:] if path and len(path[0]) == 1 else path
    return Trace("i", (name,), tuple(inner), parameter)


def terms(expression: str) -> list[tuple[float, str]]:
    """Signs and vectors of a sum: ``v(a)-v(b)`` is ``[(1, "v(a)"), (-1, "v(b)")]``."""
    found = (term for term in expression.replace("-", "+-").split("+") if term)
    return [(-1.0 if term.startswith("-") else 1.0, term.removeprefix("-")) for term in found]


def added(signed: list[tuple[float, str]]) -> str:
    """The inverse of :func:`terms`."""
    return "".join(("-" if sign < 0 else "+") + text for sign, text in signed).removeprefix("+")
