"""Origin of an override: an option, a TOML file of keys, or a Python mapping."""

from __future__ import annotations

from dataclasses import dataclass

from kc2spice.core.toml_text import clip_text


@dataclass(frozen=True)
class OverrideOrigin:
    """Override as the user typed it, and the place where the user typed it.

    ``text`` is the override, such as ``impact.velocity=-1``. ``is_option`` states whether the
    override is an option ``--set`` or the item of a list of strings, instead of an entry of a
    mapping. ``file`` is the TOML file that contains the override.

    Examples
    --------
    >>> print(OverrideOrigin("impact.velocity=-1", is_option=True))
    --set 'impact.velocity=-1'
    """

    text: str
    is_option: bool
    file: str | None = None

    def __str__(self) -> str:
        first = "--set" if self.is_option else "overrides"
        return f"{first} {self.quoted_text}" + (f" of {self.file}" if self.file else "")

    @property
    def quoted_text(self) -> str:
        """Shortened text of the override, in quotes."""
        return repr(clip_text(self.text))

    def advise_change(self) -> str:
        """Advise to change the override.

        >>> OverrideOrigin("impact.velocity=1", is_option=False).advise_change()
        "change 'impact.velocity=1' in the overrides"
        """
        return f"change {self}" if self.is_option else f"change {self.quoted_text} in the overrides"
