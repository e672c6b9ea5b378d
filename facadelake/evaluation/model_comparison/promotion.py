"""Whether a new model may take the old one's place: what speaks against it, in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from facadelake.evaluation.model_comparison.report import Comparison


def objections(
    comparison: Comparison,
    *,
    old_sha256: str | None,
    new_sha256: str,
    evaluations: Sequence[Mapping[str, Any]],
    lost_max: int,
    confirmed_min: int,
) -> tuple[str, ...]:
    """What speaks against promoting ``new_sha256`` in the place of ``old_sha256`` (None: there is no default yet).

    ``evaluations`` are those of the new model's card; ``lost_max`` confirmed defects may be lost, and at least
    ``confirmed_min`` must have been looked at. An empty answer is a yes.
    """
    found = []
    compared = (comparison.old.sha256, comparison.new.sha256)
    if compared[1] != new_sha256 or old_sha256 not in (None, compared[0]):
        found.append(
            f"the comparison is of {compared[0][:12]} with {compared[1][:12]}, not of the default "
            f"{(old_sha256 or 'none')[:12]} with {new_sha256[:12]}; run 'facadelake compare-models' with these two"
        )
    words = comparison.words
    confirmed = words.get("confirmed", 0)
    if confirmed < confirmed_min:
        found.append(
            f"the compared photographs show {confirmed} confirmed defects, at least {confirmed_min} are needed to tell "
            "whether any is lost; review detections ('facadelake review export-task') or compare more campaigns"
        )
    if len(comparison.lost) > lost_max:
        named = ", ".join(f"{one.defect} ({one.defect_class})" for one in comparison.lost[:5])
        more = f" and {len(comparison.lost) - 5} more" if len(comparison.lost) > 5 else ""
        found.append(
            f"it loses {len(comparison.lost)} of the {words.get('confirmed_by_old', 0)} confirmed defects that the old "
            f"one finds, allowed are {lost_max}: {named}{more}; train it on them ('facadelake training-set'), or allow "
            "it with --max-lost"
        )
    own = [one for one in evaluations if one.get("model_sha256") == new_sha256]
    if not own:
        other = f" (it has {len(evaluations)} of another file's hash)" if evaluations else ""
        found.append(
            f"its card holds no evaluation of this file{other}; run 'facadelake evaluate-detector' and let it write "
            "the figures into the card"
        )
    return tuple(found)


def evidence(comparison: Comparison, *, lost_max: int) -> str:
    """What a promotion rests on, in a sentence for the list of models."""
    words = comparison.words
    photographs = sum(len(campaign.photographs) for campaign in comparison.campaigns)
    campaigns = ", ".join(f"{one.building_id}/{one.campaign_id}" for one in comparison.campaigns)
    return (
        f"compared with {comparison.old.sha256[:12]} on {photographs} photographs of {campaigns}: "
        f"{words.get('confirmed_lost', 0)} of {words.get('confirmed', 0)} confirmed defects lost (allowed {lost_max}), "
        f"{words.get('confirmed_gained', 0)} gained, {words.get('rejected_lost', 0)} of {words.get('rejected', 0)} "
        "rejected ones gone"
    )
