"""The checkout that Facadelake runs from, and the files of it that are part of the code: SQL, rule packs.

Every module finds files of the checkout through here. ``locate_source`` names what a result is computed by, so that the
cache's keys cover it (``code_version``); ``CHECKOUT`` alone is for what people choose or replace (the portfolio, the
models), which enters a key as an input where it matters.
"""

from __future__ import annotations

from pathlib import Path

CHECKOUT = Path(__file__).resolve().parents[2]


def locate_source(relative: str) -> Path:
    """A file or folder of the checkout that code is computed by, such as ``"sql/checks"``.

    Call it with a literal: whatever imports the calling module has the file's, or all the folder's, bytes in its code
    version.
    """
    return CHECKOUT / relative
