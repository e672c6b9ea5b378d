"""Numbers of a positions file, and their resolution as written."""

from __future__ import annotations

import math
from collections.abc import Iterable


def parse_number(text: str, delimiter: str) -> float:
    """A finite number, with a decimal comma where the columns are separated by semicolons; NaN for other texts."""
    if delimiter == ";" and "." not in text:
        text = text.replace(",", ".")
    try:
        number = float(text)
    except ValueError:
        return math.nan
    return number if math.isfinite(number) else math.nan


def find_step(texts: Iterable[str]) -> float:
    """The resolution of numbers by the decimals of the one with most of them; NaN without any."""
    digits = [len(text.replace(",", ".").partition(".")[2]) for text in texts if text]
    return 10.0 ** -max(digits) if digits else math.nan
