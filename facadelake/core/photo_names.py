"""Match the names of photographs in files of other programs to photographs: the one matcher for all such files.

Programs keep more or less of the path, write it in their system's way, in quotes, without suffix or in other case.
"""

from __future__ import annotations

import posixpath
import unicodedata
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

_QUOTES = ("'", '"')
_SUFFIX_SYNONYMS = {".jpeg": ".jpg", ".jpe": ".jpg", ".jfif": ".jpg", ".tiff": ".tif"}
_LISTED_MAX = 3

_Parts = tuple[str, ...]


def _split_path(name: str) -> _Parts:
    """Path parts from the last to the first, without root, dots, quotes and blanks around; in Unicode's composed form
    (macOS stores file names decomposed)."""
    text = unicodedata.normalize("NFC", name).strip()
    if len(text) > 1 and text[0] == text[-1] and text[0] in _QUOTES:
        text = text[1:-1].strip()
    path = posixpath.normpath(text.replace("\\", "/")) if text else ""
    return tuple(part for part in reversed(path.split("/")) if part not in ("", ".", ".."))


def _fold_case(parts: _Parts) -> _Parts:
    """The path in lower case, with one of the suffixes that mean the same."""
    file, *folders = (unicodedata.normalize("NFC", part.casefold()) for part in parts)
    stem, suffix = posixpath.splitext(file)
    return (stem + _SUFFIX_SYNONYMS.get(suffix, suffix), *folders)


def _remove_suffix(parts: _Parts) -> _Parts:
    file, *folders = _fold_case(parts)
    return (posixpath.splitext(file)[0], *folders)


def _count_common(name: _Parts, photo: _Parts) -> int:
    """Number of parts of the shorter path, where they are the last parts of the longer one; else 0."""
    shorter = min(len(name), len(photo))
    return shorter if name[:shorter] == photo[:shorter] else 0


@dataclass(frozen=True, kw_only=True)
class NameMatch:
    """The ``photo_id`` that a name refers to; None with the ``reason`` where there is none.

    ``candidates``: the photographs that fit equally well, where the name is ambiguous.
    """

    photo_id: str | None
    reason: str = ""
    candidates: tuple[str, ...] = ()


class PhotoNames:
    """Photographs by path. A name matches a photo_id where the parts of one path are the last parts of the other.

    ``IMG_1.JPG``, ``closerange/img_1``, ``"D:\\flight\\closerange\\IMG_1.jpeg"`` and ``/home/a/closerange/IMG_1.JPG``
    all match ``closerange/IMG_1.JPG``: separators, quotes, case and a missing suffix do not matter, unless two
    photographs differ by nothing else. ``wide/IMG_1.JPG`` does not match it, and ``IMG_1.JPG`` does not where two
    folders hold a file of that name. Equal file names in different folders never match, because cameras restart their
    counters with every flight.
    """

    def __init__(self, photo_ids: Iterable[str]) -> None:
        self._exact = {photo_id: parts for photo_id in sorted(set(photo_ids)) if (parts := _split_path(photo_id))}
        self._by_file: dict[str, list[str]] = defaultdict(list)
        self._by_stem: dict[str, list[str]] = defaultdict(list)
        for photo_id, parts in self._exact.items():
            self._by_file[_fold_case(parts)[0]].append(photo_id)
            self._by_stem[_remove_suffix(parts)[0]].append(photo_id)

    def match(self, name: str) -> NameMatch:
        """The photograph that ``name`` refers to, a ``photo_id`` before anything else."""
        if name in self._exact:
            return NameMatch(photo_id=name)
        parts = _split_path(name)
        if not parts:
            return NameMatch(photo_id=None, reason=f"'{name}' names no photograph")
        file = _fold_case(parts)[0]
        # A name counts as one without suffix only where no file has it with its suffix: names contain dots.
        same_file = self._by_file.get(file) or self._by_stem.get(file, [])
        best = self._find_longest(parts, same_file)
        if len(best) == 1:
            return NameMatch(photo_id=best[0])
        if best:
            alike = len({_remove_suffix(self._exact[photo_id]) for photo_id in best}) == 1
            remedy = "give its suffix as the file has it, too" if alike else "give its folder, too"
            reason = f"'{name}' matches {_list_names(best)}; {remedy}"
            return NameMatch(photo_id=None, reason=reason, candidates=tuple(best))
        if same_file:
            reason = f"'{name}' is not in the campaign; {same_file[0]} is in another folder"
        else:
            reason = f"'{name}' is not among the campaign's photographs"
        return NameMatch(photo_id=None, reason=reason)

    def match_all(self, names: Iterable[str]) -> Mapping[str, NameMatch]:
        """The photographs that the names of one file refer to, by name.

        Ambiguous here, and not where a name is alone, are different paths that match one photograph
        (``2026-04/IMG_1.JPG`` and ``2026-10/IMG_1.JPG``, where the campaign has ``IMG_1.JPG``), and the name of a
        photograph outside folders which a folder holds as well, unless all names of the file are whole paths.
        """
        matches = {name: self.match(name) for name in dict.fromkeys(names)}
        has_folder = {name: "/" in name.replace("\\", "/") for name in matches}
        if not (any(has_folder.values()) and matches.keys() <= self._exact.keys()):
            matches = {
                name: match if has_folder[name] else self._require_single_file(name, match)
                for name, match in matches.items()
            }
        names_of: dict[str, list[str]] = defaultdict(list)
        for name, match in matches.items():
            if match.photo_id is not None:
                names_of[match.photo_id].append(name)
        for photo_id, same in names_of.items():
            if len({_remove_suffix(_split_path(name)) for name in same}) > 1:
                listed = _list_names([f"'{name}'" for name in same])
                reason = (
                    f"{listed} match the same photograph {photo_id}; write its path in one way, as the campaign has it"
                )
                matches |= {name: NameMatch(photo_id=None, reason=reason) for name in same}
        return matches

    def _require_single_file(self, name: str, match: NameMatch) -> NameMatch:
        same_file = [] if match.photo_id is None else self._by_file[_fold_case(self._exact[match.photo_id])[0]]
        if len({self._exact[photo_id][1:] for photo_id in same_file}) < 2:
            return match
        reason = f"'{name}' matches {_list_names(same_file)}; give its folder, too"
        return NameMatch(photo_id=None, reason=reason, candidates=tuple(same_file))

    def _find_longest(self, parts: _Parts, candidates: Sequence[str]) -> list[str]:
        """The candidates with the longest common end ("a/b/IMG.JPG" is b/IMG.JPG rather than IMG.JPG of the top
        folder); of these, those of equal length; of these, those of equal case and suffix."""
        ranks = {}
        for photo_id in candidates:
            own = self._exact[photo_id]
            common = max(
                _count_common(_fold_case(parts), written) for written in (_fold_case(own), _remove_suffix(own))
            )
            if common:
                ranks[photo_id] = (common, len(own) == len(parts), _count_common(parts, own) > 0)
        return [photo_id for photo_id, rank in ranks.items() if rank == max(ranks.values())]


def _list_names(names: Sequence[str]) -> str:
    more = f" and {len(names) - _LISTED_MAX} more" if len(names) > _LISTED_MAX else ""
    return ", ".join(names[:_LISTED_MAX]) + more
