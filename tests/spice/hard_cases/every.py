"""Every hard case: a module of cases registers its own when it is imported."""

from hard_cases import (  # noqa: F401
    cases_catch,
    cases_contact,
    cases_kick,
    cases_models,
)
from hard_cases.kit import CASES

__all__ = ["CASES"]
