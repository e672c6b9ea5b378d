"""Find the photograph that a file name of another tool means: tools keep more or less of the path."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass


def _split_path(name: str) -> tuple[str, ...]:
    """Path parts from the last to the first, without drive, root and dots; case does not count."""
    parts = [part for part in name.replace("\\", "/").casefold().split("/") if part not in ("", ".")]
    return tuple(reversed(parts))


@dataclass(frozen=True, kw_only=True)
class NameMatch:
    """The photo_id a name stands for, else why there is none."""

    photo_id: str | None
    reason: str = ""


class PhotoNames:
    """Photographs by path; a name matches where it and the photo_id end alike, one being the tail of the other.

    ``IMG_1.JPG`` and ``/home/a/closerange/IMG_1.JPG`` both mean ``closerange/IMG_1.JPG``; ``wide/IMG_1.JPG`` does not,
    and neither does ``IMG_1.JPG`` where two folders hold one. The file's name alone is never enough against another
    folder, because cameras restart their counters with every flight.
    """

    def __init__(self, photo_ids: Iterable[str]) -> None:
        self._exact = set(photo_ids)
        self._by_file: dict[str, list[str]] = defaultdict(list)
        for photo_id in sorted(self._exact):
            if parts := _split_path(photo_id):
                self._by_file[parts[0]].append(photo_id)

    def match(self, name: str) -> NameMatch:
        """The photograph that ``name`` means."""
        if name in self._exact:
            return NameMatch(photo_id=name)
        wanted = _split_path(name)
        candidates = self._by_file.get(wanted[0], []) if wanted else []
        fitting = [c for c in candidates if all(a == b for a, b in zip(_split_path(c), wanted, strict=False))]
        # The longest common tail decides: "a/b/IMG.JPG" means b/IMG.JPG rather than IMG.JPG of the top folder.
        longest = max((min(len(_split_path(c)), len(wanted)) for c in fitting), default=0)
        best = [c for c in fitting if min(len(_split_path(c)), len(wanted)) == longest]
        whole = [c for c in best if len(_split_path(c)) == len(wanted)]
        if len(best) == 1 or len(whole) == 1:
            return NameMatch(photo_id=(whole or best)[0])
        if best:
            reason = f"'{name}' could be any of {', '.join(best[:3])}; give its folder too"
        elif candidates:
            reason = f"'{name}' is not in the campaign; {candidates[0]} is in another folder"
        else:
            reason = f"'{name}' is not among the campaign's photographs"
        return NameMatch(photo_id=None, reason=reason)
