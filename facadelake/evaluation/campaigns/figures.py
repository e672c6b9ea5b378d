"""Figures of a campaign against truth: a record, its JSON with stable keys, and its rows for a table."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from facadelake.evaluation.campaigns.check_points import CheckPointCounts
from facadelake.evaluation.campaigns.covariance_consistency import CovarianceConsistency
from facadelake.evaluation.campaigns.merging import MergeFigures
from facadelake.evaluation.campaigns.paper_table2 import PaperTable2
from facadelake.evaluation.campaigns.statistics import ErrorStatistics, PositionErrorStatistics, SurfaceErrorStatistics


@dataclass(frozen=True, kw_only=True)
class CampaignFigures:
    """The result of ``facadelake evaluate``; metres, pixels and centimetres as the names say. None: not available.

    ``camera_error``: distance of camera centres from the published ones, without alignment, and the mean signed offset.
    ``ray_error``: distance of a check point from the ray of its box's centre. ``observation_error``, ``defect_error``:
    position minus check point. ``roundtrip_px``, ``roundtrip_cm``: registered position re-projected against the centre
    of its box (the paper's Table 2); ``roundtrip_defects_*``: the same of a defect's position in every photograph that
    shows it. ``registered_without_check_point``: registered detections that show no check point. ``consistency_*``:
    whether the errors of cameras, observations and defects fit their covariances.
    """

    COLUMNS: ClassVar[tuple[str, ...]] = ("figure", "n", "mean", "median", "mae", "rmse", "p95", "iqr")

    photographs_total: int
    photographs_localised: int
    camera_error: PositionErrorStatistics
    ray_error: ErrorStatistics
    observation_error: SurfaceErrorStatistics
    defect_error: SurfaceErrorStatistics
    roundtrip_px: ErrorStatistics
    roundtrip_cm: ErrorStatistics
    roundtrip_defects_px: ErrorStatistics
    roundtrip_defects_cm: ErrorStatistics
    merge: MergeFigures
    element_correct_share: float | None
    element_correct_share_defects: float | None
    registered_without_check_point: int | None
    check_points: CheckPointCounts
    consistency_cameras: CovarianceConsistency
    consistency_observations: CovarianceConsistency
    consistency_defects: CovarianceConsistency
    table2: PaperTable2

    @property
    def coverage_2sigma(self) -> float | None:
        """Share of the cameras inside their stated 95 % ellipsoid."""
        return self.consistency_cameras.inside_2sigma

    def convert_to_json(self) -> dict[str, object]:
        """The figures under stable keys; a round trip is given by its mean."""
        return {
            "photographs": {"total": self.photographs_total, "localised": self.photographs_localised},
            "camera_error_m": self.camera_error.convert_to_json(),
            "ray_error_m": self.ray_error.convert_to_json(),
            "observation_error_m": self.observation_error.convert_to_json(),
            "defect_error_m": self.defect_error.convert_to_json(),
            "roundtrip_px": self.roundtrip_px.mean,
            "roundtrip_cm": self.roundtrip_cm.mean,
            "merge": self.merge.convert_to_json(),
            "element_correct_share": self.element_correct_share,
            "off_truth": self.registered_without_check_point,
            "coverage_2sigma": self.coverage_2sigma,
            "coverage_2sigma_observations": self.consistency_observations.inside_2sigma,
            "coverage_2sigma_defects": self.consistency_defects.inside_2sigma,
            "roundtrip_defects_px": self.roundtrip_defects_px.mean,
            "roundtrip_defects_cm": self.roundtrip_defects_cm.mean,
            "element_correct_share_defects": self.element_correct_share_defects,
            "covariance_consistency": {name: one.convert_to_json() for name, one in self._list_consistency()},
            "check_points": self.check_points.convert_to_json(),
            "table2": self.table2.convert_to_json(),
        }

    def format_rows(self) -> list[tuple[str, ...]]:
        """Rows under ``COLUMNS``: statistics fill all columns; a count is in ``n``, a share in ``mean``."""
        observation, defect = self.observation_error, self.defect_error
        return [
            ("photographs", str(self.photographs_total), *_pad_row(6)),
            ("photographs localised", str(self.photographs_localised), *_pad_row(6)),
            _format_row("camera error (m)", self.camera_error, 3),
            *(
                (f"  mean offset {axis}", "", _format_number(value, 3), *_pad_row(5))
                for axis, value in (
                    ("east", self.camera_error.offset_east),
                    ("north", self.camera_error.offset_north),
                    ("up", self.camera_error.offset_up),
                )
            ),
            _format_row("ray error (m)", self.ray_error, 4),
            _format_row("observation error (m)", observation.distance, 3),
            _format_row("  along the normal", observation.normal, 3),
            _format_row("  horizontal", observation.horizontal, 3),
            _format_row("  vertical", observation.vertical, 3),
            _format_row("defect error (m)", defect.distance, 3),
            _format_row("  along the normal", defect.normal, 3),
            _format_row("  horizontal", defect.horizontal, 3),
            _format_row("  vertical", defect.vertical, 3),
            _format_row("round trip (px)", self.roundtrip_px, 3),
            _format_row("round trip (cm)", self.roundtrip_cm, 3),
            _format_row("  of defects (px)", self.roundtrip_defects_px, 3),
            _format_row("  of defects (cm)", self.roundtrip_defects_cm, 3),
            ("merge precision", "", _format_number(self.merge.precision, 3), *_pad_row(5)),
            ("merge recall", "", _format_number(self.merge.recall, 3), *_pad_row(5)),
            ("merge F1", "", _format_number(self.merge.f1, 3), *_pad_row(5)),
            ("clusters exactly correct", "", _format_number(self.merge.clusters_exact, 3), *_pad_row(5)),
            ("element correct", "", _format_number(self.element_correct_share, 3), *_pad_row(5)),
            ("  of defects", "", _format_number(self.element_correct_share_defects, 3), *_pad_row(5)),
            (
                "registered without check point",
                "-" if self.registered_without_check_point is None else str(self.registered_without_check_point),
                *_pad_row(6),
            ),
            *(
                (
                    f"{name} inside 2 sigma",
                    str(one.n),
                    _format_number(one.inside_2sigma, 3),
                    *_pad_row(5),
                )
                for name, one in self._list_consistency()
            ),
            *(
                (f"{name} NEES (1: consistent)", str(one.n), _format_number(one.nees, 2), *_pad_row(5))
                for name, one in self._list_consistency()
            ),
            *((name, str(count), *_pad_row(6)) for name, count in self._list_counts()),
        ]

    def _list_consistency(self) -> tuple[tuple[str, CovarianceConsistency], ...]:
        return (
            ("cameras", self.consistency_cameras),
            ("observations", self.consistency_observations),
            ("defects", self.consistency_defects),
        )

    def _list_counts(self) -> tuple[tuple[str, int], ...]:
        points = self.check_points
        return (
            ("check points", points.total),
            ("  without a defect", points.missed),
            ("  of these, detected", points.lost),
            ("  in more than one defect", points.duplicated),
            ("false defects", points.false_defects),
            ("pairs nearer than 0.5 m", points.near_pairs),
            ("  in separate defects", points.near_apart),
        )


def _format_row(name: str, stats: ErrorStatistics, digits: int) -> tuple[str, ...]:
    values = (stats.mean, stats.median, stats.mae, stats.rmse, stats.p95, stats.iqr)
    return (name, str(stats.n), *(_format_number(value, digits) for value in values))


def _format_number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _pad_row(count: int) -> tuple[str, ...]:
    return ("",) * count
