"""Where a model's card is found: named, beside the model, or in the metadata of the ONNX file."""

from __future__ import annotations

from pathlib import Path

from facadelake.core.errors import ModelError
from facadelake.detection.card import ModelCard, card_path, parse_card, read_card
from facadelake.detection.inference.draft_card import draft_card
from facadelake.detection.inference.session import ModelSession

METADATA_KEY = "facadelake.card"


def find_card(model: Path, card: Path | None = None) -> ModelCard:
    """The card at ``card``, or beside ``model`` (``.card.yaml``, ``.card.yml``, ``.card.json``), or in its metadata.

    Raises ModelError where there is none; it prints a draft of one, made from what the file says of itself.
    """
    if card is not None:
        return read_card(card)
    beside = card_path(model)
    for path in (beside, beside.with_suffix(".yml"), beside.with_suffix(".json")):
        if path.is_file():
            return read_card(path)
    session = ModelSession(model)
    text = session.metadata.get(METADATA_KEY)
    if text is not None:
        return parse_card(text, f"model {model}, metadata {METADATA_KEY}")
    draft = draft_card(session)
    raise ModelError(
        f"model card {beside} does not exist; every detector needs one beside it, or in its metadata under "
        f"{METADATA_KEY} (docs/model-card.md shows one). {draft.remark} Check it and save it as {beside.name}:\n"
        f"\n{draft.text}"
    )
