"""``python -m validation posterior_cases``."""

from validation.posterior_cases import command as run
from validation.posterior_cases import options

__all__ = ["options", "run"]
