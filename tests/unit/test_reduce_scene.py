"""``reduce SCENE:PART``: which bodies a scene has, and what is refused."""

import pytest

from kc2spice.core.errors import UsageError
from kc2spice.workflow.reduce import reduce


def test_a_part_that_is_no_body_is_refused(tmp_path):
    with pytest.raises(UsageError, match="no linear model") as caught:
        reduce("kick_and_catch:sphere", tmp_path / "out")
    assert caught.value.expected == "kick"
    assert not (tmp_path / "out").exists()


def test_an_unknown_part_is_refused(tmp_path):
    with pytest.raises(UsageError, match="no such part"):
        reduce("kick_and_catch:chip", tmp_path / "out")


def test_a_file_with_a_colon_is_a_file(tmp_path):
    with pytest.raises(UsageError, match="no such model"):
        reduce(tmp_path / "no:scene", tmp_path / "out")
