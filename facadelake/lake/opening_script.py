"""The lake's own script that opens it in plain DuckDB, without Facadelake."""

from __future__ import annotations

import logging
import uuid
from pathlib import Path

from facadelake.core.checkout import locate_source
from facadelake.core.sql_files import read_statements
from facadelake.lake.connect import CATALOG, DATA

OPENING_SCRIPT = "open_lake.sql"
_HEAD = f"""-- Opens this lake in DuckDB 1.4 or later, read-only, wherever its folder lies. In the folder of the lake:
--     duckdb -init {OPENING_SCRIPT}
INSTALL sqlite;
INSTALL ducklake;
LOAD sqlite;
LOAD ducklake;
ATTACH 'ducklake:sqlite:{CATALOG}' AS lake (DATA_PATH '{DATA}/', OVERRIDE_DATA_PATH true, READ_ONLY);
USE lake;
"""

logger = logging.getLogger(__name__)


def write_opening_script(lake: Path) -> None:
    """Write ``open_lake.sql`` into the lake, with the views of sql/views/, where it is not there as it should be.

    The lake is whole without it, so a failure is a warning.
    """
    path = lake / OPENING_SCRIPT
    views = (
        f"-- {view.meaning}\nCREATE TEMP VIEW {view.name} AS\n{view.sql};"
        for view in read_statements(locate_source("sql/views"))
    )
    text = "\n".join([_HEAD, *views]) + "\n"
    temporary = lake / f".{uuid.uuid4().hex[:8]}.sql"
    try:
        if path.is_file() and path.read_text("utf-8") == text:
            return
        temporary.write_text(text, encoding="utf-8")
        temporary.replace(path)
    except OSError as error:
        logger.warning("cannot write %s: %s", path, error)
    finally:
        temporary.unlink(missing_ok=True)
