"""Read the portfolio: one YAML file, or a folder with one file per building."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlparse

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError

from facadelake.core.errors import InputDataError, suggest_name
from facadelake.registry.building import Building
from facadelake.registry.settings import DEFAULT_MODEL
from facadelake.registry.surface_kinds import AS_BUILT

_PATH_KEYWORDS = (AS_BUILT, DEFAULT_MODEL)  # in place of a path
_VARIABLE = re.compile(r"\$\{(\w+)(?::-([^}]*))?\}")
_PATH_KEYS = (
    ("model",),
    ("crs", "offset_file"),
    ("photographs",),
    ("control_points",),
    ("check_points",),
    ("poses",),
    ("positions", "file"),
    ("detector", "file"),
    ("detector", "model"),
    ("detector", "card"),
)
_OBJECT_STORES = ("s3",)
_LOCATION_KEYS = (("intake", "source"),)  # a path, or a prefix of an object store


class Portfolio(BaseModel):
    """All buildings of the portfolio."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    buildings: tuple[Building, ...]

    def get_building(self, building_id: str) -> Building:
        """The building of an id. Raises InputDataError, with the known ids, where there is none."""
        for building in self.buildings:
            if building.id == building_id:
                return building
        known = ", ".join(building.id for building in self.buildings) or "none"
        similar = suggest_name(building_id, (building.id for building in self.buildings))
        raise InputDataError(f"there is no building '{building_id}' in the portfolio{similar}; it has {known}")


def read_portfolio(path: Path) -> Portfolio:
    """Read the portfolio at ``path``: a YAML file with ``buildings:``, or a folder of files with one building each.

    Paths are relative to their file; ``${NAME:-default}`` is replaced by an environment variable; ``file://`` URIs are
    paths. Raises InputDataError that lists all mistakes with file, key, value and what is allowed.
    """
    files = sorted([*path.glob("*.yaml"), *path.glob("*.yml")]) if path.is_dir() else [path]
    if not files or not all(file.is_file() for file in files):
        raise InputDataError(
            f"there is no portfolio at {path}; give a YAML file, or a folder of them, with --portfolio"
        )
    mistakes: list[str] = []
    buildings: list[Building] = []
    for file in files:
        for where, entry in _read_entries(file, mistakes):
            try:
                building = Building.model_validate(_resolve_entry(entry, file))
                building.record_variables(sorted({name for name, _ in _VARIABLE.findall(str(entry))}))
                buildings.append(building)
            except ValidationError as error:
                mistakes += [_format_error(file, where, entry, detail) for detail in error.errors()]
            except InputDataError as error:
                mistakes.append(f"{file}: {where}: {error}")
    ids = [building.id for building in buildings]
    repeated = sorted({i for i in ids if ids.count(i) > 1})
    mistakes += [f"{path}: several buildings have the id '{identifier}'; ids must be unique" for identifier in repeated]
    if mistakes:
        raise InputDataError("the portfolio has mistakes:\n  " + "\n  ".join(mistakes))
    return Portfolio(buildings=tuple(buildings))


