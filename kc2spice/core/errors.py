"""Exceptions with the place and value of a mistake, accepted values and a remedy."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NoReturn

from kc2spice.core.key_actions import ChangeKey, Direction, Hint, KeyAction, Preposition

# largest length, in characters, of a word that is compared with other words
MAX_COMPARED_LENGTH = 200
MAX_CANDIDATES = 5  # largest number of candidates that an error lists
# smallest number of letters and digits of a word that is searched for inside other names
MIN_FRAGMENT_LENGTH = 4
# smallest number of letters of a known name that is searched for among the words of a longer name
MIN_WORD_LENGTH = 3
# Similarity above which a typed word is a known name with a typing error. One wrong letter changes
# the similarity of a name of at least seven letters to at least this value.
TYPING_ERROR_RATIO = 0.85


class Kc2spiceError(Exception):
    """Base of every error that the command line reports without a traceback.

    Parameters
    ----------
    message : the mistake in one sentence.
    where : file, key, line or part that the message is about.
    got, expected : the faulty value and the accepted values.
    hint : the next action, as a text or as a change of a key.
    """

    exit_code = 1

    def __init__(
        self,
        message: str,
        *,
        where: str | None = None,
        got: object = None,
        expected: str | None = None,
        hint: Hint | None = None,
    ) -> None:
        super().__init__(message)
        self.message, self.where = message, where
        self.got, self.expected = got, expected
        self._hint = hint

    @property
    def hint(self) -> str | None:
        """Text of the next action; a change of a key is written as in a TOML file."""
        return None if self._hint is None else str(self._hint)

    @hint.setter
    def hint(self, hint: Hint | None) -> None:
        self._hint = hint

    @property
    def action(self) -> KeyAction | None:
        """Next action as data if the action changes a key, otherwise None."""
        return None if isinstance(self._hint, str) else self._hint

    @property
    def next_action(self) -> Hint | None:
        """Next action as data if the action changes a key, otherwise the text of the hint."""
        return self._hint

    @property
    def text_arguments(self) -> dict[str, Any]:
        """Constructor arguments of an equal error, with the hint as plain text."""
        names = ("message", "where", "got", "expected", "hint")
        return {name: getattr(self, name) for name in names}

    def __str__(self) -> str:
        head = f"{self.where}: {self.message}" if self.where else self.message
        rows = {"got:": self.got, "expected:": self.expected, "next:": self.hint}
        lines = (f"  {word:<9} {text}" for word, text in rows.items() if text is not None)
        return "\n".join((head, *lines))


class UsageError(Kc2spiceError):
    """Error for a bad command line, scene, model or included file: exit code 2."""

    exit_code = 2


class UnknownNameError(UsageError, KeyError):
    """Error for a name that is not in a mapping of results; also a ``KeyError``."""


class ArgumentError(UsageError, TypeError):
    """Error for a Python call with wrong arguments; also a ``TypeError``."""


class NamedValues(dict[str, Any]):
    """Mapping of names to results; an unknown name raises an error with similar names.

    Examples
    --------
    >>> NamedValues(resonance_hz=6298.0)["resonance"]
    Traceback (most recent call last):
        ...
    kc2spice.core.errors.UnknownNameError: no such name
      got:      'resonance'
      expected: one of resonance_hz
      next:     did you mean 'resonance_hz'?
    """

    def __missing__(self, name: object) -> NoReturn:
        """Raise an error that lists similar names."""
        error = unknown("no such name", name, self)
        raise UnknownNameError(
            error.message, got=error.got, expected=error.expected, hint=error.hint
        )


class MissingToolError(Kc2spiceError):
    """Error for a simulator or library that is not installed: exit code 3."""

    exit_code = 3


class GateMissedError(Kc2spiceError):
    """Error for a missed gate: the error of a result exceeds its limit; exit code 4."""

    exit_code = 4


class SimulationError(Kc2spiceError):
    """Error for a failed solver or simulator, or a failed physics check: exit code 5."""

    exit_code = 5


@contextmanager
def name_part_in_errors(where: str) -> Iterator[None]:
    """Add the name of a part to the errors that the ``with`` block raises."""
    try:
        yield
    except UsageError as error:
        error.where = where if error.where is None else f"{where}: {error.where}"
        raise


def wrong(
    where: str | None,
    problem: str,
    got: object = None,
    expected: str | None = None,
    hint: Hint | None = None,
) -> UsageError:
    """Make a :class:`UsageError` about a wrong file, key or value.

    If ``hint`` is missing and ``expected`` states a limit, the hint is to satisfy this limit.
    """
    hint = hint or advise_limit(where, expected)
    return UsageError(problem, where=where, got=got, expected=expected, hint=hint)


# Each key contains the first words of a limit, such as "at most" in the limit "at most 5 m".
# Each value contains the verb and the preposition of the hint, such as "lower" and "to".
# For the limit "at most 5 m", for example, the hint is "lower KEY to 5 m".
_LIMIT_ACTIONS: dict[str, tuple[Direction, Preposition]] = {
    "at most": ("lower", "to"),
    "at least": ("raise", "to"),
    "less than": ("lower", "below"),
    "below": ("lower", "below"),
    "more than": ("raise", "above"),
    "greater than": ("raise", "above"),
    "above": ("raise", "above"),
}


def advise_limit(where: str | None, expected: str | None) -> ChangeKey | None:
    """Return advice on how to change a key so that its value satisfies a limit.

    >>> print(advise_limit("gap.travel", "less than the gap, 1e-06 m"))
    lower travel below 1e-06 m
    >>> print(advise_limit("listener.angle", "at most 90 degrees"))
    lower angle to 90 degrees
    """
    limit = _LIMIT.match(expected or "")
    if not where or limit is None:
        return None
    verb, preposition = _LIMIT_ACTIONS[limit[1]]
    key = where.rpartition(" ")[2].rpartition(".")[2].removeprefix("--")
    return ChangeKey(verb, key, preposition, limit[2])


# Pattern of a limit with a number, such as "at most 5 m" or "less than the gap, 1e-06 m".
_LIMIT = re.compile(
    rf"({'|'.join(_LIMIT_ACTIONS)}) (?:[^,;]*, )?(-?\d[\d.e+-]*(?: [\w/%]+)?)(?=$|[,;:])"
)


def unknown(
    message: str,
    name: object,
    known: Iterable[str],
    where: str | None = None,
    command: str | None = None,
    advice: str | None = None,
) -> UsageError:
    """Make the error for a name that does not exist, with a list of similar names.

    The error lists similar names. ``command`` is the command line or page that lists all known
    names. ``advice`` is the next action if no known name is similar.
    """
    choices = list(known)
    expected = (
        "one of " + list_candidates(name, choices, command)
        if choices
        else "nothing: there are no names to choose from"
    )
    hint = did_you_mean(str(name), choices) or advice
    if hint is None and choices:
        listed = command is not None and len(choices) > MAX_CANDIDATES
        hint = f"see {command}, which lists all names" if listed else "write one of these names"
        if len(choices) == 1:
            hint = f"write {choices[0]} in place of {name}"
    return UsageError(message, where=where, got=repr(name), expected=expected, hint=hint)


def list_candidates(word: object, choices: Iterable[str], command: str | None = None) -> str:
    """List at most five of the accepted names, with the most similar name first.

    ``command`` is the command line that lists all choices.

    >>> list_candidates("v", ["a", "b"])
    'a, b'
    >>> list_candidates("c4", [f"c{k}" for k in range(9)])
    'c4, c0, c1, c2, c3, … (9 in all)'
    """
    names = list(choices)
    if len(names) <= MAX_CANDIDATES:
        return ", ".join(names)
    import difflib  # difflib is imported here, because most errors do not need it

    def compute_dissimilarity(name: str) -> float:
        """Return a measure of the difference between a choice and the typed word."""
        return -difflib.SequenceMatcher(None, str(word)[:MAX_COMPARED_LENGTH], name).ratio()

    nearest = sorted(names, key=compute_dissimilarity)[:MAX_CANDIDATES]
    where = "" if command is None else f": {command}"
    return f"{', '.join(nearest)}, … ({len(names)} in all{where})"


def join_first(items: Sequence[str], separator: str = ", ") -> str:
    """Join at most the first five items; an ellipsis stands for further items.

    >>> join_first(["a", "b", "c", "d", "e", "f"])
    'a, b, c, d, e, …'
    """
    more = ("…",) if len(items) > MAX_CANDIDATES else ()
    return separator.join((*items[:MAX_CANDIDATES], *more))


def join_words(words: Sequence[str]) -> str:
    """Join words with commas, and with ``and`` before the last word.

    >>> join_words(["a", "b", "c"])
    'a, b and c'
    """
    return " and ".join(filter(None, (", ".join(words[:-1]), words[-1])))


def did_you_mean(word: str, choices: Iterable[str]) -> str | None:
    """Return the hint ``did you mean 'x'?`` if a choice is similar to ``word``.

    Only the last parts of dotted keys are compared. Letter case is ignored.
    """
    import difflib  # difflib is imported here, because most errors do not need it

    if len(word) > MAX_COMPARED_LENGTH:
        return None  # the time of a comparison is proportional to the square of the word's length
    choices = list(choices)
    owner, dot, _ = word.partition(".")
    same_owner = [choice for choice in choices if dot and choice.startswith(f"{owner}.")]
    if same_owner and len(same_owner) < len(choices):  # names of the same part are suggested first
        suggestion = did_you_mean(word, same_owner)
        last = word.rpartition(".")[2].lower()
        prefixes = [  # a longer or shorter form of a name, such as v of voltage
            item
            for item in same_owner
            if last and _share_beginning(last, item.rpartition(".")[2].lower())
        ]
        if suggestion or prefixes:
            return suggestion or f"did you mean {prefixes[0]!r}?"
    leaves: dict[str, str] = {}
    for choice in choices:
        leaves.setdefault(choice.rpartition(".")[2], choice)
    lower = {leaf.lower(): leaf for leaf in leaves}
    last = word.rpartition(".")[2].lower()
    close = difflib.get_close_matches(last, lower, n=1, cutoff=0.7)
    similar = [lower[leaf] for leaf in close]
    longer = [leaf for leaf in leaves if _is_longer_name(last, leaf.lower())]
    if longer and not difflib.get_close_matches(last, close, n=1, cutoff=TYPING_ERROR_RATIO):
        # the last words of a name, such as disc in piezo_disc, usually determine the meaning
        similar = [max(longer, key=lambda leaf: (last.endswith(leaf.lower()), len(leaf)))]
    if not similar:  # the user may type the part number 7BB-20-6 instead of buzzer_7bb_20_6
        normalised = normalise_word(word)
        similar = [
            leaf
            for leaf in leaves
            if len(normalised) >= MIN_FRAGMENT_LENGTH and normalised in normalise_word(leaf)
        ][:1]
    return f"did you mean {leaves[similar[0]]!r}?" if similar else None


def _is_longer_name(word: str, name: str) -> bool:
    """Return whether a word is a longer form of a known name, such as piezo_disc of disc.

    The name is a sequence of words inside of ``word``, or the beginning or the end of ``word``.
    """
    if len(name) >= MIN_FRAGMENT_LENGTH and (word.startswith(name) or word.endswith(name)):
        return True
    separated = f"_{name}_".replace("-", "_") in f"_{word}_".replace("-", "_")
    return separated and len(name) >= MIN_WORD_LENGTH


def _share_beginning(word: str, name: str) -> bool:
    """Return whether one of two words is the beginning or the symbol of the other word."""
    return word.startswith(name) or name.startswith(word) or {word, name} == {"i", "current"}


def normalise_word(word: str) -> str:
    """Return the letters and digits of a word in lower case."""
    return "".join(ch for ch in word.lower() if ch.isalnum())
