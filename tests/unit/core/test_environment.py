"""Telemetry is off before any library that has some can be imported."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from facadelake.core.environment import DEFAULTS

REPOSITORY = Path(__file__).resolve().parents[3]


def run_python(code: str, environment: dict[str, str]) -> str:
    """Run code in a fresh interpreter from the checkout; return what it printed."""
    base = {name: value for name, value in os.environ.items() if name not in DEFAULTS and name != "CI"}
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=base | environment,
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    return done.stdout.strip()


@pytest.mark.parametrize("package", ["facadelake", "flows", "tasks"])
def test_each_entry_sets_every_default(package: str) -> None:
    printed = run_python(f"import os, {package}; print([os.environ.get(n) for n in {list(DEFAULTS)!r}])", {})
    assert printed == str(list(DEFAULTS.values()))


def test_a_value_set_by_the_user_stays() -> None:
    printed = run_python(
        "import os, facadelake; print(os.environ['PREFECT_SERVER_ANALYTICS_ENABLED'])",
        {"PREFECT_SERVER_ANALYTICS_ENABLED": "true"},
    )
    assert printed == "true"


def test_prefect_reads_its_telemetry_as_off() -> None:
    printed = run_python(
        "import flows; from prefect._internal.analytics.enabled import is_telemetry_enabled as on; "
        "from prefect.settings import get_current_settings as s; print(on(), s().server.analytics_enabled)",
        {},
    )
    assert printed == "False False"


def test_onnxruntime_leaves_no_device_identifier(tmp_path: Path) -> None:
    """Its telemetry writes one under the cache folder as soon as a session is made, before it uploads anything."""
    code = (
        "import facadelake, onnxruntime; from onnx import helper as h, TensorProto as t; "
        "v = [h.make_tensor_value_info(n, t.FLOAT, [1]) for n in 'xy']; "
        "g = h.make_graph([h.make_node('Identity', ['x'], ['y'])], 'g', v[:1], v[1:]); "
        "m = h.make_model(g, opset_imports=[h.make_opsetid('', 17)], ir_version=8); "
        "print(onnxruntime.InferenceSession(m.SerializeToString()).get_outputs()[0].name)"
    )
    printed = run_python(code, {"HOME": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path / ".cache")})
    assert printed == "y"
    assert not [path for path in tmp_path.rglob("*") if "onnxruntime" in str(path)]


def test_the_library_face_gives_its_names_when_they_are_used() -> None:
    code = (
        "import sys, facadelake as fl\n"
        "heavy = {'duckdb', 'open3d', 'pyproj', 'cv2', 'ifcopenshell'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
        "assert len(fl.__all__) <= 15\n"
        "assert all(getattr(fl, name) is not None for name in fl.__all__)\n"
    )
    subprocess.run([sys.executable, "-c", code], cwd=REPOSITORY, check=True)
