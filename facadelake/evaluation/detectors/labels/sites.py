"""Site, split, GSD and area of labelled photographs, from files beside their labels."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import yaml

from facadelake.core.errors import InputDataError
from facadelake.evaluation.detectors.labels.labels import LabelledImage, LabelledSet

_WILDCARDS = frozenset("*?[")
# Roboflow exports a.png as a_png_jpg.rf.0123456789abcdef.jpg.
_ROBOFLOW_SUFFIX = re.compile(r"(_(png|jpg|jpeg))*\.rf\.[0-9a-f]+$")


def assign_sites(labelled: LabelledSet, file: Path | None, split: str | None = None) -> LabelledSet:
    """Assign sites to photographs, and select a split.

    Args:
        labelled: The photographs.
        file: A CSV with the columns ``image`` (path below the data folder, the end of the path, or a pattern such as
            ``k1/*``), ``site`` and, for splits, ``split``; or a YAML with the data folder's name, the site, then
            ``split`` and ``pictures`` (training/data/sites.yaml). None: the folders are the sites, where there are
            several.
        split: Only the photographs of this split. Those that ``file`` does not list are left out and counted; without
            ``split`` they have no site.

    Raises:
        InputDataError: The file cannot be read or lacks a column, or no photograph is left.
    """
    if file is None:
        return replace(labelled, images=tuple(_assign_sites_by_folder(labelled.images)))
    is_yaml = file.suffix.lower() in {".yaml", ".yml"}
    rows = _read_yaml(file, labelled.name) if is_yaml else _read_csv(file, ("image", "site"))
    if split is not None and "split" not in rows.columns:
        raise InputDataError(
            f"{file} has no column 'split' (it has {sorted(rows.columns)}), which --split {split} needs"
        )
    left_out = Counter(labelled.left_out)
    images = []
    for image in labelled.images:
        row = rows.find_row(image)
        if split is not None and row is None:
            left_out["photographs that are not in the file of sites"] += 1
        if split is not None and (row is None or row["split"] != split):
            continue
        images.append(replace(image, site=(row["site"] or None) if row else None))
    if not images:
        raise InputDataError(
            f"{file} has none of the {len(labelled.images)} photographs of {labelled.name}"
            + ("; " if split is None else f" in split '{split}'; ")
            + f"its column 'image' must hold names such as '{labelled.images[0].key}'"
        )
    return replace(labelled, images=tuple(images), left_out=dict(left_out))


def assign_scale(images: tuple[LabelledImage, ...], file: Path) -> tuple[LabelledImage, ...]:
    """Assign GSD and area of facade to photographs, from a CSV.

    Its columns are ``image`` (as for sites; ``*``: all), and ``gsd_mm`` (mm/px) or ``area_m2`` (facade in the
    photograph) or both. One is computed from the other as if the whole photograph showed facade. Raises InputDataError
    where a value is not a positive number, a column is missing, or no photograph is listed.
    """
    rows = _read_csv(file, ("image",))
    if not rows.columns & {"gsd_mm", "area_m2"}:
        raise InputDataError(f"{file} has neither a column gsd_mm nor area_m2 (it has {sorted(rows.columns)})")
    with_scale = []
    for image in images:
        row = rows.find_row(image)
        gsd, area = (rows.get_positive_number(row, name) for name in ("gsd_mm", "area_m2"))
        pixels = image.width_px * image.height_px
        if gsd is not None and area is None:
            area = pixels * (gsd / 1000) ** 2
        elif area is not None and gsd is None:
            gsd = 1000 * (area / pixels) ** 0.5
        with_scale.append(replace(image, gsd_mm=gsd, area_m2=area))
    if all(image.area_m2 is None for image in with_scale):
        raise InputDataError(f"{file} lists none of the photographs, such as '{images[0].key}'; correct column 'image'")
    return tuple(with_scale)


def _assign_sites_by_folder(images: tuple[LabelledImage, ...]) -> list[LabelledImage]:
    folders = [image.key.rpartition("/")[0] for image in images]
    of_form = {"images", "train", "val", "valid", "test", "jpegimages", "labels"}
    sites = ["/".join(part for part in folder.split("/") if part.lower() not in of_form) for folder in folders]
    if len(set(sites)) < 2:
        return list(images)
    return [replace(image, site=site or "(top folder)") for image, site in zip(images, sites, strict=True)]


class _PhotographTable:
    """Rows of a file by photograph: its path, the end of the path, with or without suffix; then by pattern."""

    def __init__(self, file: Path, rows: list[dict[str, str]], columns: frozenset[str]) -> None:
        self._file = file
        self.columns = columns
        by_name = {row["image"].strip(): row for row in rows}
        self._exact = {name: row for name, row in by_name.items() if not _WILDCARDS & set(name)}
        self._patterns = [(name, row) for name, row in by_name.items() if _WILDCARDS & set(name)]

    def find_row(self, image: LabelledImage) -> Mapping[str, str] | None:
        """The row of a photograph, or None."""
        parts = image.key.split("/")
        suffixes = ["/".join(parts[i:]) for i in range(len(parts))]
        for name in suffixes:
            stem = name.rpartition(".")[0]
            for candidate in (name, stem, _ROBOFLOW_SUFFIX.sub("", stem)):
                if candidate in self._exact:
                    return self._exact[candidate]
        matching = (row for pattern, row in self._patterns if any(fnmatchcase(suffix, pattern) for suffix in suffixes))
        return next(matching, None)

    def get_positive_number(self, row: Mapping[str, str] | None, column: str) -> float | None:
        """A number of a row; None where row or value are missing. Raises InputDataError where it is not positive."""
        text = (row or {}).get(column) or ""
        if not text.strip():
            return None
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not 0 < value < 1e6:
            raise InputDataError(f"{self._file}, column {column}: '{text}' is not a positive number")
        return value


def _read_csv(file: Path, needed: tuple[str, ...]) -> _PhotographTable:
    try:
        with file.open(newline="", encoding="utf-8-sig") as stream:
            reader = csv.DictReader(stream)
            rows = [{name: value or "" for name, value in row.items() if name} for row in reader]
            columns = frozenset(reader.fieldnames or ())
    except OSError as error:
        raise InputDataError(f"{file} cannot be read ({error.strerror}); give a CSV file") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputDataError(f"{file} is not a CSV file in UTF-8: {error}") from error
    missing = sorted(set(needed) - columns)
    if missing:
        raise InputDataError(f"{file} has no column {', '.join(missing)} (it has {sorted(columns)})")
    return _PhotographTable(file, rows, columns)


def _read_yaml(file: Path, set_name: str) -> _PhotographTable:
    try:
        content: Any = yaml.safe_load(file.read_text(encoding="utf-8"))
        listed = content[set_name]
        rows = [
            {"image": str(picture), "site": str(site), "split": str(entry["split"])}
            for site, entry in listed.items()
            for picture in entry["pictures"]
        ]
    except OSError as error:
        raise InputDataError(f"{file} cannot be read ({error.strerror}); give a CSV or YAML file") from error
    except (UnicodeDecodeError, yaml.YAMLError, KeyError, TypeError, AttributeError) as error:
        raise InputDataError(
            f"{file} has no sites with 'split' and 'pictures' for the data folder '{set_name}' "
            f"({type(error).__name__}: {error}); training/data/sites.yaml is an example; or give a CSV file"
        ) from error
    return _PhotographTable(file, rows, frozenset({"image", "site", "split"}))
