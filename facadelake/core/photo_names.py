"""Match file names of other tools to photographs: tools keep more or less of the path."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass


def _split_path(name: str) -> tuple[str, ...]:
    """Path parts from the last to the first, without root and dots, case-folded."""
    parts = [part for part in name.replace("\\", "/").casefold().split("/") if part not in ("", ".")]
    return tuple(reversed(parts))


@dataclass(frozen=True, kw_only=True)
class NameMatch:
    """The ``photo_id`` that a name refers to; None with the ``reason`` where there is none."""

    photo_id: str | None
    reason: str = ""


class PhotoNames:
    """Photographs by path. A name matches a photo_id where the parts of one path are the last parts of the other.

    ``IMG_1.JPG`` and ``/home/a/closerange/IMG_1.JPG`` both match ``closerange/IMG_1.JPG``. ``wide/IMG_1.JPG`` does not,
    and ``IMG_1.JPG`` does not where two folders hold a file of that name. Equal file names in different folders never
    match, because cameras restart their counters with every flight.
    """

    def __init__(self, photo_ids: Iterable[str]) -> None:
        self._exact = set(photo_ids)
        self._by_file: dict[str, list[str]] = defaultdict(list)
        for photo_id in sorted(self._exact):
            if parts := _split_path(photo_id):
                self._by_file[parts[0]].append(photo_id)

    def match(self, name: str) -> NameMatch:
        """The photograph that ``name`` refers to."""
        if name in self._exact:
            return NameMatch(photo_id=name)
        parts = _split_path(name)
        candidates = self._by_file.get(parts[0], []) if parts else []
        matches = [c for c in candidates if all(a == b for a, b in zip(_split_path(c), parts, strict=False))]
        # The longest common end decides: "a/b/IMG.JPG" is b/IMG.JPG rather than IMG.JPG of the top folder.
        longest = max((min(len(_split_path(c)), len(parts)) for c in matches), default=0)
        best = [c for c in matches if min(len(_split_path(c)), len(parts)) == longest]
        exact = [c for c in best if len(_split_path(c)) == len(parts)]
        if len(best) == 1 or len(exact) == 1:
            return NameMatch(photo_id=(exact or best)[0])
        if best:
            reason = f"'{name}' matches {', '.join(best[:3])}; give its folder, too"
        elif candidates:
            reason = f"'{name}' is not in the campaign; {candidates[0]} is in another folder"
        else:
            reason = f"'{name}' is not among the campaign's photographs"
        return NameMatch(photo_id=None, reason=reason)
