"""Values of EXIF tags, which may have another type than the standard says."""

from __future__ import annotations

import math
from typing import Any


def parse_number(value: Any) -> float:
    """A number; NaN for anything else."""
    try:
        return float(value)
    except (TypeError, ValueError, ZeroDivisionError, OverflowError):
        return math.nan


def parse_positive(value: Any) -> float:
    """A positive, finite number; NaN for anything else."""
    number = parse_number(value)
    return number if number > 0 and math.isfinite(number) else math.nan


def parse_text(value: Any) -> str:
    """A text up to its NUL, without blanks around it; empty for a missing value."""
    if value is None:
        return ""
    text = value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
    return text.split("\0")[0].strip()
