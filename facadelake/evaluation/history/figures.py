"""Figures of a building's history against truth: a record, its JSON with stable keys, and its rows for a table."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from facadelake.evaluation.history.change_figures import ChangeFigures, compute_change_figures
from facadelake.evaluation.history.comparison import HistoryComparison
from facadelake.evaluation.history.identity import IdentityFigures, measure_identity, measure_identity_of_all
from facadelake.evaluation.history.state_figures import StateFigures, compute_state_figures


@dataclass(frozen=True, kw_only=True)
class HistoryFigures:
    """The result of ``facadelake evaluate --history``.

    ``identity``: of the detected defects. ``identity_of_all``: of all true defects that are there and imaged, with the
    detector's faults. ``never_detected``: true defects that no campaign detected; ``identity_of_all`` alone has them.
    """

    COLUMNS: ClassVar[tuple[str, ...]] = ("figure", "n", "value", "what it is")

    campaigns: tuple[str, ...]
    identity: IdentityFigures
    identity_of_all: IdentityFigures
    states: StateFigures
    changes: ChangeFigures
    never_detected: tuple[str, ...]

    def convert_to_json(self) -> dict[str, object]:
        """The figures under stable keys."""
        return {
            "campaigns": list(self.campaigns),
            "identity": self.identity.convert_to_json(),
            "identity_of_all": self.identity_of_all.convert_to_json(),
            "states": self.states.convert_to_json(),
            "changes": self.changes.convert_to_json(),
            "never_detected": list(self.never_detected),
        }

    def format_rows(self) -> list[tuple[str, ...]]:
        """Rows under ``COLUMNS``."""
        identity, of_all, states, changes = self.identity, self.identity_of_all, self.states, self.changes
        return [
            ("IDF1", str(identity.objects), _format(identity.idf1), "identity of the detected defects"),
            ("identity switches", str(identity.objects), str(identity.switches), ""),
            (
                "IDF1 of all true defects",
                str(of_all.objects),
                _format(of_all.idf1),
                "with the detector's misses and false detections",
            ),
            ("states right", str(states.total), _format(states.right_share), "of true defects with a track"),
            ("false repaired", str(states.repaired), _format(states.false_repaired_share), "of those called so"),
            (
                "recovered by the look",
                str(states.missed),
                _format(states.recovered_share),
                "there and imaged, but not detected",
            ),
            ("never detected", str(len(self.never_detected)), "", ", ".join(self.never_detected)),
            ("false change of size", str(changes.unchanged), _format(changes.false_share), "of the unchanged"),
            ("change of size found", str(changes.changed), _format(changes.found_share), "of the changed"),
            *(
                (f"change inside 2 sigma: {quantity}", str(one.count), _format(one.share), "0.95 is right")
                for quantity, one in changes.by_quantity.items()
            ),
            *(
                (
                    f"offset {one.before} to {one.campaign_id} (cm)",
                    str(one.count),
                    f"{100 * one.offset_m:.2f}",
                    f"of unchanged defects; median distance {100 * one.distance_m:.2f} cm",
                )
                for one in changes.offsets
            ),
        ]


def compute_history_figures(compared: HistoryComparison) -> HistoryFigures:
    """Compute the figures of a history beside truth."""
    return HistoryFigures(
        campaigns=compared.campaigns,
        identity=measure_identity(compared),
        identity_of_all=measure_identity_of_all(compared),
        states=compute_state_figures(compared),
        changes=compute_change_figures(compared),
        never_detected=compared.never_detected,
    )


def _format(value: float | None) -> str:
    return "-" if value is None else f"{value:.4f}"
