"""Every hard case is met, or refused with the true reason."""

import re

import pytest
from hard_cases import cases_catch, cases_contact, cases_kick, cases_models  # noqa: F401
from hard_cases.kit import CASES, BenchKeys
from support import Kc2spiceError


@pytest.mark.parametrize(("measure", "limit", "refused"), CASES)
def test_hard_case(measure, limit, refused, tmp_path):
    if refused is None:
        error = float(measure(BenchKeys(tmp_path)))
        print(f"error {error:.1e}, limit {limit:.0e}")
        assert error <= limit
        return
    with pytest.raises(Kc2spiceError) as caught:
        measure(BenchKeys(tmp_path))
    assert re.search(refused, " ".join(str(caught.value).split()))
