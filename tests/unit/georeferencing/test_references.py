"""References of campaigns are kept, replaced and forgotten with the campaigns."""

from pathlib import Path

from facadelake.georeferencing.campaign.reference import drop_reference, list_earlier_references, store_reference


def test_a_campaign_committed_anew_without_a_reference_loses_the_old_one(tmp_path: Path) -> None:
    made = tmp_path / "made.npz"
    for campaign in ("2025-04", "2026-04"):
        made.write_bytes(campaign.encode())
        store_reference(made, tmp_path, "town-hall", campaign)
    assert [path.stem for path in list_earlier_references(tmp_path, "town-hall", "2026-10")] == ["2025-04", "2026-04"]
    drop_reference(tmp_path, "town-hall", "2026-04")
    drop_reference(tmp_path, "town-hall", "2026-04")  # nothing is there: no error
    left = list_earlier_references(tmp_path, "town-hall", "2026-10")
    assert [(path.stem, path.read_bytes()) for path in left] == [("2025-04", b"2025-04")]
