"""Parts of error messages, as the command line prints them and as Python calls raise them."""

import pytest

import kc2spice as kc


def rows(text):
    """First line of a message, and the rows below it by their names."""
    head, *below = text.splitlines() or [""]
    pairs = (line.strip().partition(":") for line in below)
    return {"head": head} | {name: value.strip() for name, _, value in pairs}


def rows_of_error(text):
    """The rows of the error that follows progress or warnings in the output of a command."""
    return rows(text[text.index("kc2spice: error") :])


def fails(call, *args, **names):
    """The error of a call that must raise one."""
    with pytest.raises(kc.errors.UsageError) as caught:
        call(*args, **names)
    return caught.value
