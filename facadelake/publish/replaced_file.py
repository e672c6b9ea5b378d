"""Replacement of a file that another program may have open: written beside, read back, renamed into place.

GIS programs keep GeoPackages open in SQLite's write-ahead mode, with ``-wal`` and ``-shm`` files beside. Such files of
the old GeoPackage would be applied to the new one and make it unreadable.
"""

from __future__ import annotations

import os
import sqlite3
import uuid
from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path

import pyarrow.csv as csv
import pyarrow.parquet as pq
import pyogrio
from pyarrow.lib import ArrowInvalid
from pyogrio.errors import DataLayerError, DataSourceError

from facadelake.core.errors import InputDataError

GEOPACKAGE = ".gpkg"
_SQLITE_COMPANIONS = ("-wal", "-shm", "-journal")


def replace_file(path: Path, write: Callable[[Path], Mapping[str, int]]) -> None:
    """Write a file with ``write``, read it back, and put it in the place of ``path``, or of the file that it links to.

    Args:
        path: The file; its suffix is that of the temporary file, too.
        write: Writes the file of the path given, and returns the number of rows of each of its layers.

    Raises:
        InputDataError: The file is open in another program, cannot be written, or does not hold what was written. An
            earlier file is left as it was.
    """
    path = Path(os.path.realpath(path))  # else a link would be replaced, and the file that others read stay as it was
    temporary = path.parent / f".{uuid.uuid4().hex[:8]}{path.suffix.lower()}"
    try:
        rows = write(temporary)
        _read_back(temporary, rows, path)
        if path.suffix.lower() == GEOPACKAGE:
            _release_geopackage(path)
        temporary.replace(path)
        _read_back(path, rows, path)
    except (OSError, DataSourceError, DataLayerError) as error:
        raise InputDataError(f"cannot write {path}: {error}; choose a writable folder with free space") from error
    finally:
        temporary.unlink(missing_ok=True)
        for companion in _SQLITE_COMPANIONS:
            Path(f"{temporary}{companion}").unlink(missing_ok=True)


def _release_geopackage(path: Path) -> None:
    """Make sure that nobody has the GeoPackage at ``path`` open, and remove the companions of an earlier program.

    Raises InputDataError where another program has it open.
    """
    if path.is_file():
        try:
            with closing(sqlite3.connect(path, timeout=0, isolation_level=None)) as connection:
                # Leaving the write-ahead mode needs the file alone; in other modes readers hold a lock as they read.
                mode = connection.execute("PRAGMA journal_mode = DELETE").fetchone()
                connection.execute("BEGIN EXCLUSIVE")
                connection.execute("ROLLBACK")
                is_open = mode is not None and mode[0] != "delete"
        except sqlite3.OperationalError as error:
            is_open = "locked" in str(error) or "busy" in str(error)
        except sqlite3.DatabaseError:  # not a database: it is replaced as any other file
            is_open = False
        if is_open:
            raise InputDataError(
                f"cannot write {path}: it is open in another program (QGIS?); close it there, or give another name"
            )
    for companion in _SQLITE_COMPANIONS:
        Path(f"{path}{companion}").unlink(missing_ok=True)


def _read_back(file: Path, rows: Mapping[str, int], path: Path) -> None:
    """Raise InputDataError where ``file`` does not have these layers with these numbers of rows."""
    try:
        found = _READERS[file.suffix.lower()](file)
    except (DataSourceError, ArrowInvalid, ValueError) as error:
        raise InputDataError(
            f"{path} was written, but cannot be read back: {error}; check the disk, or write to another folder"
        ) from error
    if found != dict(rows):
        raise InputDataError(
            f"{path} was written with the rows {dict(rows)}, but {found} are read back; check the disk, or write to "
            "another folder"
        )


def _count_layers(file: Path) -> dict[str, int]:
    names = [str(name) for name, _ in pyogrio.list_layers(file)]
    return {name: int(pyogrio.read_info(file, layer=name, force_feature_count=True)["features"]) for name in names}


def _count_geojson(file: Path) -> dict[str, int]:
    return {"": sum(_count_layers(file).values())}  # GDAL names the layer by the file, or by its content


def _count_parquet(file: Path) -> dict[str, int]:
    return {"": pq.read_metadata(file).num_rows}


def _count_csv(file: Path) -> dict[str, int]:
    options = csv.ParseOptions(newlines_in_values=True)
    return {"": csv.read_csv(file, parse_options=options).num_rows}


_READERS: Mapping[str, Callable[[Path], dict[str, int]]] = {
    GEOPACKAGE: _count_layers,
    ".geojson": _count_geojson,
    ".parquet": _count_parquet,
    ".csv": _count_csv,
}
