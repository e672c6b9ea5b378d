"""The checkout that Facadelake runs from, and its files that are part of the code: SQL, rule packs.

Every module locates files of the checkout through this one. ``locate_source`` is for files that results are computed
with: the cache's keys cover them (``core.code_version``). ``CHECKOUT`` is for files that users choose or replace (the
portfolio, the detector models); these enter a key as inputs.
"""

from __future__ import annotations

from pathlib import Path

CHECKOUT = Path(__file__).resolve().parents[2]


def locate_source(relative: str) -> Path:
    """The path of a file or folder of the checkout that is part of the code, such as ``"sql/checks"``.

    The argument must be a literal: the code version of every module that imports the caller then covers the content of
    the file, or of all files of the folder.
    """
    return CHECKOUT / relative
