"""How other simulators spell each construct of our netlists; what they cannot say is refused.

Xyce (Reference Guide, devices B, S, X, commands .PRINT and .SUBCKT) and
LTspice (Help, B sources, .model SW, .save) are the sources.
"""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

from kc2spice.core.errors import UsageError
from kc2spice.netlist.cards import number
from kc2spice.netlist.elements import behaviour, element
from kc2spice.netlist.expression import Binary, Name, Number, Tree, Writer, literal, parse, walk
from kc2spice.netlist.statements import Statement

STEP = 1e-6  # s, largest of Xyce where a controller closes a loop
TIGHT = 1e-5  # largest reltol of Xyce, and a tenth of the given one: contacts within 1e-5
SWITCH_BAND = 1e-3  # V on either side of the threshold: Xyce's switch has no jump
ANALYSES = (".tran", ".ac", ".dc", ".op")
_SAME = frozenset({".ends", ".end", ".include", ".param", ".ic", ".nodeset", *ANALYSES})
_SHARED = frozenset("rcvikfhxdqjm")  # written alike, but for braces and parameters
# Models that all three read alike: SPICE2's own parameters.
_SEMICONDUCTORS = {
    "d": "is rs n tt cjo vj m eg xti fc bv ibv",
    "npn": "is bf nf vaf ikf ise ne br nr var ikr rb rc re cje vje mje tf cjc vjc mjc tr",
    "nmos": "level vto kp gamma phi lambda rd rs is cgso cgdo cgbo tox",
    "njf": "vto beta lambda rd rs cgs cgd pb is",
}
_SEMICONDUCTORS |= {p: _SEMICONDUCTORS[n] for p, n in
                    (("pnp", "npn"), ("pmos", "nmos"), ("pjf", "njf"))}  # fmt: skip
_COMMON = frozenset(
    ("abs", "acos", "asin", "atan", "cos", "cosh", "exp", "floor", "ln", "max", "min", "sgn",
     "sin", "sinh", "sqrt", "tan", "tanh", "uramp")
)  # fmt: skip
_VECTOR = re.compile(r"(?i)@(?:\w\.)?([\w.]+)\[(?:i|id|current)\]|([vi])\(([^()]+)\)")


@dataclass(frozen=True)
class Setup:
    """What the cards of a deck must know of it: its analysis, whether it starts from initial states
    (``uic``), whether a controller is in it, and the nodes that initial states of parts meet."""

    analysis: str = ".tran"
    uic: bool = True
    controlled: bool = True
    starting: tuple[str, ...] = ()


