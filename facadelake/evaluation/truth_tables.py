"""CSV files of truth: rows with their place in the file, for messages."""

from __future__ import annotations

import csv
from pathlib import Path

from facadelake.core.errors import InputDataError


class CsvRow(dict[str, str]):
    """A line of a CSV file by column; ``place`` is file and line, for messages."""

    place: str


def read_truth_rows(path: Path, unique: str | None, *columns: str) -> list[CsvRow]:
    """Rows of a CSV file of truth with all its columns; an empty value is "".

    Args:
        path: the file.
        unique: the column whose values must be there, and differ; None: there is none.
        columns: the columns that must be there.

    Returns:
        The rows in their order.

    Raises:
        InputDataError: the file cannot be read, lacks a column, or repeats a value of ``unique``.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            reader = csv.DictReader(stream)
            missing = sorted(set(columns) - set(reader.fieldnames or ()))
            if missing:
                raise InputDataError(
                    f"{path} has no column {', '.join(missing)} (it has {reader.fieldnames}); "
                    f"truth needs {', '.join(columns)}"
                )
            rows = []
            for line in reader:
                row = CsvRow({name: line[name] or "" for name in reader.fieldnames or ()})
                row.place = f"{path}, line {reader.line_num}"
                rows.append(row)
    except OSError as error:
        raise InputDataError(
            f"truth file {path} cannot be read ({error.strerror}); give the folder that holds it"
        ) from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputDataError(f"truth file {path} is not a CSV table in UTF-8: {error}") from error
    seen: set[str] = set()
    for row in rows if unique is not None else ():
        name = row[unique or ""]
        if not name or name in seen:
            raise InputDataError(f"{row.place}, column {unique}: '{name}' is empty or listed twice; it must be unique")
        seen.add(name)
    return rows
