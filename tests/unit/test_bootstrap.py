"""The set-up's decisions on machines that lack something, without changing this one."""

import importlib.util
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from facadelake.core import system_libraries as libraries

REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.fixture
def bootstrap(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> ModuleType:
    """scripts/bootstrap.py as a module, on a machine whose only library is missing, with tools in tmp_path."""
    spec = importlib.util.spec_from_file_location("bootstrap", REPOSITORY / "scripts" / "bootstrap.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    library = libraries.Library(file="libno-such.so.1", package="libno-such1", needed_by="a test")
    monkeypatch.setattr(module, "LIBRARIES", [library], raising=False)
    monkeypatch.setattr(module, "is_present", libraries.is_present, raising=False)
    monkeypatch.setattr(module, "format_install_command", libraries.format_install_command, raising=False)
    monkeypatch.setattr(module, "UV", tmp_path / "ours" / "uv")
    monkeypatch.setenv("PATH", str(tmp_path))
    return module


def fake_uv(file: Path, version: str) -> None:
    file.parent.mkdir(exist_ok=True)
    file.write_text(f"#!/bin/sh\necho 'uv {version} (x86_64-unknown-linux-gnu)'\n")
    file.chmod(0o755)


def without(*modules: str) -> Callable[[str], bool]:
    return lambda module: module not in modules


def test_bare_debian_wants_venv_and_the_library(bootstrap: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bootstrap, "has", without("ensurepip", "pip"))
    assert bootstrap.missing_packages() == ["python3-venv", "libno-such1"]


@pytest.mark.parametrize("lacking", ["pip", "ensurepip"])
def test_one_of_pip_and_venv_is_enough(bootstrap: ModuleType, monkeypatch: pytest.MonkeyPatch, lacking: str) -> None:
    monkeypatch.setattr(bootstrap, "has", without(lacking))
    assert bootstrap.missing_packages() == ["libno-such1"]


def test_uv_on_the_path_needs_no_venv(bootstrap: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(bootstrap, "has", without("ensurepip", "pip"))
    fake_uv(tmp_path / "uv", "0.13.9")
    assert bootstrap.missing_packages() == ["libno-such1"]
    assert bootstrap.usable_uv() == tmp_path / "uv"


@pytest.mark.parametrize("version", ["0.4.30", "1.0.0", "nonsense"])
def test_uv_that_cannot_read_the_lock_is_passed_over(bootstrap: ModuleType, tmp_path: Path, version: str) -> None:
    fake_uv(tmp_path / "uv", version)
    assert bootstrap.usable_uv() is None


def test_our_uv_comes_first(bootstrap: ModuleType, tmp_path: Path) -> None:
    fake_uv(tmp_path / "uv", "0.13.9")
    fake_uv(bootstrap.UV, "0.13.9")
    assert bootstrap.usable_uv() == bootstrap.UV


def test_user_without_rights_gets_one_command(
    bootstrap: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "apt-get").write_text(f"#!/bin/sh\ntouch {tmp_path}/ran\n")
    (tmp_path / "apt-get").chmod(0o755)
    monkeypatch.setattr(bootstrap.os, "geteuid", lambda: 1000)
    with pytest.raises(SystemExit) as left:
        bootstrap.install(["python3-venv", "libno-such1"])
    assert left.value.code == 1
    command = "sudo apt-get update && sudo apt-get install -y --no-install-recommends python3-venv libno-such1"
    assert capsys.readouterr().err.count(command) == 1
    assert not (tmp_path / "ran").exists()


def test_old_python_is_named_with_what_is_wanted(
    bootstrap: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(bootstrap.sys, "version_info", (3, 10, 12))
    monkeypatch.setattr(bootstrap.platform, "python_version", lambda: "3.10.12")
    with pytest.raises(SystemExit):
        bootstrap.check_python()
    printed = capsys.readouterr().err
    assert "python3 is 3.10.12" in printed
    assert "3.11, 3.12 or 3.13" in printed


def test_libraries_are_read_before_anything_is_installed() -> None:
    """The system's python3 imports system_libraries from its folder: no third-party package may be needed for it."""
    code = (
        f"import sys; sys.path[:0] = [{str(REPOSITORY / 'facadelake' / 'core')!r}]\n"
        "import system_libraries as f\n"
        "print(len(f.LIBRARIES))"
    )
    done = subprocess.run([sys.executable, "-I", "-S", "-c", code], capture_output=True, text=True, check=True)
    assert int(done.stdout) == len(libraries.LIBRARIES)