class Dialect(Writer, ABC):
    """One simulator's spelling; subclasses override what differs from each other."""

    title = ""
    subckt_keyword = "PARAMS:"
    instance_keyword = "PARAMS: "
    command = ""
    option_prefix = ".options"
    known_options: frozenset[str] = frozenset()
    joined: frozenset[str] = frozenset()  # commands of which only the last counts
    functions = _COMMON

    def __init__(self, setup: Setup) -> None:
        self.setup = setup
        self.where = "netlist"

    # -- one card ---------------------------------------------------------------------------

    def card(self, s: Statement) -> str:
        """Text of one statement, without its comments."""
        self.where = s.where
        key = s.keyword
        if "^" in s.text or "**" in s.text:
            raise self.refusal(s, "a power like the others")
        if key == ".subckt":
            return self._subckt(s)
        if key == ".model":
            return self._model(s)
        if key in (".options", ".option"):
            return self.options(s)
        if key == ".save":
            return self.save([self.vector(word) for word in s.words[1:]])
        if key == ".tran":
            return self.transient(s)
        if key in _SAME:
            return s.text
        if key.startswith("."):
            raise self.refusal(s, f"the command {key}")
        return self._element(s)

    def refusal(self, s: Statement, what: str) -> UsageError:
        """The error for a construct that this dialect has no words for."""
        return UsageError(f"{self.title} cannot say {what}", where=s.where, got=s.text[:120])

    def _subckt(self, s: Statement) -> str:
        plain = [w for w in s.words if "=" not in w]
        params = [w for w in s.words if "=" in w]
        return " ".join([*plain, *([self.subckt_keyword, *params] if params else [])])

    def _element(self, s: Statement) -> str:
        part = element(s)
        if part.kind == "b":
            quantity, law = behaviour(part)
            tree = parse(law, where=s.where)
            self.refuse_words(s, tree)
            head = " ".join(s.words[:3])
            return f"{head} {quantity}={self.law(tree)}"
        if part.kind == "x" and part.params:
            plain = [w for w in s.words if "=" not in w]
            given = " ".join(w for w in s.words if "=" in w)
            return f"{' '.join(plain)} {self.instance_keyword}{given}"
        if part.kind in "eg" and len(part.nodes) == 4 and not part.params:
            return s.text
        if part.kind == "s":
            return s.text
        if part.kind == "l":
            return self.inductor(s)
        if part.kind in _SHARED and not any(re.search(r"(?i)file|poly", w) for w in s.words):
            return s.text
        raise self.refusal(s, f"this {part.kind.upper()} card")

    def refuse_words(self, s: Statement, tree: Tree) -> None:
        """Operators and words that the simulators read differently."""
        for leaf in walk(tree):
            if isinstance(leaf, Binary) and leaf.op in ("&&", "||", "==", "!="):
                raise self.refusal(s, f"the operator {leaf.op} alike")
            if isinstance(leaf, Name) and leaf.text.lower() in ("temper", "hertz", "e"):
                raise self.refusal(s, f"the word {leaf.text}")

    def _model(self, s: Statement) -> str:
        match = re.fullmatch(r"\.model\s+(\w+)\s+(\w+)\s*\((.*)\)", s.text, re.IGNORECASE)
        if match is None:
            raise self.refusal(s, "this model")
        pairs = re.findall(r"(\w+)\s*=\s*(\{[^}]*\}|\S+)", match[3])
        values = {k.lower(): v for k, v in pairs}
        if match[2].lower() == "sw":
            return self.switch(s, match[1], values)
        known = _SEMICONDUCTORS.get(match[2].lower(), "").split()
        if not set(values) <= set(known) or values.get("level", "1") != "1":
            raise self.refusal(s, "this model")
        return s.text

    # -- what dialects override -------------------------------------------------------------

    def law(self, tree: Tree) -> str:
        """The expression of a behavioural source with what encloses it."""
        return self.write(tree)

    def options(self, s: Statement) -> str:
        """The simulator settings that exist here; what is dropped becomes a comment."""
        kept: list[str] = []
        dropped: list[str] = []
        for word in s.words[1:]:
            known = word.partition("=")[0].lower() in self.known_options
            (kept if known else dropped).append(word)
        lines = [f"{self.option_prefix} {' '.join(kept)}"] if kept else []
        lines += [f"* {self.title} has no option {word}" for word in dropped]
        return "\n".join(lines)

    def transient(self, s: Statement) -> str:
        """The card of a transient analysis."""
        return s.text

    def save(self, vectors: list[str]) -> str:
        """The card that asks for results."""
        return "\n+ ".join([".save", *vectors])

    def inductor(self, s: Statement) -> str:
        """An inductor without losses."""
        return s.text

    @abstractmethod
    def switch(self, s: Statement, name: str, values: dict[str, str]) -> str:
        """A voltage-controlled switch."""

    def vector(self, text: str) -> str:
        """Name of a result."""
        match = _VECTOR.fullmatch(text)
        if match is None:
            raise UsageError(f"{self.title} cannot say this vector", where=self.where, got=text)
        if match[1]:
            *path, device = match[1].split(".")
            return f"I({self.device(path, device)})"
        *path, last = match[3].split(".")
        if match[2].lower() == "i":
            return f"I({self.device(path, last)})"
        return f"V({self.node(path, last)})"

    def node(self, path: list[str], name: str) -> str:
        """A node inside nested instances."""
        return ":".join([*path, name])

    def device(self, path: list[str], name: str) -> str:
        """A part inside nested instances."""
        return ":".join([*path, name])

    # -- expressions ------------------------------------------------------------------------

    def call(self, function: str, arguments: tuple[Tree, ...]) -> str:
        """Functions by what they mean: ``pwl`` is ``table``, ``log`` is the natural one."""
        if function == "pwl":
            head, *pairs = [self.write(a) for a in arguments]
            self._check_table(arguments[1:])
            rows = [f"\n+ {x},{y}" for x, y in zip(pairs[::2], pairs[1::2], strict=True)]
            return f"table({head},{','.join(rows)})"
        spelled = "ln" if function == "log" else function
        if spelled not in self.functions:
            raise UsageError(
                f"{self.title} cannot say the function {function}",
                where=self.where,
                expected=", ".join(sorted(self.functions | {"pwl"})),
            )
        return super().call(spelled, arguments)

    def _check_table(self, values: tuple[Tree, ...]) -> None:
        """``pwl`` goes on with its outer slopes, ``table`` stays flat: the ends must be flat."""
        flat = len(values) >= 4 and values[1] == values[3] and values[-1] == values[-3]
        if len(values) % 2 or not flat:
            raise UsageError(
                f"{self.title} ends every table flat",
                where=self.where,
                got="a pwl() whose outer segments slope",
                expected="two equal values at both ends",
            )

    def choice(self, test: Tree, yes: Tree, no: Tree) -> str:
        """Both simulators have ``if(test, yes, no)``."""
        return f"if({self.write(test)}, {self.write(yes)}, {self.write(no)})"