def _read_entries(file: Path, mistakes: list[str]) -> Iterator[tuple[str, dict[str, Any]]]:
    """The buildings of one file, each with its location in the file."""
    try:
        content = yaml.safe_load(file.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        mistakes.append(f"{file}: not readable as YAML: {' '.join(str(error).split())}")
        return
    if content is None:
        mistakes.append(
            f"{file}: the file is empty; 'buildings:' with a list of buildings is expected, or one building"
        )
        return
    if isinstance(content, dict) and "buildings" in content:
        unknown = sorted(content.keys() - {"buildings"})
        if unknown:
            mistakes.append(f"{file}: unknown key {unknown[0]!r}; 'buildings' is the only key allowed")
        entries = content["buildings"]
        if not isinstance(entries, list):
            mistakes.append(f"{file}: 'buildings' is {type(entries).__name__}; a list of buildings is allowed")
            return
        named = [(f"buildings[{index}]", entry) for index, entry in enumerate(entries)]
    else:
        named = [("building", content)]
    for where, entry in named:
        if isinstance(entry, dict):
            yield where, entry
        else:
            mistakes.append(
                f"{file}: {where} is {entry!r}; a mapping with the keys {', '.join(Building.model_fields)} is allowed"
            )


def _resolve_entry(entry: dict[str, Any], file: Path) -> dict[str, Any]:
    """The entry with absolute paths and environment variables replaced."""
    out = dict(entry)
    for name in ("detector", "crs", "positions", "intake"):
        if isinstance(out.get(name), dict):
            out[name] = dict(out[name])
    if isinstance(out.get("detector"), dict):
        alternatives = out["detector"].get("alternatives")
        if isinstance(alternatives, dict):
            out["detector"]["alternatives"] = {
                name: resolve_location(value, file) if isinstance(value, str) else value
                for name, value in alternatives.items()
            }
    for keys in (*_PATH_KEYS, *_LOCATION_KEYS):
        holder: Any = out
        for key in keys[:-1]:
            holder = holder.get(key) if isinstance(holder, dict) else None
        if (
            isinstance(holder, dict)
            and isinstance(holder.get(keys[-1]), str)
            and holder[keys[-1]] not in _PATH_KEYWORDS
        ):
            schemes = _OBJECT_STORES if keys in _LOCATION_KEYS else ()
            holder[keys[-1]] = resolve_location(holder[keys[-1]], file, schemes)
    return out


def resolve_location(text: str, file: Path, schemes: Sequence[str] = ()) -> str:
    """An absolute path, or a URI of one of ``schemes`` unchanged; ``${NAME:-default}`` is replaced.

    Args:
        text: a path relative to the folder of ``file``, a ``file://`` URI, or a URI of one of ``schemes``.
        file: the file it stands in.
        schemes: schemes that are allowed besides ``file``.

    Raises InputDataError for another scheme, and for an environment variable that is not set.
    """

    def substitute(match: re.Match[str]) -> str:
        value = os.environ.get(match[1]) or match[2]
        if value is None:
            raise InputDataError(
                f"'{text}' needs the environment variable {match[1]}, which is not set; set it to a folder"
            )
        return value

    text = _VARIABLE.sub(substitute, text)
    if "://" in text:
        uri = urlparse(text)
        if uri.scheme in schemes:
            return text
        if uri.scheme != "file":
            also = "".join(f", or a {scheme}:// URI," for scheme in schemes) or " or a file:// URI"
            raise InputDataError(f"'{text}' has the scheme '{uri.scheme}'; a path{also} is allowed")
        text = unquote(uri.path)
    return os.path.normpath(file.resolve().parent / Path(text).expanduser())


def _format_error(file: Path, where: str, entry: dict[str, Any], detail: Any) -> str:
    """Message of one error of pydantic: file, key, value, and what is allowed."""
    location = [str(part) for part in detail["loc"] if part not in ("coco", "onnx")]
    key = ".".join([where, *location])
    name = f" (id {entry['id']!r})" if "id" in entry else ""
    kind, context = detail["type"], detail.get("ctx", {})
    if kind == "extra_forbidden":
        allowed = _list_allowed_keys(entry, location[:-1])
        close = get_close_matches(location[-1], allowed, n=1)
        suggestion = f" (did you mean '{close[0]}'?)" if close else ""
        return f"{file}: {key}{name}: unknown key{suggestion}; allowed are {', '.join(allowed)}"
    if kind == "missing":
        return f"{file}: {key}{name}: missing; every {'building' if len(location) == 1 else location[-2]} needs it"
    if kind == "union_tag_invalid":
        return f"{file}: {key}.kind{name}: {context.get('tag')!r}; allowed are {context.get('expected_tags')}"
    if kind == "union_tag_not_found":
        return f"{file}: {key}.kind{name}: missing; allowed are 'coco', 'onnx'"
    message = detail["msg"].removeprefix("Value error, ")
    value = "" if isinstance(detail["input"], dict) else f" {detail['input']!r}:"
    return f"{file}: {key}{name}:{value} {message}"


def _list_allowed_keys(entry: dict[str, Any], parents: list[str]) -> list[str]:
    """The keys that are allowed in the mapping at ``parents``."""
    model: Any = Building
    for parent in (name for name in parents if not name.isdigit()):  # the keys of a list are those of its members
        annotation = model.model_fields[parent].annotation
        candidates = [annotation, *getattr(annotation, "__args__", ())]
        models = [c for c in candidates if isinstance(c, type) and issubclass(c, BaseModel)]
        kind = entry.get(parent, {}).get("kind") if isinstance(entry.get(parent), dict) else None
        chosen = [
            m
            for m in models
            if "kind" in m.model_fields and kind in getattr(m.model_fields["kind"].annotation, "__args__", ())
        ]
        model = (chosen or models)[0]
    return list(model.model_fields)
