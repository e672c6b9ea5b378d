"""The model registry: a promotion keeps earlier models; a damaged registry is refused."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from facadelake.core.errors import ModelError
from facadelake.core.hashing import hash_file
from facadelake.detection.card import read_card
from facadelake.detection.configured_detector import locate_model, resolve_default_model
from facadelake.detection.model_registry import (
    MODEL_LIST,
    SHIPPED_MODEL,
    add_promotion,
    find_default_model,
    read_promotions,
)
from facadelake.registry import Building, OnnxDetectorSetting
from tests.unit.detection.onnx_models import make_card, save_model


def save_registry_model(folder: Path, name: str, number: float) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    path = save_model(folder / f"{name}.onnx", np.full((1, 6, 4), number))
    path.with_suffix(".card.yaml").write_text(yaml.safe_dump({**make_card("yolov8"), "name": name}))
    return path


def test_shipped_model_is_the_default_until_another_is_promoted(tmp_path: Path) -> None:
    folder = tmp_path / "models"
    with pytest.raises(ModelError, match=r"default detector .*facadelake-nano.onnx does not exist; restore it"):
        find_default_model(folder)
    shipped = save_registry_model(folder, SHIPPED_MODEL.removesuffix(".onnx"), 0.1)
    assert find_default_model(folder) == shipped
    new = save_registry_model(tmp_path, "second try", 0.2)
    given = {"by": "A. Mason", "why": "fewer joints", "evidence": "7 of 7", "folder": folder}
    done = add_promotion(new, replaces=hash_file(shipped), **given)
    stored = find_default_model(folder)
    assert stored.name == done.file == f"second-try-{hash_file(new)[:12]}.onnx"
    assert hash_file(stored) == hash_file(new)
    assert read_card(stored.with_suffix(".card.yaml")).name == "second try"
    assert (done.by, done.why, done.replaces) == ("A. Mason", "fewer joints", hash_file(shipped))
    assert shipped.is_file()


def test_promoting_again_changes_nothing_and_promoting_back_adds_an_entry(tmp_path: Path) -> None:
    folder, old, new = (
        tmp_path / "models",
        save_registry_model(tmp_path, "old", 0.1),
        save_registry_model(tmp_path, "new", 0.2),
    )
    given = {"by": "A. Mason", "why": "a trial", "evidence": "", "folder": folder}
    first = add_promotion(old, replaces=None, **given)
    add_promotion(new, replaces=first.sha256, **given)
    assert add_promotion(new, replaces=first.sha256, **given) == read_promotions(folder)[-1]
    add_promotion(old, replaces=hash_file(new), **given)
    assert [entry.sha256 for entry in read_promotions(folder)] == [first.sha256, hash_file(new), first.sha256]
    assert hash_file(find_default_model(folder)) == first.sha256


def test_changed_model_and_damaged_list_are_refused(tmp_path: Path) -> None:
    folder = tmp_path / "models"
    add_promotion(save_registry_model(tmp_path, "new", 0.2), by="A", why="b", evidence="", replaces=None, folder=folder)
    find_default_model(folder).write_bytes(b"other")
    with pytest.raises(ModelError, match=r"was changed after A promoted it .* restore it, or promote it again"):
        find_default_model(folder)
    (folder / MODEL_LIST).write_text("- file: ../elsewhere.onnx\n")
    with pytest.raises(ModelError, match=r"(?s)models.yaml, the list of promoted detectors, cannot be read"):
        find_default_model(folder)


def test_model_without_card_leaves_the_default(tmp_path: Path) -> None:
    bare = save_model(tmp_path / "bare.onnx", np.full((1, 6, 4), 0.1))
    with pytest.raises(ModelError, match=r"bare\.card\.yaml does not exist"):
        add_promotion(bare, by="A", why="b", evidence="", replaces=None, folder=tmp_path / "models")
    assert read_promotions(tmp_path / "models") == ()


def test_another_promotion_meanwhile_is_not_replaced(tmp_path: Path) -> None:
    folder = tmp_path / "models"
    shipped, second, third = (
        save_registry_model(tmp_path, name, 0.1 * i) for i, name in enumerate(("first", "second", "third"))
    )
    given = {"by": "A. Mason", "why": "a trial", "evidence": "", "folder": folder}
    add_promotion(second, replaces=hash_file(shipped), **given)
    with pytest.raises(ModelError, match=rf"but the default is {hash_file(second)[:12]} since A. Mason promoted it"):
        add_promotion(third, replaces=hash_file(shipped), **given)
    assert hash_file(find_default_model(folder)) == hash_file(second)


def test_a_run_keeps_the_default_it_began_with(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    old, new = save_registry_model(tmp_path, "old", 0.1), save_registry_model(tmp_path, "new", 0.2)
    given = {"id": "a", "name": "A", "model": "a.ifc", "photographs": "{campaign}"}
    monkeypatch.setattr("facadelake.detection.configured_detector.find_default_model", lambda: old)
    begun = resolve_default_model(Building.model_validate(given))
    monkeypatch.setattr("facadelake.detection.configured_detector.find_default_model", lambda: new)
    assert isinstance(begun.detector, OnnxDetectorSetting)
    assert (locate_model(begun.detector), resolve_default_model(begun)) == (old, begun)
    own = Building.model_validate({**given, "detector": {"kind": "onnx", "model": str(tmp_path / "own.onnx")}})
    assert resolve_default_model(own) == own