class Xyce(Dialect):
    """Sandia's Xyce.

    Its ``uramp`` lacks the chain rule (release 7.5), and of two ``.options timeint`` the last
    replaces the first.
    """

    title = "Xyce"
    command = "Xyce"
    option_prefix = ".options timeint"
    known_options = frozenset({"reltol", "abstol", "method"})
    joined = frozenset({".options"})
    functions = _COMMON - {"uramp"}

    def call(self, function: str, arguments: tuple[Tree, ...]) -> str:
        """``max(0, x)`` is differentiated, ``uramp(x)`` is not."""
        if function == "uramp":
            return super().call("max", (Number("0"), *arguments))
        return super().call(function, arguments)

    def card(self, s: Statement) -> str:
        """Xyce obeys ``IC=`` of a part without ``uic`` too, where ngspice ignores it."""
        if not self.setup.uic and s.keyword[:1] in ("c", "l"):
            kept = [word for word in s.words if not word.lower().startswith("ic=")]
            s = s if len(kept) == len(s.words) else replace(s, text=" ".join(kept))
        if s.keyword == ".ac":
            return self.small_signals(s)
        return super().card(s)

    def options(self, s: Statement) -> str:
        """Its error control is looser than ngspice's at one ``reltol``."""
        if self.setup.analysis != ".tran":
            return super().options(s)
        return super().options(replace(s, text=" ".join(map(_tightened, s.words))))

    def small_signals(self, s: Statement) -> str:
        """A logarithmic range goes on to the first point at or beyond its end, as Xyce stops short
        of an end that is not one of its points."""
        words = s.words[1:]
        given = [literal(word, where=s.where) for word in words[1:]]
        per = {"dec": 10.0, "oct": 2.0}.get(words[0].lower()) if words else None
        if per is None or len(given) != 3 or None in given:
            return s.text
        count, start, stop = (float(value or 0.0) for value in given)
        steps = math.ceil(count * math.log(stop / start, per) - 1e-6)
        beyond = start * per ** ((steps + 1e-6) / count)  # rounding must not lose it
        return " ".join([*s.words[:4], number(beyond)])

    def transient(self, s: Statement) -> str:
        """A ceiling of the step where a controller closes a loop: Xyce's error control alone loses
        5e-4 of a launch. Contacts begin from where they rest, not from a bounce."""
        if not self.setup.uic and self.setup.starting:
            guesses = " ".join(f"V({node})=0" for node in self.setup.starting)
            return f".nodeset {guesses}\n{self._limited(s)}"
        return self._limited(s)

    def _limited(self, s: Statement) -> str:
        if not self.setup.controlled:
            return s.text
        words = [w for w in s.words[1:] if w.lower() == "uic"]
        numbers = [w for w in s.words[1:] if w not in words]
        step, stop, start, ceiling = [*numbers, *["0", number(STEP)][len(numbers) - 2 :]]
        given = literal(ceiling, where=s.where)
        if given is None or given > STEP:
            ceiling = number(STEP)
        return " ".join([s.keyword, step, stop, start, ceiling, *words])

    def law(self, tree: Tree) -> str:
        """Braces around all expressions are required."""
        return "{" + self.write(tree) + "}"

    def save(self, vectors: list[str]) -> str:
        """Results are printed per analysis."""
        kind = self.setup.analysis.removeprefix(".").upper()
        return "\n+ ".join([f".print {kind} format=raw", *vectors])

    def switch(self, s: Statement, name: str, values: dict[str, str]) -> str:
        """``VON`` and ``VOFF`` must differ; hysteresis does not exist."""
        band, middle = (literal(values.get(key, "0"), where=s.where) for key in ("vh", "vt"))
        if band != 0.0:
            raise self.refusal(s, "a switch with hysteresis")
        if middle is None:
            raise self.refusal(s, "a switch whose threshold is an expression")
        return (
            f".model {name} VSWITCH(VON={number(middle + SWITCH_BAND)} "
            f"VOFF={number(middle - SWITCH_BAND)} "
            f"RON={values.get('ron', '1')} ROFF={values.get('roff', '1e12')})"
        )


def _tightened(word: str) -> str:
    """An option of ngspice, ``reltol`` as Xyce needs it."""
    name, _, value = word.partition("=")
    if name.lower() != "reltol":
        return word
    given = literal(value, where="reltol")
    return f"{name}={number(TIGHT if given is None else min(given / 10, TIGHT))}"


class LTspice(Dialect):
    """Analog Devices' LTspice."""

    title = "LTspice"
    command = "LTspice -b"
    subckt_keyword = "params:"
    instance_keyword = "params: "
    known_options = frozenset(
        {"reltol", "abstol", "vntol", "chgtol", "trtol", "method", "gmin", "itl1", "itl2", "itl4"}
    )

    def name(self, text: str) -> str:
        """Parameters are put in as numbers, so a sign must not meet an operator."""
        return text if text.lower() in ("time", "pi") else f"({{{text}}})"

    def switch(self, s: Statement, name: str, values: dict[str, str]) -> str:
        """The same model; the default of ``ROFF`` differs, so both are always written."""
        given = {"vt": "0", "vh": "0", "ron": "1", "roff": "1e12"} | values
        return f".model {name} SW({' '.join(f'{k.upper()}={v}' for k, v in given.items())})"

    def inductor(self, s: Statement) -> str:
        """LTspice gives inductors a milliohm unless told otherwise."""
        return f"{s.text} Rser=0"

    def node(self, path: list[str], name: str) -> str:
        """Instances are called without their X."""
        return ":".join([*(p[1:] for p in path), name])

    def device(self, path: list[str], name: str) -> str:
        """``b:contact:ring0``: letter, instances, rest of the name."""
        return ":".join([name[0], *(p[1:] for p in path), name[1:]]) if path else name
