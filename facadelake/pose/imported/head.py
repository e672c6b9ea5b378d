"""Lines ``# key: value`` that state the conventions of a file of poses."""

from __future__ import annotations

import re
from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path

from facadelake.core.errors import InputDataError

_SAID = re.compile(r"#?\s*([A-Za-z_]+)\s*:\s*(.*)")


def read_head(path: Path, text: str, keys: Sequence[str]) -> tuple[dict[str, str], str]:
    """What the lines before the table say, by key, and the rest of the text.

    A line ``# word: value`` must have one of ``keys``, so that a misspelt one is not passed over; other lines that
    begin with # are comments. Raises InputDataError for an unknown key or one that is said twice.
    """
    said: dict[str, str] = {}
    lines = text.splitlines()
    begin = next((i for i, line in enumerate(lines) if line.strip() and not line.lstrip().startswith("#")), len(lines))
    for number, line in enumerate(lines[:begin], start=1):
        found = _SAID.fullmatch(line.strip())
        if found is None:
            continue
        key, value = found[1], found[2].strip()
        if key not in keys:
            close = get_close_matches(key, keys, n=1)
            raise InputDataError(
                f"{path}, line {number}: unknown key '{key}'"
                + (f" (did you mean '{close[0]}'?)" if close else "")
                + f"; allowed are {', '.join(keys)} (a comment must not begin with a word and a colon)"
            )
        if key in said:
            raise InputDataError(f"{path}, line {number}: {key} is said twice; keep one line")
        said[key] = value
    return said, "\n".join(lines[begin:])
