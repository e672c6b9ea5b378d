"""A lake is opened by plain DuckDB with the script in its folder, in place and after a move."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from facadelake.core.duckdb_engine import find_extension_file
from facadelake.lake.opening_script import OPENING_SCRIPT
from facadelake.lake.read import query
from tests.unit.lake.small_campaign import commit

VIEWS = ("defects", "defect_observations", "detection_outcomes", "current_reviews", "severities", "versions")
# Without network, the extensions are loaded from their wheels in place of INSTALL and LOAD.
PLAIN = f"""
import json, sys
from pathlib import Path
import duckdb
connection = duckdb.connect(config={{"autoinstall_known_extensions": False, "autoload_known_extensions": False}})
for extension in sys.argv[1:]:
    connection.execute(f"LOAD '{{extension}}'")
lines = Path("open_lake.sql").read_text().splitlines()
connection.execute(chr(10).join(line for line in lines if not line.startswith(("INSTALL", "LOAD"))))
counts = {{view: connection.execute(f"SELECT count(*) FROM {{view}}").fetchall()[0][0] for view in {VIEWS}}}
try:
    connection.execute("DELETE FROM defects")
except duckdb.Error as error:
    counts["write"] = str(error)
counts["with product"] = "facadelake" in sys.modules
print(json.dumps(counts))
"""


@pytest.mark.parametrize("moved", [False, True])
def test_plain_duckdb_opens_the_lake_in_place_and_after_a_move(tmp_path: Path, moved: bool) -> None:
    lake = tmp_path / "lake"
    commit(lake)
    expected = {view: query(lake, f"SELECT count(*) AS n FROM {view}")["n"][0].as_py() for view in VIEWS}
    assert expected["defects"] == 3 and expected["defect_observations"] > 0 and expected["versions"] == 1
    if moved:
        (tmp_path / "elsewhere").mkdir()
        lake = Path(shutil.move(lake, tmp_path / "elsewhere" / "of a customer's"))
    extensions = [str(find_extension_file(name)) for name in ("sqlite_scanner", "ducklake")]
    done = subprocess.run(
        [sys.executable, "-I", "-c", PLAIN, *extensions], cwd=lake, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    counts = json.loads(done.stdout)
    assert "read-only" in counts.pop("write")
    assert counts == expected | {"with product": False}


def test_a_script_that_is_there_is_left_and_one_that_differs_is_renewed(tmp_path: Path) -> None:
    commit(tmp_path)
    script = tmp_path / OPENING_SCRIPT
    text = script.read_text()
    assert "INSTALL ducklake;" in text and "CREATE TEMP VIEW defect_observations AS" in text
    script.write_text("-- of an earlier Facadelake")
    commit(tmp_path, run_id="run-2", inputs="k" * 64)
    assert script.read_text() == text
